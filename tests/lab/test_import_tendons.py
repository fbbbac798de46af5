"""Tables of robots with tendons: tensions in N under words of other languages, and a tip that goes towards the tendon pulled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from lab.cli import main
from lab.files.inputs import read_case

ROBOT = """\
name: trunk
length: 180 mm
outer_radius: 12 mm
inner_radius: 0 mm
density: 1080 kg/m^3
youngs_modulus: 320 kPa
shear_modulus: 107 kPa
tip_mass: 0 g
gravity: [0, 0, 9.81]
tendons:
  path_radius: 9 mm
  azimuths_deg: [0, 120, 240]
area_factor: 1.0
markers: [90 mm]
"""


def trunk(folder: Path, word: str) -> Path:
    """Three tendons pulled in turn to 4 N, twice; y of the cameras points up, against the hanging body."""
    folder.mkdir()
    (folder / "robot.yaml").write_text(ROBOT)
    tensions = [f"{word}{k} [N]" for k in (1, 2, 3)]
    lines = [";".join(["Zeit [s]", *tensions, *(f"{m}_{a} [mm]" for m in ("Spitze", "Mitte") for a in "xyz")])]
    t = 0.0
    for _ in range(2):
        for k in range(3):
            for pull in (0.0, 1.0, 2.0, 3.0, 4.0, 2.0, 0.0):
                turn, towards = 0.22 * pull, np.radians(120.0 * k)
                aside, along = 180 * (1 - np.cos(turn)) / max(turn, 1e-9), 180 * np.sinc(turn / np.pi)
                body = np.array([aside * np.cos(towards), aside * np.sin(towards), along])
                half = np.array([aside * np.cos(towards) / 4, aside * np.sin(towards) / 4, along / 2 + 0.01 * pull])
                seen = [
                    v for b in (body, half + [14, 0, 0]) for v in (700 + b[0], -b[2], 40 + b[1])
                ]  # 14 mm: on the skin
                row = [t, *(pull if k == j else 0.0 for j in range(3)), *seen]
                lines.append(";".join(f"{v:.3f}".replace(".", ",") for v in row))
                t += 3.0
    (folder / "table.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize("word", ["Seil_", "tension ", "F", "Zugkraft"])
def test_a_map_of_tensions_is_guessed_and_the_tip_goes_to_where_they_pull(
    word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = trunk(tmp_path / "lab", word)
    table, robot = str(lab / "table.csv"), str(lab / "robot.yaml")
    assert main(["import", table, "--guess", "--robot", robot, "--out", str(tmp_path / "map")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    proposed = yaml.safe_load((tmp_path / "map/map.yaml").read_text())
    assert [proposed["columns"][f"p{k}"] for k in (1, 2, 3)] == [
        {"column": f"{word}{k} [N]", "unit": "N/cm^2"} for k in (1, 2, 3)
    ]
    assert proposed["frame"] == {"x": "x", "y": "z", "z": "-y"} and "towards the tendons pulled" in said
    assert main(["import", table, "--map", str(tmp_path / "map/map.yaml"), "--out", str(tmp_path / "case")]) == 0
    assert "tensions pull it" not in capsys.readouterr().err
    proposed["frame"] = {"x": "-x", "y": "-z", "z": "-y"}
    (tmp_path / "map/turned.yaml").write_text(yaml.safe_dump(proposed))
    assert main(["import", table, "--map", str(tmp_path / "map/turned.yaml"), "--out", str(tmp_path / "other")]) == 0
    assert "does not go to where the tensions pull it" in " ".join(capsys.readouterr().err.split())


def test_a_robot_with_tendons_takes_no_column_of_pressures_for_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    (lab / "table.csv").write_text((lab / "table.csv").read_text().replace("Seil_1 [N]", "Seil_1 [kPa]", 1))
    code = main(
        ["import", str(lab / "table.csv"), "--guess", "--robot", str(lab / "robot.yaml"), "--out", str(tmp_path / "m")]
    )
    proposed = tmp_path / "m/map.yaml"
    assert code == 0 and "Seil_1 [kPa]" not in str(yaml.safe_load(proposed.read_text())["columns"].get("p1"))


@pytest.mark.parametrize("straight", ["first state", "first row"])
def test_markers_too_are_taken_from_the_straight_robot(straight: str, tmp_path: Path) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    columns = {f"p{k}": {"column": f"Seil_{k} [N]", "unit": "N/cm^2"} for k in (1, 2, 3)}
    columns |= {"t": {"column": "Zeit [s]"}} | {a: {"column": f"Spitze_{a} [mm]"} for a in "xyz"}
    values = {
        "robot": "robot.yaml", "columns": columns, "frame": {"x": "x", "y": "z", "z": "-y"}, "straight": straight,
        "constants": {"spine_length": 0}, "points": {"m1": {"of": [[f"Mitte_{a} [mm]" for a in "xyz"]], "unit": "mm"}},
    }  # fmt: skip
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    assert (
        main(["import", str(lab / "table.csv"), "--map", str(lab / "map.yaml"), "--out", str(tmp_path / "case")]) == 0
    )
    (first, *others) = read_case([tmp_path / "case"]).table.rows
    assert first.markers[0] == pytest.approx((0.0, 0.0, 0.09), abs=1e-9)
    assert max(abs(r.markers[0][0]) for r in others) > 0.005
