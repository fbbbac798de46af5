"""A run whose cameras take one body for another pauses, and reads the state again once that is put right."""

from pathlib import Path

import pytest
import yaml
from house import BENDING, House, during, recorded

from lab.cli import main
from lab.files.units import KINDS
from recordings.campaign.replay import table_of


@pytest.mark.parametrize("pair", [("Tip", "M2"), pytest.param(("M1", "M3"), marks=pytest.mark.long)])
def test_bodies_exchanged_in_mid_sweep_hold_the_run_up(
    house: House, tmp_path: Path, pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    fakes, plant, cameras = house.fakes, house.fakes.plant, house.fakes.mocap
    assert cameras is not None
    fakes.on_confirm = lambda trouble: fakes.switch.end()
    during(lambda: float(plant.chamber_pressure.max()) > 100e3, lambda: cameras.faults.extra.update(exchange=pair))
    assert house.lab(tmp_path, "bending", *BENDING) == 3
    assert any("mocap" in trouble and "mm apart" in trouble for trouble in fakes.troubles)
    assert "a body was out of the robot's reach" in capsys.readouterr().err
    recording = recorded(tmp_path)
    table = table_of(recording)
    assert [row.step for row in table] == [1, 2, 3, 4, 5] and table.doubtful.any()
    assert recording.marks and recording.marks[0].doubt == "bodies"
    assert all(row.tip is not None and row.tip[2] > 0.25 for row in table)


def test_a_check_names_bodies_that_cannot_be_where_they_are(house: House, capsys: pytest.CaptureFixture[str]) -> None:
    house.change(without=("arm", "force"))
    assert main(["check", "--rig", str(house.rig)]) in (0, 3)
    assert "mm apart" not in capsys.readouterr().err
    mocap = yaml.safe_load(house.rig.read_text())["instruments"]["mocap"]
    written = [c.split() for c in mocap["mocap_to_base"]["position"]]
    position = [float(number) * KINDS["m"][unit] + 0.3 for number, unit in written]
    house.change_instrument("mocap", mocap_to_base={**mocap["mocap_to_base"], "position": position})
    assert main(["check", "--rig", str(house.rig)]) in (0, 3)
    assert "the base and the tip are" in " ".join(capsys.readouterr().err.split())
