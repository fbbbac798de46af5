"""The shelf: what the files say, from an index that can be thrown away at any time."""

import os
from pathlib import Path

import pytest
from synthetic_run import TARGETS, state

from recordings.campaign.labels import RECORD, labels, split
from recordings.campaign.shelf import runs
from recordings.errors import BadMessage
from recordings.file.writer import Recorder


def record(path: Path, day: int, protocol: str, spine: float, lost: int = 0, end: str = "completed", **said: str) -> None:
    path.parent.mkdir(exist_ok=True)
    recorder = Recorder(path, start_wall_ns=1_700_000_000 * 10**9 + day * 86_400 * 10**9, metadata={RECORD: said} if said else {})
    for k in range(50):
        recorder.push("/pressure", k * 0.1, (TARGETS, TARGETS))
    recorder.state(0.0, state(protocol=protocol, spine_length=spine, topics=("/pressure",)))
    recorder.note_lost("/force", lost)
    recorder.close(end)


NAMES = ("a/one.mcap", "b/two.mcap", "b/three.mcap")


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    record(tmp_path / "a" / "one.mcap", 0, "bending", 0.1)
    record(tmp_path / "b" / "two.mcap", 3, "stiffness", 0.3, lost=4)
    record(tmp_path / "b" / "three.mcap", 1, "bending", 0.3, end="stopped")
    data = (tmp_path / "a" / "one.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 3 // 4])
    (tmp_path / "bad.mcap").write_text("t,x\n")
    return tmp_path


def test_outcome_and_losses_of_every_file_are_listed_oldest_first(shelf: Path) -> None:
    found = {run.path: run for run in runs(shelf)}
    assert [r.start for r in found.values()] == sorted(r.start for r in found.values())
    outcomes = ["completed", "completed", "stopped", "abrupt", "unreadable"]
    assert [found[name].outcome for name in (*NAMES, "cut.mcap", "bad.mcap")] == outcomes and len(found) == 5
    assert found["b/two.mcap"].lost == 4 and not found["b/two.mcap"].complete and found["a/one.mcap"].complete
    assert (found["a/one.mcap"].protocol, found["a/one.mcap"].spines) == ("bending", (0.1,))
    assert found["a/one.mcap"].duration == pytest.approx(4.9) and found["a/one.mcap"].start.startswith("2023-11-14")
    assert "not an MCAP file" in found["bad.mcap"].detail


def test_the_index_follows_the_files(shelf: Path) -> None:
    runs(shelf)
    (shelf / "b" / "two.mcap").unlink()
    os.replace(shelf / "a" / "one.mcap", shelf / "a" / "other.mcap")
    record(shelf / "new.mcap", 9, "elongation", 0.2)
    names = [run.path for run in runs(shelf)]
    assert "b/two.mcap" not in names and "a/one.mcap" not in names and {"a/other.mcap", "new.mcap"} <= set(names)


def test_files_that_did_not_change_are_not_read_again(shelf: Path) -> None:
    first = runs(shelf)
    target = shelf / "a" / "one.mcap"
    status = target.stat()
    target.write_bytes(bytes(status.st_size))
    os.utime(target, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert runs(shelf) == first
    os.utime(target)
    assert next(r for r in runs(shelf) if r.path == "a/one.mcap").outcome == "unreadable"


def test_runs_are_picked_by_what_a_person_said_of_them(tmp_path: Path) -> None:
    record(tmp_path / "one.mcap", 0, "bending", 0.1, operator="Ada", specimen="S 7", batch="a=b")
    record(tmp_path / "two.mcap", 1, "bending", 0.1, operator="Ada")
    record(tmp_path / "three.mcap", 2, "bending", 0.1)
    names = lambda *where: [run.path for run in runs(tmp_path, where=where)]  # noqa: E731
    assert names(("operator", "Ada")) == ["one.mcap", "two.mcap"]
    assert names(("operator", "Ada"), ("batch", "a=b")) == ["one.mcap"] and names(("specimen", "S")) == []
    assert [run.labels for run in runs(tmp_path)] == [
        {"operator": "Ada", "specimen": "S 7", "batch": "a=b"}, {"operator": "Ada"}, {},
    ]  # fmt: skip


@pytest.mark.parametrize(
    "pairs", [[("a", "")], [("a", " ")], [("a", "x" * 201)], [("a", "1"), ("a", "2")], [("a", "M\udcfcller")]]
)
def test_labels_that_say_nothing_too_much_or_twice_are_refused(pairs: list[tuple[str, str]]) -> None:
    with pytest.raises(BadMessage, match="a"):
        labels(pairs)


@pytest.mark.parametrize("text", ["a", "=b", "A=b", "a b=c", "1=2", "x" * 31 + "=y"])
def test_a_label_is_a_key_and_a_value(text: str) -> None:
    with pytest.raises(BadMessage, match="KEY=VALUE"):
        split(text)
    assert split("a=b=c") == ("a", "b=c")
