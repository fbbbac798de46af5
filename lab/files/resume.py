"""`lab run --resume RUN`: find the finished trials of an interrupted run, and run the same experiment for the remainder.

Trials are the unit: an interrupted sweep is repeated from its beginning, because the robot depends on its earlier pressures.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

from protocols.registry import Experiment
from recordings.campaign.labels import RECORD
from recordings.campaign.replay import campaign_of, merged
from recordings.file.journal import read
from recordings.file.reader import Recording
from recordings.file.recover import RECOVERED
from recordings.trials import Table

from .all_protocols import protocol_from_file
from .config import ConfigError, parse_yaml
from .inputs import attached


@dataclass(frozen=True)
class Broken:
    """A campaign that can be continued."""

    journal: Path
    finished: int
    """Trials 1 to this one are done with all their states recorded, or were skipped."""
    table: Table
    labels: dict[str, str]
    protocol: str
    robot: bytes
    code: bytes | None = None
    """Python file of its protocol, where it came from one."""
    owned: bool = False
    """Whether its first recording is this user's own: code of others is not executed."""

    def recorded_protocol(self) -> Experiment | None:
        """The protocol of the Python file in the recording, None where it came from none; raises ConfigError."""
        if self.code is None:
            return None
        name = parse_yaml(self.protocol, f"{self.journal}: protocol.yaml").table.get("protocol")
        if not self.owned or not isinstance(name, str) or not name.isidentifier():
            raise ConfigError(f"{self.journal}: its recording is not yours; give its protocol: lab run {name}.py --resume ..")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.py"
            path.write_bytes(self.code)
            return protocol_from_file(path)


def find(run: Path) -> Broken:
    """Return the campaign of a recording or journal. Raises ConfigError or RecordingError if it cannot be continued."""
    journal = run
    if run.suffix != ".journal":
        name = Recording.open(run, truncated=True).metadata.get("campaign", {}).get("journal")
        if name is None:
            raise ConfigError(f"{run}: names no journal; a run without a journal cannot be resumed")
        journal = _beside(run, name)
    progress = read(journal)
    names = list(progress.recordings)
    last = max((*progress.done, *progress.skipped), default=0)
    if len(names) > 1 and not _beside(journal, names[-1][0]).exists() and last < names[-1][1]:
        names.pop()  # the crash came before the file was there
    recordings = [_open(_beside(journal, name), progress.campaign) for name, _ in names]
    table = merged(recordings)
    rows = {trial: int((table.trial == trial).sum()) for trial in progress.done}
    # a trial of which a row is missing from the recordings is done again, with all after it
    lacking = (k for k in range(1, progress.finished + 1) if k not in progress.skipped and rows[k] != progress.done[k])
    finished = next(lacking, progress.finished + 1) - 1
    first = recordings[0]
    if missing := [name for name in ("protocol.yaml", "robot.yaml") if name not in first.attachments]:
        raise ConfigError(f"{first.path}: has no {', '.join(missing)} attached; it cannot be resumed")
    return Broken(
        journal, finished, table.take(table.trial <= finished),
        dict(first.metadata.get(RECORD, {})), attached(first, "protocol.yaml"), first.attachments["robot.yaml"],
        first.attachments.get("protocol.py"), first.path.stat().st_uid == os.getuid(),
    )  # fmt: skip


def _beside(file: Path, name: str) -> Path:
    """A file named in another one. Raises ConfigError if it is in another folder."""
    # file systems take 255 bytes, and what is recovered gets a longer name
    if not name or Path(name).name != name or "\0" in name or len(name.encode()) > 200:
        raise ConfigError(f"{file}: names {name[:80]!r}, which is not a file in the same folder")
    return file.parent / name


def there(file: Path) -> Path | None:
    """A recording, or its recovered part; None where neither exists."""
    return next((path for path in (file, file.with_name(file.stem + RECOVERED)) if path.exists()), None)


def _open(path: Path, campaign: str) -> Recording:
    """One recording of the campaign, or its recovered file; an unfinished file is read to its end."""
    if (found := there(path)) is None:
        raise ConfigError(f"{path}: is named in the journal but missing; put it in the journal's folder")
    recording = Recording.open(found, truncated=True)
    if campaign_of(recording) != campaign:
        raise ConfigError(f"{recording.path}: belongs to a different campaign than the journal")
    return recording
