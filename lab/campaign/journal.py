"""The folder of a campaign: its file, its journal, and one folder a run with recordings and a journal of their own.

The journal tells which runs are done. One JSON object a line, appended and synced line by line, in `campaign.journal`:

    {"campaign_journal": 1, "campaign": "lengths", "design": "<sha256>", "labels": {"specimen": "S7"}}
    {"run": 3, "begun": 1795449600.0}                   wall time, s
    {"run": 3, "outcome": "completed", "seconds": 212.4, "rows": 11, "lost": 0, "at": 1795449812.4}
    {"warm_up": 1, "begun": 1795449500.0}

A run is done when a line says that it was completed; an interrupted run is resumed from its own journal, trial by trial.
While a campaign goes on, its journal is locked against a second process.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recordings.bounded import read_bounded
from recordings.errors import BadJournal, RecordingError, WriteFailed
from recordings.file.counts import counted
from recordings.file.journal import read as read_run
from recordings.file.journal import whole
from recordings.file.reader import Recording
from recordings.file.recover import RECOVERED, recover
from recordings.json_text import read_json
from recordings.own_files import opened, replaced

from ..files.config import ConfigError
from ..files.inputs import same_body
from ..files.resume import Broken, find, there
from .design import CampaignDesign

NAME, VERSION = "campaign.journal", 1
LARGEST = 50_000_000
"""Bytes; a run has some 200."""


@dataclass
class CampaignProgress:
    """What a journal tells."""

    campaign: str
    design: str
    labels: dict[str, str]
    completed: set[int] = field(default_factory=set)
    """Numbers of runs."""
    begun: Counter[int] = field(default_factory=Counter)
    """How often each run was begun; 0: the warm-up."""
    seconds: float = 0.0
    """Rig seconds of all runs together, where known."""
    rows: int = 0
    lost: int = 0
    inflated: float = 0.0
    """Wall time (s) of the last inflation; 0: never."""

    def take(self, line: Mapping[str, Any]) -> None:
        """Add a line; raises KeyError, ValueError or TypeError for one that cannot be understood."""
        number = whole(line["run"]) if "run" in line else 0
        if "outcome" not in line:
            self.begun[number] += 1
            return
        self.seconds += float(line["seconds"])
        self.lost += whole(line["lost"], 2**53)
        if line.get("inflated"):
            self.inflated = max(self.inflated, float(line["at"]))
        if number and line["outcome"] == "completed":
            self.completed.add(number)
            self.rows += whole(line["rows"], 2**53)


class CampaignJournal(contextlib.AbstractContextManager["CampaignJournal"]):
    """A journal that is being written, and its present content."""

    def __init__(self, path: Path, fd: int, done: CampaignProgress) -> None:
        self.path, self.done = path, done
        self._fd = fd

    @classmethod
    def begin(cls, folder: Path, campaign: str, design: str, labels: Mapping[str, str]) -> CampaignJournal:
        """A new campaign in a folder; raises ConfigError when there is one already."""
        path = folder / NAME
        try:
            fd = _locked(path, os.O_CREAT | os.O_EXCL)
        except FileExistsError:
            raise ConfigError(
                f"{folder}: holds a campaign already; go on with it by --resume {folder}, or give another --out"
            ) from None
        journal = cls(path, fd, CampaignProgress(campaign, design, dict(labels)))
        journal._append({"campaign_journal": VERSION, "campaign": campaign, "design": design, "labels": dict(labels)}, sync=False)
        return journal

    @classmethod
    def reopen(cls, folder: Path) -> CampaignJournal:
        """Go on with a campaign; a line that a crash left torn is cut off. Raises ConfigError, BadJournal, WriteFailed."""
        path = folder / NAME
        if not path.exists():
            raise ConfigError(f"{folder}: holds no campaign ({NAME} is not there); give the folder that --out named")
        fd = _locked(path, 0)
        try:
            done = read(path)
            os.ftruncate(fd, read_bounded(path, LARGEST, BadJournal).rfind(b"\n") + 1)
            os.lseek(fd, 0, os.SEEK_END)
        except BaseException:
            os.close(fd)
            raise
        return cls(path, fd, done)

    def began(self, run: int | None) -> None:
        """A run is about to begin; None: the warm-up."""
        self._append(({"warm_up": 1} if run is None else {"run": run}) | {"begun": time.time()})

    def ended(self, run: int | None, outcome: str, seconds: float, rows: int, lost: int, inflated: bool) -> None:
        """A run is over; `seconds` of rig time."""
        about: dict[str, object] = {"warm_up": 1} if run is None else {"run": run}
        about |= {"outcome": outcome, "seconds": round(seconds, 3), "rows": rows, "lost": lost, "inflated": inflated}
        self._append(about | {"at": time.time()})

    def _append(self, line: dict[str, object], sync: bool = True) -> None:
        try:
            os.write(self._fd, json.dumps(line).encode() + b"\n")
            os.fsync(self._fd)
        except OSError as error:
            raise WriteFailed(f"{self.path}: cannot be written: {error.strerror}") from error
        if sync:
            self.done.take(line)

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)


def _locked(path: Path, flags: int) -> int:
    """Open for writing, by this process alone; the system frees the lock whenever the process ends."""
    try:
        fd = opened(path, os.O_WRONLY | flags)
    except FileExistsError:
        raise
    except OSError as error:
        raise WriteFailed(f"{path}: cannot be written: {error.strerror}") from error
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(fd)
        raise ConfigError(f"{path}: the campaign is going on in another process; wait for it or end it") from None
    return fd


def read(path: Path) -> CampaignProgress:
    """Read a journal; its last line may be torn. Raises BadJournal."""
    text = read_bounded(path, LARGEST, BadJournal)
    done: CampaignProgress | None = None
    try:
        for raw in text[: text.rfind(b"\n") + 1].splitlines():
            line = read_json(raw)
            if done is not None:
                done.take(line)
                continue
            if line["campaign_journal"] != VERSION:
                raise BadJournal(f"{path}: has version {line['campaign_journal']}, this software reads {VERSION}")
            labels = {str(k): str(v) for k, v in line["labels"].items()}
            done = CampaignProgress(str(line["campaign"]), str(line["design"]), labels)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, BadJournal):
            raise
        raise BadJournal(f"{path}: a line cannot be understood ({error!r:.200})") from error
    if done is None:
        raise BadJournal(f"{path}: is empty; nothing had begun, so start the campaign anew in another folder")
    return done


FILE, ROBOT = "campaign.yaml", "robot.yaml"
TORN = ".torn"
"""Name of the recording recovered from an unfinished one."""


def fill(folder: Path, campaign: CampaignDesign) -> None:
    """Keep the files from which the campaign is resumed."""
    replaced(folder / FILE, campaign.yaml)
    replaced(folder / ROBOT, campaign.runs[0].job.rig.texts[ROBOT].decode())


def demand_same(folder: Path, campaign: CampaignDesign, design: str) -> None:
    """Raises ConfigError when the campaign in the folder, or the robot, is not what it began with."""
    if campaign.digest != design:
        raise ConfigError(
            f"{folder / FILE}: is not the campaign that was begun here: protocols, conditions, blocks, order or "
            "a protocol's file differ; only stop, warm_up and labels may be changed. Start a new campaign instead"
        )
    rig = campaign.runs[0].job.rig
    if not same_body(rig.texts[ROBOT], (folder / ROBOT).read_bytes()):
        raise ConfigError(f"{rig.robot}: differs from {folder / ROBOT}, with which the campaign began; start a new one")


@dataclass(frozen=True)
class RunState:
    """What there is of a run."""

    broken: Broken | None
    """How to resume it; None: nothing was measured yet."""
    completed: bool = False
    lost: int = 0
    """Samples, in the last recording."""


def found_of(folder: Path) -> RunState:
    """The state of the run in a folder, after recovering torn recordings. Raises ConfigError, RecordingError."""
    mend(folder)
    for journal in sorted(folder.glob("*.journal")):
        progress = read_run(journal)
        if not any(there(journal.parent / name) for name, _ in progress.recordings):
            if progress.done:
                raise ConfigError(f"{journal}: its recordings are missing; put them back")
            journal.rename(journal.with_name(journal.name + TORN))  # the crash came before anything was written
            continue
        broken = find(journal)
        last = there(journal.parent / progress.recordings[-1][0])
        metadata = {} if last is None else Recording.open(last, truncated=True).metadata
        lost = sum(c.get("lost", 0) + c.get("dropped", 0) for c in counted(metadata).values())
        return RunState(broken, metadata.get("outcome", {}).get("outcome") == "completed", lost)
    return RunState(None)


def mend(folder: Path) -> None:
    """Recover unfinished recordings; the torn files stay next to them."""
    for file in sorted(folder.glob("*.mcap")):
        with contextlib.suppress(RecordingError):
            if Recording.open(file, truncated=True).contents.finished:
                continue
        saved = file.with_name(file.stem + RECOVERED)
        with contextlib.suppress(RecordingError):
            saved.unlink(missing_ok=True)  # made by a process that was killed before it could set the torn one aside
            recover(file, saved)
        file.rename(file.with_suffix(TORN))
