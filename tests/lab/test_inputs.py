"""Which robots count as the same, and what is told of clipped states."""

from __future__ import annotations

from lab.files.example import paper_robot
from lab.files.inputs import clipped_note, same_body
from recordings.trials import Table, TrialRow


def row(step: int, clipped: bool) -> TrialRow:
    return TrialRow(
        trial=1, step=step, protocol="bending", repeat=1, branch="load", t=0.0, spine_length=0.0, pressures=(0.0,),
        clipped=clipped,
    )  # fmt: skip


def test_a_robot_stays_the_same_when_the_pressure_it_bears_is_written_down() -> None:
    now = paper_robot().read_bytes()
    before = b"\n".join(line for line in now.splitlines() if not line.startswith(b"max_pressure"))
    assert same_body(before, now) and len(before) < len(now) - 20
    assert not same_body(before, now.replace(b"length: 0.40", b"length: 0.41"))
    assert not same_body(before, b"no robot") and not same_body(b"\xff", now) and same_body(b"no robot", b"no robot")


def test_clipped_states_are_counted_and_named() -> None:
    assert clipped_note(Table((row(1, False),))) == []
    (note,) = clipped_note(Table(tuple(row(step, step != 2) for step in range(1, 10))))
    assert "8 of 9 states" in note and "trial 1 step 1, trial 1 step 3" in note and note.endswith("and 3 more")
