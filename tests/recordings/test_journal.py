"""The journal and the campaign: what is finished stays finished, what was broken off counts as it was done last."""

from pathlib import Path

import numpy as np
import pytest
from synthetic_run import TARGETS, state

from recordings.campaign.replay import campaigns, merged, metadata
from recordings.errors import BadJournal, WriteFailed
from recordings.file.journal import Journal, read
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.trials import TrialRow

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
    with pytest.raises(BadJournal, match=r"run\.journal"):
        read(tmp_path / "run.journal")
    with pytest.raises(WriteFailed, match="cannot be written"):
        Journal.begin(tmp_path / "run.mcap", "bending")


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
