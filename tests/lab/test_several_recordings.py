"""`lab info` and `lab replay` take several recordings, as a shell's `runs/*.mcap` gives them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from lab.cli import main
from lab.verbs.run import recording_of

RECORDING = Path("tests/recordings/data/bending-schema-1.mcap")


@pytest.fixture
def two(tmp_path: Path) -> tuple[str, str]:
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    for file in (first, second):
        shutil.copy(RECORDING, file)
    return str(first), str(second)


def test_each_of_several_recordings_is_told_by_its_name(two: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    one = main(["replay", two[0], "--json"])
    whole = json.loads(capsys.readouterr().out)
    assert main(["replay", *two, "--json"]) == one
    assert json.loads(capsys.readouterr().out) == [{"file": file, **whole} for file in two]
    code = main(["info", two[0]])
    capsys.readouterr()
    assert main(["info", *two]) == code
    said = capsys.readouterr().out
    assert all(Path(file).name in said.replace("\n", "") for file in two)


def test_only_one_recording_is_played(two: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", *two, "--play"]) == 2
    assert "--play: give one recording" in capsys.readouterr().err


def test_names_sort_as_the_runs_began(tmp_path: Path) -> None:
    begun = [1_790_000_000_000_000_000 + ms * 1_000_000 for ms in (250, 714, 999, 1000)]
    files = []
    for started_ns in begun:
        files.append(recording_of(tmp_path, "bending", started_ns))
        files[-1].touch()
    assert sorted(tmp_path.glob("*.mcap")) == files and len(set(files)) == len(begun)
