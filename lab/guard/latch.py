"""The latch: a file next to rig.yaml that keeps a rig locked until a person has attended to it.

It is written before anything is energised and removed when the safe state was confirmed by reading back. So however
a run ends, even if the guard or the host dies, an unconfirmed safe state leaves the file behind. The journal next to it says
what the guard did and why. Ownership is decided by `door`, not by a file.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from pathlib import Path
from typing import Any

from recordings.json_text import read_json
from recordings.own_files import opened, replaced

from ..plain import one_line, typed

JOURNAL_LIMIT = 1_000_000
"""Bytes after which the journal starts anew."""


class RigLocked(RuntimeError):
    """The rig may not be used: its last safe state is not confirmed, or another program owns it. Nothing was opened."""


class Latch:
    """Latch and journal of one rig.yaml."""

    def __init__(self, rig: Path) -> None:
        self.rig = rig = rig.resolve()
        self.path = rig.with_suffix(".latch")
        self.journal = rig.with_suffix(".guard.log")

    def read(self) -> str | None:
        """Why the rig is locked, and since when; None when it is free. A file that cannot be understood locks too."""
        try:
            with open(opened(self.path, os.O_RDONLY), encoding="utf-8") as file:
                text = file.read(100_000)
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as e:
            return f"{self.path} cannot be read ({getattr(e, 'strerror', None) or e}) (since an unknown time)"
        try:
            data: Any = read_json(text)
            return f"{data['why']} (since {data['since']})"
        except (ValueError, KeyError, TypeError):
            return f"{self.path} is damaged (since an unknown time)"

    def demand_free(self) -> None:
        """Raises RigLocked if a person has to attend to the rig first."""
        entry = self.read()
        if entry is not None:
            raise RigLocked(
                f"{self.rig.name} is locked: {entry}. Inspect the rig, vent it and free the arm by hand if necessary, then run "
                f"`{typed('lab', 'safe', '--clear', '--rig', self.rig)}`"
            )

    def write(self, why: str) -> None:
        """Lock the rig, on disk before this returns. Raises OSError."""
        replaced(self.path, json.dumps({"since": time.strftime("%Y-%m-%d %H:%M:%S"), "why": why, "pid": os.getpid()}))

    def clear(self) -> None:
        """Unlock; only after the safe state was confirmed. Raises OSError."""
        self.path.unlink(missing_ok=True)

    def note(self, text: str) -> None:
        """Write one line in the journal; a full disk must not keep the guard from landing."""
        with contextlib.suppress(OSError):
            self.begin(text)

    def begin(self, text: str) -> None:
        """The same before anything is opened; raises OSError if the journal cannot be written."""
        fresh = self.journal.exists() and self.journal.stat().st_size > JOURNAL_LIMIT
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | (os.O_TRUNC if fresh else 0)
        with open(opened(self.journal, flags), "a", encoding="utf-8", errors="replace") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} [{os.getpid()}] {one_line(text)}\n")
