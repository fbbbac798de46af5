"""The journal and the campaign: what is finished stays finished, what was broken off counts as it was done last. The shelf: what
the files say, from an index that can be thrown away at any time."""

import os
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import TARGETS, state

from recordings.campaign.labels import RECORD, labels, split
from recordings.campaign.replay import campaigns, merged, metadata
from recordings.campaign.shelf import runs
from recordings.errors import BadJournal, BadMessage, WriteFailed
from recordings.file.journal import Journal, read
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.trials import TrialRow
from tests.simulated.bench import raises

WALL = 1_700_000_000 * 10**9


def begun(path: Path) -> Journal:
    journal = Journal.begin(path / "run.mcap", "bending")
    for trial in (1, 2):
        for step in (1, 2, 3):
            journal.step(trial, step)
        journal.done(trial, 3)
    journal.step(3, 1)
    return journal


def test_a_journal_torn_at_any_byte_tells_what_was_whole_and_can_go_on(tmp_path: Path) -> None:
    begun(tmp_path).close()
    path = tmp_path / "run.journal"
    data = path.read_bytes()
    begin = data.index(b"}", data.index(b"recording")) + 2
    for cut in range(begin, len(data) + 1):
        path.write_bytes(data[:cut])
        finished = data[:cut].count(b'"done": 3}\n')
        assert read(path).finished == finished
        with Journal.reopen(path) as journal:
            journal.recording(tmp_path / "second.mcap", finished + 1)
            journal.done(finished + 1, 2)
        assert read(path).finished == finished + 1 and read(path).protocol == "bending"
        assert read(path).done == {trial: 3 if trial <= finished else 2 for trial in range(1, finished + 2)}
        assert read(path).recordings == (("run.mcap", 1), ("second.mcap", finished + 1))


def test_a_trial_that_is_begun_again_is_open_until_it_is_done_again(tmp_path: Path) -> None:
    with begun(tmp_path) as journal:
        journal.recording(tmp_path / "second.mcap", 2)
        assert read(journal.path).finished == 1
        journal.done(2, 3)
        assert read(journal.path).finished == 2


def test_a_gap_in_the_finished_trials_ends_what_is_finished(tmp_path: Path) -> None:
    with Journal.begin(tmp_path / "run.mcap", "bending") as journal:
        journal.done(1, 1)
        journal.done(3, 1)
        assert read(journal.path).finished == 1


@pytest.mark.parametrize("text", ["", "x\n", '{"trial": 1, "done": 3}\n', "[]\n", '{"journal": 9, "campaign": ""}\n'])
def test_what_is_no_journal_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.journal").write_text(text)
    raises(BadJournal, r"run\.journal", read, tmp_path / "run.journal")
    raises(WriteFailed, "cannot be written", Journal.begin, tmp_path / "run.mcap", "bending")


def record(path: Path, start: int, campaign: dict[str, dict[str, str]], rows: list[tuple[int, int]]) -> Recording:
    with Recorder(path, start_wall_ns=start, metadata=campaign) as recorder:
        for k, (trial, step) in enumerate(rows):
            number = recorder.state(float(k), state(trial=trial, step=step, topics=("/pressure",)))
            recorder.trial(float(k), number, TrialRow(trial, step, "bending", 1, "load", float(k), 0.1, TARGETS))
            recorder.push("/pressure", float(k), (TARGETS, TARGETS))
    return Recording.open(path)


def test_a_resumed_campaign_makes_one_table_without_doubles_and_time_goes_on(tmp_path: Path) -> None:
    first = record(tmp_path / "1.mcap", WALL, metadata("c", "j", 1), [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1)])
    second = record(tmp_path / "2.mcap", WALL + 60 * 10**9, metadata("c", "j", 3), [(3, 1), (3, 2), (4, 1)])
    third = record(tmp_path / "3.mcap", WALL + 61 * 10**9, metadata("c", "j", 4), [(4, 1), (4, 2)])
    alone = record(tmp_path / "4.mcap", WALL, {}, [(1, 1)])
    campaign, other = map(merged, campaigns([third, first, alone, second]))
    assert [(r.trial, r.step) for r in campaign] == [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2), (4, 1), (4, 2)]
    assert campaign["t"].tolist() == [0, 1, 2, 3, 60, 61, 62, 63]
    assert [(r.trial, r.step) for r in other] == [(1, 1)]


def test_recordings_of_a_campaign_follow_each_other_however_far_back_their_rig_time_began(tmp_path: Path) -> None:
    first = record(tmp_path / "1.mcap", WALL, metadata("c", "j", 1), [(1, 1), (1, 2), (2, 1)])
    # Of two recordings the later began its rig time earlier: the rig was opened slowly, or runs faster than real time.
    second = record(tmp_path / "2.mcap", WALL - 60 * 10**9, metadata("c", "j", 2), [(2, 1), (2, 2)])
    campaign = merged([second, first])
    assert [(r.trial, r.step) for r in campaign] == [(1, 1), (1, 2), (2, 1), (2, 2)]
    assert (np.diff(campaign["t"]) > 0).all()


# ------------------------------------------------------------------ the shelf
def recorded(path: Path, day: int, protocol: str, spine: float, lost: int = 0, end: str = "completed", **said: str) -> None:
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
    recorded(tmp_path / "a" / "one.mcap", 0, "bending", 0.1)
    recorded(tmp_path / "b" / "two.mcap", 3, "stiffness", 0.3, lost=4)
    recorded(tmp_path / "b" / "three.mcap", 1, "bending", 0.3, end="stopped")
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
    recorded(shelf / "new.mcap", 9, "elongation", 0.2)
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
    recorded(tmp_path / "one.mcap", 0, "bending", 0.1, operator="Ada", specimen="S 7", batch="a=b")
    recorded(tmp_path / "two.mcap", 1, "bending", 0.1, operator="Ada")
    recorded(tmp_path / "three.mcap", 2, "bending", 0.1)
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
    raises(BadMessage, "a", labels, pairs)


@pytest.mark.parametrize("text", ["a", "=b", "A=b", "a b=c", "1=2", "x" * 31 + "=y"])
def test_a_label_is_a_key_and_a_value(text: str) -> None:
    raises(BadMessage, "KEY=VALUE", split, text)
    assert split("a=b=c") == ("a", "b=c")
