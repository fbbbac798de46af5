"""The force sensor's zero may move during a trial: what is constant drift is removed, anything else marks the trial."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from house import STIFFNESS, House, during, recorded

import timing
from lab.files.inputs import read_case
from recordings.campaign.replay import replay, table_of
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table
from sim_fakes.ft300s import Ft300sFake
from tests.simulated.bench import repeated

pytestmark = pytest.mark.long
"""Whole stiffness runs of minutes of rig time each."""
TRUE_SLOPE = 3 * 1.323e6 * np.pi / 4 * 0.029**4 / 0.1**3
"""N/m of the spine of 0.1 m (Table II)."""
ACROSS = np.array([0.0, 0.0, 1.0])
"""The push as the sensor of the stand's tool sees it; the other axes do not enter."""


def sensor(house: House) -> Ft300sFake:
    part = house.fakes.parts["force"]
    assert isinstance(part, Ft300sFake)
    return part


def drifted(house: House, folder: Path, zero: Callable[[float], float]) -> Table:
    """The table of a run in which the sensor's zero moves along the push by `zero` (N) of the host seconds since its begin."""
    device, begin = sensor(house).device, timing.now()
    before = device.bias.copy()

    def move() -> None:
        device.bias[:3] = before[:3] + ACROSS * zero(timing.now() - begin)

    try:
        with repeated(move, 0.005):
            assert house.lab(folder, "stiffness", *STIFFNESS, "--set", "steps=6") in (0, 3)
    finally:
        device.bias[:] = before
    live = table_of(recorded(folder))
    (file,) = folder.glob("*.mcap")
    write_csv(live, folder / "trials.csv")
    for other in (replay(file), read_case([file]).table, read_csv(folder / "trials.csv")):
        assert [row.cells() for row in other] == [row.cells() for row in live]
    return live


@pytest.mark.parametrize("rate", [0.08, -0.08, 0.0])
def test_a_constant_drift_is_removed_and_stands_in_the_row_and_without_one_nothing_is_marked(
    house: House, tmp_path: Path, rate: float
) -> None:
    table = drifted(house, tmp_path, lambda t: rate * t)
    assert len(table) == 6
    assert not table.doubtful.any()
    assert np.all((np.abs(table["force_drift"]) > 0.1) == (rate != 0.0)) and np.all(table["force_drift"] * rate <= 0.0)
    assert np.polyfit(table["deflection"], table["force"], 1)[0] == pytest.approx(TRUE_SLOPE, rel=0.05)


KINDS: dict[str, Callable[[float], float]] = {
    "step": lambda t: 0.8,
    "warming up": lambda t: 2.0 * (1.0 - np.exp(-t / 2.0)),
    "in part of the trial": lambda t: min(0.6, 0.3 * t),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_zero_that_moves_in_another_way_marks_the_trial(
    house: House, tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    plant, begun = house.fakes.plant, []
    during(lambda: abs(plant.probe_force).max() > 1.0, lambda: begun.append(timing.now()))
    table = drifted(house, tmp_path, lambda t: KINDS[kind](timing.now() - begun[0]) if begun else 0.0)
    assert set(table["doubt"]) == {"drift"} and len(table) == 6
    assert np.all(table["force_drift"] < -0.3)
    assert "not at a constant pace" in "".join(capsys.readouterr())
