"""A case folder through the project's own diagnosis, as `lab diagnose` does it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..inputs import read_case


def diagnose_folder(folder: Path) -> dict[str, Any]:
    """diagnosis.json of a case folder. Raises what the diagnosis raises."""
    from diagnosis.diagnose import diagnose

    found: dict[str, Any] = json.loads(diagnose(read_case([folder])).to_json())
    return found
