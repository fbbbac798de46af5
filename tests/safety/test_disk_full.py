"""The disk fills up in the middle of a sweep: the run ends safe and says why, and the file keeps what was written."""

import resource
from pathlib import Path

import pytest
from house import House, until

from lab.verbs.run import _finish
from recordings.errors import WriteFailed
from recordings.file.journal import read
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.writer import Recorder

MORE = 30_000
"""Bytes that the file may still grow by; about a second's worth."""


@pytest.mark.real
def test_a_run_whose_disk_is_full_vents_says_so_and_leaves_a_file_without_holes(house: House, tmp_path: Path) -> None:
    program = house.start(tmp_path)
    (file,) = tmp_path.glob("*.mcap")
    resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (file.stat().st_size + MORE, resource.RLIM_INFINITY))
    assert until(lambda: house.highest() < 5e3 and not house.fakes.plant.valve_on)
    output, _ = program.communicate(timeout=600)
    text = " ".join(output.split())
    assert program.returncode == 1
    assert "recording stopped" in text and "lab recover" in text and "Traceback" not in text
    assert not house.latch.exists()
    found = recover(file, tmp_path / "recovered.mcap")
    recovered = Recording.open(tmp_path / "recovered.mcap")
    assert found.holes == 0 and len(recovered.states) > 0 and len(recovered.stream("/tip")) > 10
    assert read(file.with_suffix(".journal")).recordings == ((file.name, 1),)


def test_a_recording_that_takes_no_last_line_is_finished_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise WriteFailed("no room")

    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=10**18)
    monkeypatch.setattr(recorder, "log", full)
    recorder.push("/valve", 0.1, on=True)
    recorder.note_lost("/valve", 2)
    assert _finish(recorder, "failed", "a fault", safe=True) == {"/valve": 2}
    assert Recording.open(tmp_path / "a.mcap").outcome == "failed"
