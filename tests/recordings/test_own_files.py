"""Files that the software names itself never go through a symbolic link, and are there whole or not at all."""

import os
from pathlib import Path

import pytest

from recordings.campaign.shelf import INDEX, runs
from recordings.errors import RecordingError, WriteFailed
from recordings.file.journal import Journal
from recordings.file.writer import Recorder
from recordings.own_files import copied, created, folder_in, opened, replaced, replacing
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
