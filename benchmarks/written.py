"""What a benchmark measured, as JSON, with the machine that it was measured on."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any


def write(path: Path, key: str, found: Sequence[Any]) -> None:
    """Write dataclasses as a list under a key."""
    host = {"system": platform.platform(), "processors": os.cpu_count(), "load": os.getloadavg()}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"host": host, key: [asdict(each) for each in found]}, indent=1), encoding="utf-8")
