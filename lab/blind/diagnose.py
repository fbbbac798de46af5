"""A case folder through the project's own diagnosis, as `lab diagnose` does it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnosis.answer.result import Diagnosis
from diagnosis.diagnose import Options, diagnose

from ..files.baseline import from_table
from ..files.inputs import read_case
from .make import PREDICTED


def diagnose_folder(folder: Path) -> dict[str, Any]:
    """diagnosis.json of a case folder. Raises what the diagnosis raises."""
    return _diagnosed(folder, Options())


def propose_folder(folder: Path) -> dict[str, Any]:
    """The same without held-out errors."""
    return _diagnosed(folder, Options(quantify=False))


def attribute_folder(folder: Path) -> dict[str, Any]:
    """The same without held-out errors and without next experiments, for a quick look."""
    return _diagnosed(folder, Options(quantify=False, experiments=False))


def _diagnosed(folder: Path, options: Options) -> dict[str, Any]:
    case = read_case([folder])
    if (folder / PREDICTED).exists():
        options = replace(options, baseline=from_table(folder / PREDICTED, case))
    return _json(diagnose(case, options))


def _json(found: Diagnosis) -> dict[str, Any]:
    out: dict[str, Any] = json.loads(found.to_json())
    return out
