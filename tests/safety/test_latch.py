"""The latch keeps a rig locked until a person clears it."""

import os
from pathlib import Path

import pytest

from lab.guard.latch import JOURNAL_LIMIT, Latch, RigLocked
from tests.simulated.bench import raises


def test_a_written_latch_locks_and_says_why_and_what_to_do_until_it_is_cleared(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "rig.yaml")
    latch.demand_free()
    assert latch.read() is None
    latch.write("the arm does not answer")
    raises(RigLocked, r"arm does not answer.*lab safe --clear", Latch(tmp_path / "rig.yaml").demand_free)
    latch.clear()
    latch.clear()
    latch.demand_free()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"why": 1}', b"\xff\xfe\x00", b"null", b"[" * 99_000])
def test_a_damaged_latch_locks(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "rig.latch").write_bytes(content)
    raises(RigLocked, None, Latch(tmp_path / "rig.yaml").demand_free)


def test_the_journal_keeps_what_was_noted_and_does_not_grow_for_ever(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "rig.yaml")
    latch.note("first")
    assert "first" in latch.journal.read_text()
    latch.journal.write_text("x" * (JOURNAL_LIMIT + 1))
    latch.note("second")
    assert "second" in latch.journal.read_text() and latch.journal.stat().st_size < 1000


def test_a_link_in_the_place_of_the_latch_locks_and_is_never_written_through(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text('{"since": "x", "why": "y"}')
    latch = Latch(tmp_path / "rig.yaml")
    latch.path.symlink_to(tmp_path / "precious")
    raises(RigLocked, "symbolic link", latch.demand_free)
    latch.write("the arm does not answer")
    assert not latch.path.is_symlink() and "arm" in str(latch.read())
    assert (tmp_path / "precious").read_text() == '{"since": "x", "why": "y"}'


def test_a_link_or_a_pipe_in_the_place_of_the_guards_log_does_not_keep_the_guard_from_landing(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("as it was")
    latch = Latch(tmp_path / "rig.yaml")
    latch.journal.symlink_to(tmp_path / "precious")
    raises(OSError, "symbolic link", latch.begin, "owns the rig")
    latch.note("landed")
    assert (tmp_path / "precious").read_text() == "as it was"
    latch.journal.unlink()
    os.mkfifo(latch.journal)
    latch.note("landed")
