"""Files that the software names itself go through no link, and are there whole or not at all; bad ones are one clear error."""

import json
import os
from pathlib import Path

import pytest
from synthetic_run import state

from recordings.campaign.shelf import INDEX, runs
from recordings.errors import BadJournal, BadMessage, BadTable, RecordingError, WriteFailed
from recordings.file.counts import counted
from recordings.file.journal import Journal
from recordings.file.journal import read as read_journal
from recordings.file.writer import Recorder
from recordings.json_text import read_json
from recordings.own_files import copied, created, folder_in, opened, replaced, replacing
from recordings.states.rules import Settled, State
from recordings.table_file import read_csv
from recordings.trials import TrialRow
from tests.simulated.bench import raises


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """A file elsewhere that must stay as it is."""
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "elsewhere" / "precious"
    path.write_text("as it was")
    return path


def test_a_symbolic_link_is_not_opened_whether_it_leads_anywhere_or_not(tmp_path: Path, target: Path) -> None:
    (tmp_path / "link").symlink_to(target)
    (tmp_path / "loose").symlink_to(tmp_path / "elsewhere" / "new")
    for name in ("link", "loose"):
        raises(OSError, "symbolic link", opened, tmp_path / name, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
        raises(FileExistsError, None, created, tmp_path / name)
    assert target.read_text() == "as it was" and not (tmp_path / "elsewhere" / "new").exists()


def test_a_pipe_or_a_folder_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for flags in (os.O_RDONLY, os.O_WRONLY, os.O_RDWR):
        raises(OSError, None, opened, tmp_path / "pipe", flags)
    raises(OSError, "not a regular file", opened, tmp_path, os.O_RDONLY)


def test_replacing_a_link_replaces_the_link_and_leaves_no_other_file(tmp_path: Path, target: Path) -> None:
    (tmp_path / "a.txt").symlink_to(target)
    replaced(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").read_text() == "new" and not (tmp_path / "a.txt").is_symlink()
    assert target.read_text() == "as it was" and {p.name for p in tmp_path.iterdir()} == {"a.txt", "elsewhere"}


def test_what_fails_on_the_way_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(RuntimeError), replacing(tmp_path / "a.txt") as (file, _):
        file.write(b"half")
        raise RuntimeError
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "old")]


def test_an_error_names_the_file_that_was_asked_for_and_not_the_one_that_is_written_first(tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    for path in (tmp_path / "nowhere" / "a.csv", tmp_path / "folder.csv"):
        with pytest.raises(OSError) as caught:
            replaced(path, "text")
        assert caught.value.filename == str(path) and ".new" not in str(caught.value)


def test_recording_journal_and_index_refuse_a_link_in_their_place(tmp_path: Path, target: Path) -> None:
    for name in ("a.mcap", "a.journal", INDEX):
        (tmp_path / name).symlink_to(target)
    raises(WriteFailed, "exists", Recorder, tmp_path / "a.mcap", start_wall_ns=10**18)
    raises(WriteFailed, r"a\.journal", Journal.begin, tmp_path / "a.mcap", "bending")
    raises(RecordingError, "symbolic link", runs, tmp_path)
    assert target.read_text() == "as it was"


def test_a_journal_is_not_gone_on_with_through_a_link(tmp_path: Path, target: Path) -> None:
    with Journal.begin(tmp_path / "elsewhere" / "a.mcap", "bending"):
        pass
    (tmp_path / "a.journal").symlink_to(tmp_path / "elsewhere" / "a.journal")
    raises(WriteFailed, "symbolic link", Journal.reopen, tmp_path / "a.journal")


def test_a_copy_replaces_a_symbolic_link_and_leaves_the_same_file_alone(tmp_path: Path) -> None:
    source, target, elsewhere = tmp_path / "a", tmp_path / "b", tmp_path / "elsewhere"
    source.write_text("new")
    elsewhere.write_text("old")
    target.symlink_to(elsewhere)
    copied(source, target)
    assert elsewhere.read_text() == "old" and target.read_text() == "new" and not target.is_symlink()
    before = source.stat().st_ino
    copied(source, source)
    assert source.stat().st_ino == before


def test_no_folder_is_entered_through_a_symbolic_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    raises(OSError, "symbolic link", folder_in, tmp_path, "out")
    assert folder_in(tmp_path, "new").is_dir()


# -- what was found by mutating files: each is one clear error
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
