"""A state on whose way set-points were clipped says so in the recording and in the table, and older readers are not disturbed."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from synthetic_run import state

from recordings.campaign.replay import compare, table_of
from recordings.errors import BadTable
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.states.concluding import conclude
from recordings.states.rules import Window
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table, TrialRow

STATE = state(rule=Window(0.0, 0.5, 3), targets=(50e3,) * 9, topics=("/pressure",), clipped=True)
ROW = TrialRow(
    trial=1, step=1, protocol="bending", repeat=1, branch="load", t=0.5, spine_length=0.1, pressures=(50e3,) * 9,
    tip=(0.0, 0.0, 0.4), clipped=True,
)  # fmt: skip


def test_the_text_that_older_readers_take_apart_does_not_mention_it() -> None:
    for marked, plain in ((STATE, replace(STATE, clipped=False)), (ROW, replace(ROW, clipped=False))):
        assert "clipped" not in json.loads(marked.to_json())
        assert marked.to_json() == plain.to_json()


@pytest.mark.parametrize("clipped", [True, False])
def test_it_is_recorded_with_the_state_and_concluded_again(tmp_path: Path, clipped: bool) -> None:
    path = tmp_path / "a.mcap"
    with Recorder(path, start_wall_ns=10**18) as recorder:
        number = recorder.state(0.0, replace(STATE, clipped=clipped))
        push = recorder.sink("/pressure")
        for k in range(1, 12):
            push(SimpleNamespace(t=0.1 * k, setpoint=(50e3,) * 9, measured=(49e3 + k,) * 9))
        row = conclude(recorder.buffers, replace(STATE, clipped=clipped))
        assert row is not None
        recorder.trial(1.2, number, row)
    recording = Recording.open(path)
    assert [event.state.clipped for event in recording.states] == [clipped]
    assert [row.clipped for row in table_of(recording)] == [clipped]
    assert compare(recording).equal


def test_the_table_has_the_column_only_when_a_state_was_clipped(tmp_path: Path) -> None:
    plain = replace(ROW, step=2, clipped=False)
    assert "clipped" not in Table((plain,)).columns
    write_csv(Table((ROW, plain)), tmp_path / "trials.csv")
    again = read_csv(tmp_path / "trials.csv")
    assert [row.clipped for row in again] == [True, False]
    assert again.clipped == (again.rows[0],)
    text = (tmp_path / "trials.csv").read_text()
    head, first, second = text.splitlines()
    assert head.endswith(",clipped") and first.endswith(",1") and second.endswith(",")
    (tmp_path / "trials.csv").write_text(text.replace("0.4,1\n", "0.4,2\n"))
    with pytest.raises(BadTable, match="clipped: 2 is neither 0 nor 1"):
        read_csv(tmp_path / "trials.csv")
