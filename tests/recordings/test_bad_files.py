"""What was found by mutating files: each is one clear error."""

import json
from pathlib import Path

import pytest
from synthetic_run import state

from recordings.campaign.shelf import INDEX, runs
from recordings.errors import BadJournal, BadMessage, BadTable
from recordings.file.counts import counted
from recordings.file.journal import read as read_journal
from recordings.json_text import read_json
from recordings.states.rules import Settled, State
from recordings.table_file import read_csv
from recordings.trials import TrialRow
from tests.simulated.bench import raises

HEAD = "trial,step,protocol,repeat,branch,t,spine_length,p1,x,y,z"
ROW = "1,1,bending,1,load,1,0,0,0,0,0"
STATE = state(rule=Settled())


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 5000, "9" * 5000, '"\\ud800"', "", b"\xff", "\0", "[" * 60 + "]" * 60])
def test_json_that_is_too_deep_too_long_or_no_json_is_a_value_error(text: str | bytes) -> None:
    raises(ValueError, None, read_json, text)


def test_json_with_many_flat_lists_and_brackets_in_texts_is_read() -> None:
    for value in ([[1]] * 1000, ["[" * 100, '"{\\"' * 50], {"a": "\U0001f600"}):
        assert read_json(json.dumps(value)) == value


@pytest.mark.parametrize(
    ("where", "key", "value"),
    [
        ("rule", "smooth", 10**9), ("rule", "smooth", 0),
        ("rule", "min_samples", 0), ("rule", "average", -1.0), ("rule", "timeout", "60"), ("rule", "band", None),
        ("rule", "still", 1e999),
        ("", "targets", {}), ("", "targets", [[1]]), ("", "t_start", "x"), ("", "trial", 1.5), ("", "trial", 10**400),
        ("", "branch", []), ("", "topics", "/tip"), ("", "probe", []), ("", "spine_length", True),
    ],
)  # fmt: skip
def test_a_state_with_a_value_of_another_kind_is_refused(where: str, key: str, value: object) -> None:
    values = json.loads(STATE.to_json())
    (values[where] if where else values)[key] = value
    raises(BadMessage, None, State.from_json, json.dumps(values))
    assert State.from_json(STATE.to_json()).to_json() == STATE.to_json()


@pytest.mark.parametrize(
    ("name", "value"), [("t", "x"), ("trial", 1.5), ("m999999999x", 1.0), ("protocol", 1), ("p1", [1]), ("x", None)]
)
def test_a_row_with_a_value_of_another_kind_is_refused(name: str, value: object) -> None:
    row = ("trial", 1), ("step", 1), ("protocol", "bending"), ("repeat", 1), ("branch", "load"), ("t", 1.0), ("spine_length", 0.1)
    cells = {**dict(row), "p1": 0.0}
    TrialRow.from_json(json.dumps(cells))
    raises(BadTable, None, TrialRow.from_json, json.dumps(cells | {name: value}))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a," * 100_000, "columns"), (f"{HEAD},m999999999x\n{ROW},1", None), (f"{HEAD}\n1e300{ROW[1:]}", "exceeds"),
        (f"{HEAD}\n{ROW[:-1]}{'9' * 5000}", "leave the cell empty"), (f"{HEAD}\n{ROW[:-1]}1e999", "leave the cell empty"),
        (f'{HEAD}\n"{"x" * 200_000}"', "not a text table"), ("\0", "no column"), ("\n" * 1000, "is empty"),
    ],
)  # fmt: skip
def test_a_table_beyond_all_measure_is_refused_at_once(tmp_path: Path, text: str, word: str | None) -> None:
    (tmp_path / "trials.csv").write_text(text)
    if word is None:
        assert read_csv(tmp_path / "trials.csv").ignored == ("m999999999x",)
        return
    raises(BadTable, word, read_csv, tmp_path / "trials.csv")


@pytest.mark.parametrize(
    "line", ["[" * 100_000, '{"trial": 1e999, "done": 1}', '{"trial": [], "done": 1}', '{"trial": 1, "done": -1}', "\0"]
)
def test_a_journal_with_such_a_line_is_refused(tmp_path: Path, line: str) -> None:
    (tmp_path / "a.journal").write_text(
        f'{{"journal": 1, "campaign": "c", "protocol": "bending"}}\n{{"recording": "a.mcap", "first_trial": 1}}\n{line}\n'
    )
    raises(BadJournal, "cannot be understood", read_journal, tmp_path / "a.journal")


def test_counts_that_are_none_are_left_out() -> None:
    told = {"/tip": '{"written": 5, "lost": 1e999, "dropped": ' + "9" * 30 + ', "generated": -1}', "/arm": "[" * 100_000}
    assert counted({"counts": told}) == {"/tip": {"written": 5}}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("spines", "["), ("spines", ["x"]), ("spines", 1), ("duration", "x"), ("size", "x"), ("path", None), ("path", []),
        ("labels", {"a": 1}), ("labels", []), ("planned", 1.5), ("more", 1), ("changed", "x"), ("changed", 1e999),
    ],
)  # fmt: skip
def test_an_index_that_was_changed_is_made_anew(tmp_path: Path, key: str, value: object) -> None:
    (tmp_path / "bad.mcap").write_text("no recording")
    before = runs(tmp_path)
    index = json.loads(sound := (tmp_path / INDEX).read_text())
    index["runs"][0][key] = value
    (tmp_path / INDEX).write_text(json.dumps(index))
    assert runs(tmp_path) == before and [run.outcome for run in before] == ["unreadable"]
    assert (tmp_path / INDEX).read_text() == sound


@pytest.mark.parametrize(
    "text", ["", "no index at all" * 100, "[" * 100_000, "[]", '{"version": 6, "runs": 1}', '{"version": 1}', "\0"]
)
def test_an_index_that_is_none_is_made_anew(tmp_path: Path, text: str) -> None:
    (tmp_path / INDEX).write_text(text)
    assert runs(tmp_path) == []
    (tmp_path / "bad.mcap").write_text("no recording")
    (tmp_path / INDEX).write_text(text)
    assert [run.outcome for run in runs(tmp_path)] == ["unreadable"]
