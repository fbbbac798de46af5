"""What is in the folder of a campaign: its file, its journal, and one folder a run with recordings that belong together."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

from recordings.errors import RecordingError
from recordings.file.counts import counted
from recordings.file.journal import read
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.own_files import replaced

from ..files.config import ConfigError
from ..files.inputs import same_body
from ..files.resume import Broken, find
from .design import Campaign

FILE, ROBOT = "campaign.yaml", "robot.yaml"
TORN = ".torn"
"""What a recording that was not finished is called once all that can be read of it is recovered."""


def fill(folder: Path, campaign: Campaign) -> None:
    """Keep what the campaign goes on with."""
    replaced(folder / FILE, campaign.yaml)
    replaced(folder / ROBOT, campaign.runs[0].job.rig.texts[ROBOT].decode())


def folder_of(place: Path) -> Path:
    """The campaign's folder: itself, or the one that a file of it is in."""
    return place if place.is_dir() else place.parent


def demand_same(folder: Path, campaign: Campaign, design: str) -> None:
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
class Found:
    """What there is of a run."""

    broken: Broken | None
    """How to go on with it; None: nothing was measured yet."""
    completed: bool = False
    lost: int = 0
    """Samples, in the last recording."""


def found_of(folder: Path) -> Found:
    """What the folder of a run holds; torn recordings are recovered on the way. Raises ConfigError, RecordingError."""
    mend(folder)
    for journal in sorted(folder.glob("*.journal")):
        progress = read(journal)
        if not any(_there(journal.parent / name) for name, _ in progress.recordings):
            if progress.done:
                raise ConfigError(f"{journal}: its recordings are missing; put them back")
            journal.rename(journal.with_name(journal.name + TORN))  # the crash came before the file had anything in it
            continue
        broken = find(journal)
        last = _there(journal.parent / progress.recordings[-1][0])
        about = {} if last is None else Recording.open(last, truncated=True).metadata
        counts = counted({"counts": about.get("counts", {})}).values()
        lost = sum((c.get("lost") or 0) + (c.get("dropped") or 0) for c in counts)
        return Found(broken, about.get("outcome", {}).get("outcome") == "completed", lost)
    return Found(None)


def _there(file: Path) -> Path | None:
    """A recording, or what was recovered of it."""
    saved = file.with_name(f"{file.stem}-recovered.mcap")
    return file if file.exists() else saved if saved.exists() else None


def mend(folder: Path) -> None:
    """Of recordings that were not finished keep all that can be read as ones that are; the torn files stay beside them."""
    for file in sorted(folder.glob("*.mcap")):
        _mend(file)


def _mend(file: Path) -> None:
    with contextlib.suppress(RecordingError):
        if Recording.open(file, truncated=True).contents.finished:
            return
    saved = file.with_name(f"{file.stem}-recovered.mcap")
    with contextlib.suppress(RecordingError):
        saved.unlink(missing_ok=True)  # made by a process that was killed before it could set the torn one aside
        recover(file, saved)
    file.rename(file.with_suffix(TORN))
