"""`lab diagnose` of poses of an arm, whose own kinematics are closed formulas of trigonometry."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from commands import Cli
from scipy.spatial.transform import Rotation

import lab
from model.arrays import Array

ARM: dict[str, Any] = {
    "name": "four joints",
    "links": [{"a": 0, "d": 0.3, "alpha_deg": 90}, *({"a": a, "d": 0, "alpha_deg": 0} for a in (0.4, 0.3, 0.1))],
    "tool": [0, 0, 0.05],
}
ZERO = 0.0025
"""rad of joint 3."""


def reached(q: Array, zero: float = ZERO) -> Array:
    """A turntable that carries a planar arm of three links, its point 5 cm beside the plane."""
    yaw, pitch = q[:, 0], np.cumsum(q[:, 1:] + [0, zero, 0], axis=1)
    out, up = (
        sum(length * wave(angle) for length, angle in zip((0.4, 0.3, 0.1), pitch.T, strict=True)) for wave in (np.cos, np.sin)
    )
    return np.column_stack([out * np.cos(yaw) + 0.05 * np.sin(yaw), out * np.sin(yaw) - 0.05 * np.cos(yaw), 0.3 + up])


def poses(count: int = 24, repeats: int = 2, seed: int = 0, zero: float = ZERO) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    q = np.tile(rng.uniform(-1.4, 1.4, (count, 4)), (repeats, 1))
    at = reached(q, zero) + rng.normal(0, 5e-5, (len(q), 3))
    return pd.DataFrame(np.hstack([q, at]), columns=["q1", "q2", "q3", "q4", "x", "y", "z"])


def diagnosed(cli: Cli, folder: Path, table: pd.DataFrame, *words: object, arm: dict[str, Any] = ARM, code: Any = 0) -> Any:
    (folder / "arm.yaml").write_text(yaml.safe_dump(arm))
    table.to_csv(folder / "poses.csv", index=False)
    return cli("diagnose", folder / "poses.csv", "--robot", folder / "arm.yaml", *words, code=code)


def test_a_joint_s_zero_is_named_with_its_size_and_mm(cli: Cli, tmp_path: Path) -> None:
    poses(30, 1, seed=1)[["q1", "q2", "q3", "q4"]].to_csv(tmp_path / "next.csv", index=False)
    poses(20, 1, seed=2).to_csv(tmp_path / "held.csv", index=False)
    report, answer = tmp_path / "diagnosis.html", tmp_path / "diagnosis.json"
    words = ("--candidates", tmp_path / "next.csv", "--holdout", tmp_path / "held.csv", "--json", answer, "--report", report)
    done = diagnosed(cli, tmp_path, poses(), *words)
    found = json.loads(answer.read_text())
    assert found["schema"] == "diagnosis/1" and found["attribute"]["effects"] == ["joint_zeros"]
    (named,) = [r for r in found["attribute"]["ranking"] if r["effects"] == ["joint_zeros"]]
    zero = next(p for p in named["parameters"] if p["key"] == "zero_3")
    assert abs(zero["value"] - ZERO) < 4 * zero["sd"] < 1e-3 and found["attribute"]["probability"] > 0.9
    moved = found["budget"]["joint_zeros"]
    assert next(iter(found["budget"])) == "joint_zeros" and 0.2e-3 < np.hypot(moved["x"], moved["z"]) < 2e-3
    before, after = (np.hypot(*(step["unseen"]["by_output"][axis] for axis in "xz")) for step in found["steps"][1:3])
    assert after < 1e-4 < 3e-4 < before
    assert re.fullmatch(r".*next\.csv line \d+", found["next_experiment"][0]["at"])
    distance = re.search(r"not fitted: mean distance ([\d.]+) mm as described, ([\d.]+) mm with .*, ([\d.]+) mm with", done.flat)
    assert distance is not None and max(float(distance[2]), float(distance[3])) < 0.12 < float(distance[1])
    page = report.read_text()
    for text in ("joints read zero at another angle", "four joints", " mm", "zero_3", "next.csv line", "data:image/svg+xml"):
        assert text in page
    assert not re.search(r"<script|src=\"(?!data:)|href=\"(?!#)", page)


def test_an_arm_as_described_has_no_cause(cli: Cli, tmp_path: Path) -> None:
    assert "No cause" in diagnosed(cli, tmp_path, poses(zero=0.0)).flat_out


def test_base_units_and_single_cells_of_a_foreign_table_may_differ(cli: Cli, tmp_path: Path) -> None:
    """Positions in the instrument's own frame and in mm, angles in deg, two cells that are empty, two rows of something else."""
    table, angles = poses(), [f"q{k}" for k in range(1, 5)]
    turn = Rotation.from_euler("xyz", [90, 20, 130], degrees=True)
    table[["x", "y", "z"]] = 1e3 * (turn.apply(np.array(table[["x", "y", "z"]])) + [1.2, -3.0, 0.4])
    table[angles] = np.degrees(table[angles])
    table.loc[3, "x"], table.loc[5, "q2"], table.loc[7, "q4"], table.loc[9, "z"] = np.nan, np.inf, 4000.0, 150.0
    units = {**{q: f"{q} [deg]" for q in angles}, **{x: f"{x} (mm)" for x in "xyz"}}
    done = diagnosed(cli, tmp_path, table.rename(columns=units))
    assert "joints read zero at another angle" in done.flat_out
    for text in ("line 5, x: is not a finite number", "line 7, q2: is not a finite", "line 9: an angle beyond two turns",
                 "line 11: the position is", "base and tool are taken where these poses show them: the base 3"):  # fmt: skip
        assert text in done.flat_err


def test_the_next_poses_lie_within_the_limits_of_the_joints(cli: Cli, tmp_path: Path) -> None:
    limited = {**ARM, "links": [{**link, "limits_deg": [-40, 60]} for link in ARM["links"]]}
    diagnosed(cli, tmp_path, poses(), "--json", tmp_path / "answer.json", arm=limited)
    proposed = json.loads((tmp_path / "answer.json").read_text())["next_experiment"]
    assert proposed and all(-0.7 < angle < 1.05 for p in proposed for angle in p["inputs"].values())


DEGREES, MM = [180 / np.pi] * 4 + [1.0] * 3, [1.0] * 4 + [1e3] * 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t * DEGREES, r"at most 0.05: the numbers look like deg: write units into the headings, q1 \[deg\]"),
        (lambda t: t * MM, r"far: angles of .* look like mm: write"),
        (lambda t: t * DEGREES * MM, r"look like deg and mm: write"),
        (lambda t: t.assign(q2=-t["q2"]), "q2 is counted the other way: change its sign"),
        (lambda t: t.assign(z=-t["z"]), "left-handed: change the sign of z"),
        (lambda t: t.assign(q3=t["q1"]), "check order, signs and zeros of the joints"),
        (lambda t: t.drop(columns="q3"), r"no column q3.*the first line must name q1 \.\. q4 in rad and x, y, z in m"),
        (lambda t: t.rename(columns={"q3": "Q3"}), r"no column q3 \(is it the column 'Q3'\?\)"),
        (lambda t: t.rename(columns={"x": "x [furlong]"}), r"x \[furlong\]: .*furlong"),
        (lambda t: t.iloc[:6], "6 poses, must be at least 9 to weigh any cause of four joints: measure more"),
        (lambda t: t.assign(x=np.nan), "no row has all of q1, q2, q3, q4, x, y, z"),
        (lambda t: t.assign(x="abc"), "poses.csv line 2, x: 'abc' is not a number"),
    ],
)  # fmt: skip
def test_bad_poses_are_one_clear_error(change: Any, message: str, cli: Cli, tmp_path: Path) -> None:
    done = diagnosed(cli, tmp_path, change(poses()), code=2)
    assert re.search(message, done.flat_err) and "poses.csv" in done.flat_err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--protocols", "next"), "--protocols: is for soft robots"),
        (("--candidates", "none.csv"), "none.csv"),
        (("--report", "no/such/folder.html"), "cannot be written"),
        (("--robot", "arn.yaml"), "arn.yaml"),
    ],
)
def test_options_that_do_not_fit_are_refused(words: tuple[str, ...], message: str, cli: Cli, tmp_path: Path) -> None:
    assert message in diagnosed(cli, tmp_path, poses(), *words, code=(1, 2)).flat_err


def test_the_page_and_json_serve_an_answer_about_any_model(tmp_path: Path) -> None:
    rows = pd.DataFrame({"load": np.tile(np.linspace(0, 1, 12), 3)})
    rng = np.random.default_rng(0)

    def beam(theta: dict[str, float], inputs: pd.DataFrame) -> Array:
        load = inputs["load"].to_numpy()
        return np.column_stack([load * theta["soft"] + theta["hinge"] * np.sqrt(load), 300 + 20 * load + theta["heat"] * load**3])

    true = {"soft": 0.011, "hinge": 0.004, "heat": 0.0}
    measured = beam(true, rows) + rng.normal(0, [5e-5, 0.1], (36, 2))
    causes = [lab.Cause("hinge", {"hinge": (0.0, 0.003, "m")}, says="the hinge <gives>"),
              lab.Cause("heat", {"heat": (0.0, 2.0, "K")}, says="the beam warms up")]  # fmt: skip
    answer = lab.diagnose_model(beam, rows.assign(sag=measured[:, 0], warmth=measured[:, 1]), {"sag": "m", "warmth": "K"}, causes,
                                {"soft": (0.01, 0.003, "m")}, candidates=pd.DataFrame({"load": [0.1, 2.0]}))  # fmt: skip
    page = lab.save(answer, tmp_path / "kept" / "here").read_text()
    found = json.loads((tmp_path / "kept" / "here" / "diagnosis.json").read_text())
    assert found["attribute"]["effects"] == ["hinge"] and found["next_experiment"][0]["inputs"] == {"load": 2.0}
    assert "the hinge &lt;gives&gt;" in page and "measure at load = 2" in page and re.search(r"[\d.]+ mm, [\d.]+ K", page)
