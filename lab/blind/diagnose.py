"""A case folder through the project's own diagnosis, as `lab diagnose` does it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from diagnosis.answer.result import Diagnosis
from diagnosis.diagnose import Options, diagnose

from ..files.inputs import read_case


def diagnose_folder(folder: Path) -> dict[str, Any]:
    """diagnosis.json of a case folder. Raises what the diagnosis raises."""
    return _json(diagnose(read_case([folder])))


def attribute_folder(folder: Path) -> dict[str, Any]:
    """The same without held-out errors and without next experiments, for a quick look."""
    return _json(diagnose(read_case([folder]), Options(quantify=False, experiments=False)))


def _json(found: Diagnosis) -> dict[str, Any]:
    out: dict[str, Any] = json.loads(found.to_json())
    return out
