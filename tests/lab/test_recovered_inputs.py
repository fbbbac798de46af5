"""Commands take a torn recording together with its recovered file, as `runs/*.mcap` gives them after `lab recover`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from lab.cli import main
from recordings.file.reader import Recording

RECORDING = Path(__file__).parent.parent / "recordings" / "data" / "bending-schema-1.mcap"


@pytest.fixture
def torn(tmp_path: Path) -> tuple[Path, Path]:
    """A recording without its end, and what `lab recover` saved of it."""
    file = tmp_path / "sweep.mcap"
    file.write_bytes(RECORDING.read_bytes()[:-9000])
    assert main(["recover", str(file)]) == 3
    return file, tmp_path / "sweep-recovered.mcap"


@pytest.mark.parametrize("words", [["replay"], ["export", "--out", "streams"], ["export", "--case", "--out", "case"]])
def test_a_torn_recording_is_left_out_where_its_recovered_file_is_given(
    torn: tuple[Path, Path],
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    assert main([words[0], *(file.name for file in torn), *words[1:]]) == 0
    told = capsys.readouterr().err
    assert told.count("note: sweep.mcap: not read") == 1 and "sweep-recovered.mcap" in told
    assert main([words[0], "sweep.mcap", *words[1:]]) == 1  # alone it is refused as before
    assert "lab recover" in capsys.readouterr().err


def test_a_whole_recording_counts_and_not_what_was_recovered_of_it_earlier(
    torn: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, saved = torn
    shutil.copy(RECORDING, file)
    capsys.readouterr()
    assert main(["replay", str(saved), str(file), "--json"]) == 0
    done = capsys.readouterr()
    assert json.loads(done.out)["replayed"] == len(Recording.open(RECORDING).trials)
    assert "sweep-recovered.mcap: not read" in done.err.replace("\n", "")


def test_a_refused_export_leaves_no_folder(torn: tuple[Path, Path], tmp_path: Path) -> None:
    assert main(["export", str(torn[0]), "--out", str(tmp_path / "new" / "streams")]) == 1
    assert not (tmp_path / "new").exists()
    (tmp_path / "old").mkdir()
    assert main(["export", str(torn[0]), "--out", str(tmp_path / "old")]) == 1
    assert (tmp_path / "old").exists()
