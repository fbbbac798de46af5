"""The journal of a campaign: which steps and trials are finished, in which recording. It lets a run go on after a crash.

One JSON object a line, in a file next to the first recording, appended and synced line by line. A trial is called done
only after its samples and rows are on the disk. The trial is the unit of resuming: what a sweep measures depends on
the pressures before (hysteresis, creep), so one that was broken off is done again from its beginning.

    {"journal": 1, "campaign": "...", "protocol": "bending"}
    {"recording": "bending-20250101-120000.mcap", "first_trial": 1}
    {"trial": 1, "step": 1}
    {"trial": 1, "done": 5}                             this many states were read
    {"trial": 2, "skipped": 3}                          a person left it out; this many had been read
"""

from __future__ import annotations

import json
import os
import threading
import uuid
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from ..bounded import read_bounded
from ..errors import BadJournal, WriteFailed
from ..json_text import read_json
from ..own_files import displaced, opened, replaced

VERSION = 1
SUFFIX = ".journal"
LARGEST = 20_000_000
"""Bytes of a journal; a state has some 30."""


@dataclass(frozen=True)
class Progress:
    """Content of a journal. `recordings`: file names in order, each with the number of its first trial."""

    campaign: str
    protocol: str
    recordings: tuple[tuple[str, int], ...]
    done: dict[int, int]
    """Trial -> states that were read in it."""
    skipped: frozenset[int] = frozenset()
    """Trials that a person left out; they are not done again."""

    @property
    def finished(self) -> int:
        """Trials 1 to this one are done, or left out."""
        count = 0
        while count + 1 in self.done or count + 1 in self.skipped:
            count += 1
        return count


class Journal(AbstractContextManager["Journal"]):
    """A journal that is being written. Its lines are also kept in memory, so that a journal whose file is lost can be
    written anew; any thread may do that."""

    def __init__(self, path: Path, fd: int, campaign: str, text: bytes = b"") -> None:
        self.path, self.campaign = path, campaign
        self._fd, self._text = fd, text
        self._place = os.path.abspath(path)
        self._lock = threading.Lock()

    @classmethod
    def begin(cls, recording: Path, protocol: str) -> Journal:
        """A new campaign whose first file is `recording`; raises `WriteFailed` when the journal exists."""
        path, campaign = recording.with_suffix(SUFFIX), uuid.uuid4().hex
        journal = cls(path, _opened(path, os.O_CREAT | os.O_EXCL), campaign)
        journal._append({"journal": VERSION, "campaign": campaign, "protocol": protocol})
        journal.recording(recording, 1)
        return journal

    @classmethod
    def reopen(cls, path: Path) -> Journal:
        """Go on writing; a line that the crash left torn is cut off. Raises `BadJournal`, `WriteFailed`."""
        campaign = read(path).campaign
        fd = _opened(path, 0)
        text = read_bounded(path, LARGEST, BadJournal)
        text = text[: text.rfind(b"\n") + 1]
        os.ftruncate(fd, len(text))
        os.lseek(fd, 0, os.SEEK_END)
        return cls(path, fd, campaign, text)

    def recording(self, file: Path, first_trial: int) -> None:
        """From this trial on the campaign is in this file."""
        self._append({"recording": file.name, "first_trial": first_trial})

    def step(self, trial: int, step: int) -> None:
        """A state was read and is on the disk."""
        self._append({"trial": trial, "step": step})

    def done(self, trial: int, states: int) -> None:
        """A trial is finished; this many states were read in it."""
        self._append({"trial": trial, "done": states})

    def skipped(self, trial: int, states: int) -> None:
        """A person left a trial out, in which this many states had been read."""
        self._append({"trial": trial, "skipped": states})

    def _append(self, line: dict[str, object]) -> None:
        text = json.dumps(line).encode() + b"\n"
        with self._lock:
            self._text += text
            if displaced(self._place, self._fd, len(self._text) - len(text)):
                return  # the file is lost: `renew` or `follow` will write all lines anew
            try:
                os.write(self._fd, text)
                os.fsync(self._fd)
            except OSError as error:
                raise WriteFailed(f"{self.path}: cannot be written: {error.strerror}") from error

    # -- a file that is lost
    def displaced(self) -> str:
        """How the file is no longer what its path names; empty while it is. See `own_files`."""
        with self._lock:
            return displaced(self._place, self._fd, len(self._text))

    def renew(self) -> bool:
        """Write all lines anew at the same path; False where that cannot be done, or another file stands there."""
        with self._lock:
            try:
                free = os.path.samestat(os.stat(self._place, follow_symlinks=False), os.fstat(self._fd))
            except FileNotFoundError:
                free = True
            except OSError:
                return False
            return free and self._written(self.path, self._text)

    def follow(self, before: Path, recording: Path) -> bool:
        """Write all lines anew next to `recording`, which takes the place of `before`, the last recording; False where that
        cannot be done."""
        with self._lock:
            lines = self._text.splitlines(keepends=True)
            for at in reversed(range(len(lines))):
                line = read_json(lines[at])
                if line.get("recording") == before.name:
                    lines[at] = json.dumps(line | {"recording": recording.name}).encode() + b"\n"
                    break
            return self._written(recording.with_suffix(SUFFIX), b"".join(lines))

    def _written(self, path: Path, text: bytes) -> bool:
        """Replace the file at `path` by this text, and go on there."""
        try:
            replaced(path, text.decode())
            fd = _opened(path, os.O_APPEND)
        except (OSError, WriteFailed):
            return False
        os.close(self._fd)
        self.path, self._fd, self._place, self._text = path, fd, os.path.abspath(path), text
        return True

    def close(self) -> None:
        """No more lines."""
        os.close(self._fd)

    def __exit__(self, *_: object) -> None:
        self.close()


def _opened(path: Path, flags: int) -> int:
    try:
        return opened(path, os.O_WRONLY | flags)
    except OSError as error:
        raise WriteFailed(f"{path}: cannot be written: {error.strerror}") from error


def read(path: Path) -> Progress:
    """Read a journal, whose last line may be torn. Raises `BadJournal`."""
    campaign, protocol = "", ""
    recordings: list[tuple[str, int]] = []
    done: dict[int, int] = {}
    skipped: set[int] = set()
    try:
        text = read_bounded(path, LARGEST, BadJournal)
        for line in map(read_json, text[: text.rfind(b"\n") + 1].splitlines()):
            if "journal" in line:
                if line["journal"] != VERSION:
                    raise BadJournal(f"{path}: has version {line['journal']}, this software reads {VERSION}")
                campaign, protocol = str(line["campaign"]), str(line["protocol"])
            elif "recording" in line:
                recordings.append((str(line["recording"]), whole(line["first_trial"])))
                done = {trial: states for trial, states in done.items() if trial < recordings[-1][1]}
                skipped = {trial for trial in skipped if trial < recordings[-1][1]}
            elif "done" in line:
                done[whole(line["trial"])] = whole(line["done"])
            elif "skipped" in line:
                whole(line["skipped"])
                skipped.add(whole(line["trial"]))
    except (ValueError, KeyError, TypeError) as error:
        raise BadJournal(f"{path}: a line cannot be understood ({error!r:.200}); without it the run cannot be resumed") from error
    if not campaign or not recordings:
        raise BadJournal(f"{path}: does not name a campaign and a recording; it is not the journal of a run")
    return Progress(campaign, protocol, tuple(recordings), done, frozenset(skipped))


def whole(value: object, most: int = 2**31) -> int:
    """The value, if it is a whole number from 0 to below `most`; raises ValueError."""
    if type(value) is not int or not 0 <= value < most:
        raise ValueError(f"{value!r:.80} is not a whole number from 0 on")
    return value
