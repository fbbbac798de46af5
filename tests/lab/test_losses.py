"""The table of losses that reports show."""

from __future__ import annotations

from pathlib import Path

from lab.rig.losses import losses
from recordings.file.writer import Recorder


def test_what_was_dropped_and_what_never_came_is_told_for_each_stream(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        for k in range(10):
            recorder.push("/valve", k * 0.1, on=True)
        recorder.push("/valve", 0.3, on=False)  # out of order: dropped
        recorder.push("/vacuum", 0.1, absolute=1e5)
        recorder.note_lost("/vacuum", 4)
    said, head, rows = losses([tmp_path / "a.mcap"])
    told = {row[1]: dict(zip(head, row, strict=True)) for row in rows}
    assert said.startswith("5 of 16 samples were lost") and set(told) == {"/valve", "/vacuum"}
    columns = ("generated", "written", "dropped", "lost in transit")
    assert [told["/valve"][c] for c in columns] == ["11", "10", "1", "0"]
    assert [told["/vacuum"][c] for c in columns] == ["1", "1", "0", "4"]


def test_a_recording_that_ended_abruptly_says_that_its_losses_are_unknown(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=10**18)
    recorder.push("/valve", 0.1, on=True)
    recorder.sync()
    said, head, (row,) = losses([tmp_path / "a.mcap"])
    assert said.startswith("No loss is known; 1 samples were recorded; of 1 of 1 streams it is not known whether any was lost")
    told = dict(zip(head, row, strict=True))
    assert (told["generated"], told["written"], told["dropped"]) == ("unknown", "1", "unknown")
    recorder.close("completed")
