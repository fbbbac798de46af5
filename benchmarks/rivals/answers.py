"""The methods by name, and their answers to one case: a module of its own, which other processes can import."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.folder import SetFolder
from diagnosis.data.case import states
from diagnosis.inference.executor import one_thread
from diagnosis.inference.prepare import Prepared, prepare
from lab.files.inputs import read_case

from .learned import learned
from .textbook import alone, sparse

METHODS: dict[str, Callable[[Prepared], dict[str, Any]]] = {
    "alone": lambda p: alone(p.problem),
    "sparse": lambda p: sparse(p.problem),
    "learned": learned,
}


@one_thread
def answer(root: Path, out: Path, methods: Sequence[str], name: str) -> str:
    """The answers of some methods to one case, each in its folder, with the seconds of processor that it took."""
    places = {m: place for m in methods if not (place := out / m / f"{name}.json").exists()}
    if not places:
        return name
    began = time.process_time()
    case = read_case([SetFolder(root).case(name)])
    prepared = prepare(case.robot, states(case)[0])
    ready = time.process_time() - began
    for method, place in places.items():
        began = time.process_time()
        try:
            found = METHODS[method](prepared)
        except (np.linalg.LinAlgError, ValueError) as e:
            found = {"error": repr(e)[:200]}
            found["attribute"] = {"verdict": "failed", "effects": [], "probability": 0.0, "ranking": []}
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(json.dumps({**found, "seconds": ready + time.process_time() - began}))
    return name
