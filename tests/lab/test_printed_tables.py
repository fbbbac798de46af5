"""What the tables of `fit`, `compare`, `predict`, `power` and `fakes` say: one number for each quantity, names in full."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml
from diagnosed_case import campaign, folder
from virtual_lab import VirtualLab

import lab
from lab.cli import main
from lab.files.config import ConfigError

THREE = Path(__file__).parents[2] / "examples" / "three_chambers" / "robot.yaml"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder(tmp_path_factory.mktemp("case") / "case", campaign({}, repeats=1, lengths=(0.0, 0.15)))


def said(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    capsys.readouterr()
    assert main([str(word) for word in words]) == 0
    return capsys.readouterr().out


def test_fit_gives_one_area_factor_for_all_lengths(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = said(capsys, "fit", case)
    found = json.loads(said(capsys, "fit", case, "--json"))["area_factor"]
    (row,) = [line for line in told.splitlines() if "factor, tolerances" in line]
    assert f"{found['value']:.3f} ± {found['standard_error']:.3f}" in row
    assert f"{lab.fit(lab.case(case)).area_factor.factor.value:.3f}" in row  # type: ignore[union-attr]
    assert len(re.findall(r"\d\.\d+ ± ", told)) == 3  # two lengths and all
    rows = (case / "trials.csv").read_text().count("\n") - 1
    counts = [int(line.split("│")[4]) for line in told.splitlines() if "area factor, " in line]
    assert counts[-1] == rows == sum(counts[:-1])


def test_compare_names_the_axes_of_the_paper_for_its_robot_only(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "% in X, " in said(capsys, "compare", case)
    data = yaml.safe_load((case / "robot.yaml").read_text())
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(data | {"length": 0.41}))
    told = said(capsys, "compare", case, "--robot", tmp_path / "robot.yaml")
    assert "paper" not in told and "plane" not in told
    assert re.search(r"n\W+x\W+y\W+z\W+rms", told) and re.search(r"in x, .* in y, .* in z", " ".join(told.split()))


def test_predict_has_a_column_for_each_of_few_pressures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "states.csv"
    table.write_text("p1,p2,p3\n20000,20000,0\n20000,0,0\n")
    told = said(capsys, "predict", "--robot", THREE, "--table", table)
    rows = [[cell.strip() for cell in line.split("│")[1:4]] for line in told.splitlines() if line.startswith("│")]
    assert "p3" in told and rows == [["20.0", "20.0", "0.0"], ["20.0", "0.0", "0.0"]]


def test_power_names_causes_in_full_and_says_what_it_does(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--set", "pressures=[120 kPa]", "--worlds", 2, "--no-additions")
    told = said(capsys, "power", "--protocol", "bending", "--robot", case / "robot.yaml", *words)
    assert "…" not in told and "tip moved /" in told
    assert told.index("clean: 2 worlds of each") < told.index("cluttered: 2 worlds of each") < told.index("How often")


def test_the_effects_of_the_fakes_are_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    told = said(capsys, "fakes", "--list-effects")
    assert "plausible size" in told and re.search(r"spine_slip\W+0\.15 N m\W", told)
    (row,) = [line for line in told.splitlines() if "vacuum_leak" in line]
    assert row.split("│")[2].strip() == "0.3"


def test_a_folder_of_recordings_is_no_case(tmp_path: Path) -> None:
    (tmp_path / "one.mcap").touch()
    with pytest.raises(ConfigError, match="is a folder of recordings, not a case folder"):
        lab.case(tmp_path)


def test_check_shows_limits_with_their_units(virtual_lab: VirtualLab, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--rig", str(virtual_lab.rig), "--seconds", "0"]) in (0, 3)
    limits = [line.split("│")[-2] for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    told = "".join("".join(limits).split())
    assert re.search(r"pressure\d+kPa,rate\d+kPa/s", told) and re.search(r"turn[\d.]+rad", told)
