"""Which recording the runs of a rig write: a line beside rig.yaml, by which another program finds the run that is going on."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from recordings.bounded import read_bounded
from recordings.own_files import replaced

from ..files.config import ConfigError


def _place(rig: Path) -> Path:
    return rig.with_suffix(".recording")


def announce(rig: Path, recording: Path) -> None:
    """From now on the rig's run writes this recording; where the line cannot be written, nothing is announced."""
    with contextlib.suppress(OSError):
        replaced(_place(rig), os.fsencode(recording.resolve()) + b"\n")


def recording_of(rig: Path) -> Path:
    """The newest recording of a rig's runs; raises ConfigError when none is known."""
    if not rig.exists():
        raise ConfigError(f"{rig}: no such file; give a recording, or the rig.yaml of a run")
    place = _place(rig)
    if not place.exists():
        raise ConfigError(f"{rig}: no run of it is known ({place.name} is not there); give its recording instead")
    found = Path(os.fsdecode(read_bounded(place, 5000, ConfigError).strip()))  # bytes
    if not found.is_file():
        raise ConfigError(f"{place}: names {found}, which is not there; give the recording instead")
    return found
