"""Maps that read the right file wrongly: exchanged columns, signs, frames, units, orders, quantities. Each is asked about."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from test_import_tables import ROBOT
from test_import_trials import HEADINGS, TWO_RESTS, table

from lab.cli import main

ANGLES = ("phi x [deg]", "phi y [deg]", "phi z [deg]")
HALF = ("mid x", "mid y", "mid z")
GROUPS = ((1,), (2,), (3,), (1, 2), (2, 3))
AZIMUTHS = np.radians([0.0, 120.0, 240.0])


def turned(group: tuple[int, ...], level: float) -> Rotation:
    """Of an arc away from the chambers inflated (mbar)."""
    away = -7e-4 * level * np.sum([[np.cos(AZIMUTHS[c - 1]), np.sin(AZIMUTHS[c - 1])] for c in group], axis=0)
    return Rotation.from_rotvec([-away[1], away[0], 0.0])


def cells(sweep: int, repeat: int, group: tuple[int, ...], level: int, row: int) -> list[str]:
    """Angles about fixed axes, and a marker at half the length."""
    angles = turned(group, TWO_RESTS[level]).as_euler("xyz", degrees=True)
    away = np.sum([[np.cos(AZIMUTHS[c - 1]), np.sin(AZIMUTHS[c - 1])] for c in group], axis=0) * -0.0125 * TWO_RESTS[level]
    return [f"{v:.3f}".replace(".", ",") for v in [*angles, *away, 75.0]]


RIGHT: dict[str, Any] = {
    "columns": {n: {"column": c} for n, c in zip(("t", "p1", "p2", "p3", "x", "y", "z"), HEADINGS, strict=True)},
    "orientation": {"columns": list(ANGLES), "order": "euler xyz"},
    "points": {"m1": {"of": [list(HALF)], "unit": "mm"}},
    "trials": {"begin": "rest"},
}
Change = Callable[[dict[str, Any]], object]


def exchange(a: str, b: str) -> Change:
    def change(values: dict[str, Any]) -> None:
        columns = values["columns"]
        columns[a], columns[b] = columns[b], columns[a]

    return change


def column(name: str, **more: Any) -> Change:
    return lambda values: values["columns"].setdefault(name, {}).update(more)


def also(**more: Any) -> Change:
    return lambda values: values.update(more)


def told(folder: Path, content: str, values: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> str:
    """What the import notes or refuses."""
    (folder / "a.csv").write_text(content)
    (folder / "robot.yaml").write_text(ROBOT.read_text().replace("markers: [0.05, 0.10]", "markers: [0.075]"))
    (folder / "map.yaml").write_text(yaml.safe_dump({"robot": "robot.yaml"} | values))
    code = main(["import", str(folder / "a.csv"), "--map", str(folder / "map.yaml"), "--out", str(folder / "case")])
    assert code in (0, 2)
    return " ".join(capsys.readouterr().err.split())


def test_a_right_map_is_not_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = table(TWO_RESTS, cells, (*ANGLES, *HALF), groups=GROUPS)
    assert told(tmp_path, content, RIGHT, capsys) == ""


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (exchange("p2", "p3"), "an exchange of columns p2 and p3 would do that, and so would one of x and y"),
        (exchange("p1", "p3"), "an exchange of columns p1 and p3 would do that"),
        (lambda v: (exchange("p1", "p2")(v), exchange("p2", "p3")(v)), "degrees from there about z: check x and y of the frame"),
        (exchange("x", "y"), "but to its mirror image: check x, y, their signs"),
        (column("x", scale=-1), "but to its mirror image"),
        (column("y", scale=-1), "the turn of the tip does not fit its place (agreement of directions"),
        (also(frame={"x": "y", "y": "-x", "z": "z"}), "degrees from there about z: check x and y of the frame"),
        (also(frame={"x": "y", "y": "z", "z": "x"}, straight="first state"), "y seems to be the robot's axis; check the frame"),
        (column("p2", scale=10), "column p2: the tip moves 0.1 times as far for the same pressure"),
        (column("p2", unit="psi"), "column p2: 2.41579e+06 Pa gauge, must be at most 2e+06 Pa: check its unit"),
        (column("p2", unit="kPa"), "the file says mbar, the map kPa"),
        (column("y", unit="cm"), "the file says mm, the map cm"),
        (lambda v: v["orientation"].update(order="euler XYZ"), "orientation.order euler XYZ: the tip turns by"),
        (lambda v: v["orientation"].update(order="rotation vector"), "with euler xyz by 0.0 deg: check the order"),
        (lambda v: v["orientation"].update(order="euler zyx"), "check orientation (columns, order, unit)"),
        (lambda v: v["orientation"].update(columns=list(ANGLES[::-1])), "check orientation (columns, order, unit)"),
        (lambda v: v.pop("points") and v["columns"].update({a: {"column": f"mid {a}", "unit": "mm"} for a in "xyz"}),
         "at rest the tip lies on the axis, 75 mm from the base of a robot of 150 mm"),
        (column("roll_deg", column="phi y [deg]"), "write it under orientation"),
        (lambda v: (column("roll_deg", column="phi y [deg]")(v), also(trials={"begin": "state"})(v)),
         "columns.roll_deg: the pressures account for"),
        (column("tip_mass", column=HEADINGS[1], unit="g"), "the file says mbar, the map g"),
        (column("tip_mass", column=HEADINGS[0], unit="g"), "is this column a mass that was hung there?"),
    ],
)  # fmt: skip
def test_a_wrong_map_is_asked_about(change: Change, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = copy.deepcopy(RIGHT)
    change(values)
    content = table(TWO_RESTS, cells, (*ANGLES, *HALF), groups=GROUPS)
    assert said in told(tmp_path, content, values, capsys)


def test_a_marker_that_moves_more_than_the_tip_is_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = copy.deepcopy(RIGHT) | {
        "straight": "first state",
        "points": {"m1": {"of": [list(HEADINGS[4:])], "unit": "mm"}},
    }
    values["columns"] |= {a: {"column": c, "unit": "mm"} for a, c in zip("xyz", HALF, strict=True)}
    content = table(TWO_RESTS, cells, (*ANGLES, *HALF), groups=GROUPS)
    assert "marker 1 moves 4 times as far as the tip: was it taken for it?" in told(tmp_path, content, values, capsys)


def test_units_that_differ_among_columns_alike_are_asked_about_where_the_file_says_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = table(TWO_RESTS, lambda *_: (), (), groups=GROUPS).replace(" [mm]", "").replace(" [mbar]", "")
    columns = {n: {"column": c.split(" [")[0]} for n, c in zip(("p1", "p2", "p3", "x", "y", "z"), HEADINGS[1:], strict=True)}
    columns |= {
        n: {**columns[n], "unit": u}
        for n, u in zip(("p1", "p2", "p3", "x", "y", "z"), ["mbar"] * 3 + ["mm", "mm", "cm"], strict=True)
    }
    columns["z"]["scale"] = 0.1
    found = told(tmp_path, content, {"columns": columns}, capsys)
    assert "columns x, y, z are read in mm, mm, cm, and the file does not say so" in found and "p1, p2" not in found
