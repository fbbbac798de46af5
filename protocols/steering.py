"""What people ask of a run while it goes on: one door for keys at the terminal, for buttons on a page, and for programs.

Requests come from other threads than the experiment's. `ask` takes one from any thread, records it and returns its fate; the
experiment checks for requests between its steps and records that they were carried out.

    note      a line of text, written down at once
    pause     before the next step: vented and stopped, the spine stays jammed
    go on     from a pause, or none after all
    repeat    the state that is being read is read once more
    skip      the trial is left out: the experiment goes on with the next one
    finish    end after the present step
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import timing
from recordings.events import REQUESTS

from .errors import BadRequest, Skipped

LONGEST = 500
"""Characters of a note."""
ANSWERS = {
    "pause": "Pausing after this state", "go on": "Going on", "repeat": "This state is read once more",
    "skip": "Leaving this trial out", "finish": "Ending after this step",
}  # fmt: skip
UNDONE = "this was asked and not carried out before the run ended"

Keep = Callable[[str, str, str, bool, int, int], None]
"""Records kind, by, text, whether it was carried out, trial and step."""


def checked(kind: str, text: str = "") -> str:
    """The text of a request on one line, empty but for a note; raises `BadRequest` for what is none."""
    if kind not in REQUESTS:
        raise BadRequest(f"{kind[:40]!r}: is no request; one of {', '.join(REQUESTS)}")
    text = " ".join(text.split()) if kind == "note" else ""
    if kind == "note" and not 1 <= len(text) <= LONGEST:
        raise BadRequest(f"a note must have 1 to {LONGEST} characters, has {len(text)}")
    return text


class Steering:
    """Requests to one run at a time. All methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = timing.Lock()
        self._open: dict[str, str] = {}
        """What is asked and not carried out yet, and by whom."""
        self._keep: Keep | None = None
        self._finish: Callable[[], None] = lambda: None
        self._say: Callable[[str], object] = str
        self._place = (0, 0)
        self._may_skip = False
        self._resting = False

    # -- who asks
    def ask(self, kind: str, by: str, text: str = "") -> str:
        """Take a request; return its fate, and report it to the person at the run. Raises `BadRequest`.

        `by`: where it is asked; `text`: of a note, at most `LONGEST` characters.
        """
        text = checked(kind, text)
        with self._lock:
            answer = self._taken(kind, by, text)
        if kind == "finish" and answer == ANSWERS[kind]:
            self._finish()
        self._say(f"{answer} ({by})")
        return answer

    def _taken(self, kind: str, by: str, text: str) -> str:
        """Open a request or carry it out, and record it; returns its fate, for people. `_lock` is held."""
        if self._keep is None:
            return "No run goes on"
        if kind == "note":
            self._record(kind, by, text, done=True)
            return f"Note: {text}"
        if kind == "go on" and not self._resting:
            if self._open.pop("pause", None) is None:
                return "Nothing is paused"
            self._record(kind, by)
            return "No pause after all"
        if kind in self._open or (kind == "pause" and self._resting):
            return "This was asked before"
        self._open[kind] = by
        self._record(kind, by)
        return ANSWERS[kind]

    def _record(self, kind: str, by: str, text: str = "", done: bool = False) -> None:
        if self._keep is not None:
            self._keep(kind, by, text, done, *self._place)

    @property
    def waiting(self) -> bool:
        """The run is paused, or will be after this state."""
        return self._resting or "pause" in self._open

    @property
    def resting(self) -> bool:
        """The run is paused."""
        return self._resting

    def wants(self, kind: str) -> bool:
        """Whether this is asked for and not carried out."""
        return kind in self._open

    # -- who runs
    @contextlib.contextmanager
    def of_run(self, keep: Keep, finish: Callable[[], None], say: Callable[[str], object]) -> Iterator[None]:
        """Requests belong to this run in the block: `keep` records them, `finish` ends it after a step, `say` tells people."""
        with self._lock:
            self._open.clear()
            self._keep, self._finish, self._say, self._place = keep, finish, say, (0, 0)
        try:
            yield
        finally:
            with self._lock:
                undone = [kind for kind in self._open if kind != "finish"]
                self._open.clear()
                self._keep, self._finish, self._say = None, lambda: None, str
                self._resting = self._may_skip = False
            for kind in undone:
                say(f"{kind}: {UNDONE}")

    def at(self, trial: int, step: int) -> None:
        """The state that is asked for now."""
        self._place = (trial, step)

    def take(self, kind: str) -> bool:
        """Whether this is asked for; it counts as carried out from now on."""
        with self._lock:
            by = self._open.pop(kind, None)
            if by is not None:
                self._record(kind, by, done=True)
        return by is not None

    @contextlib.contextmanager
    def rest(self) -> Iterator[None]:
        """The pause that was asked for has begun; it ends with the block."""
        with self._lock:
            self._resting = True
            self._record("pause", self._open.pop("pause", ""), done=True)
        try:
            yield
            self.take("go on")
        finally:
            self._resting = False

    @contextlib.contextmanager
    def skippable(self) -> Iterator[None]:
        """In the block is a trial that may be left out: `Skipped` is raised in it at the next look."""
        self._may_skip = True
        try:
            yield
        finally:
            self._may_skip = False

    def check_skip(self) -> None:
        """Raise `Skipped` where this trial is to be left out."""
        if self._may_skip and self.wants("skip"):
            raise Skipped("left out at a person's request")
