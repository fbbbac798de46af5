"""Answer a sealed set with other methods, then open the seal and compare: `python -m benchmarks.rivals SET [--methods M ..]
[--first N] [--workers N] [--keep-sealed] [--out FOLDER]`. Run the set first (`lab blind run SET`); the seal is opened at the
end, for all alike.

Each method writes OUT/METHOD/CASE.json, in the form that `lab blind score SET --answers OUT/METHOD` reads.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.data.case import states
from diagnosis.inference.executor import one_thread
from diagnosis.inference.prepare import Prepared, prepare
from lab.blind.folder import SetFolder
from lab.blind.workers import Crew, spread
from lab.files.inputs import read_case

from .forest import forest
from .learned import learned
from .table import report
from .textbook import alone, sparse, stepwise

METHODS: dict[str, Callable[[Prepared], dict[str, Any]]] = {
    "alone": lambda p: alone(p.problem),
    "stepwise": lambda p: stepwise(p.problem),
    "sparse": lambda p: sparse(p.problem),
    "forest": lambda p: forest(p.problem),
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


def main() -> None:
    """Answer, then open the seal unless it is to be kept."""
    a = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    a.add_argument("set", type=Path)
    a.add_argument("--methods", nargs="+", choices=tuple(METHODS), default=tuple(METHODS))
    a.add_argument("--first", type=int, help="answer the first N cases only")
    a.add_argument("--keep-sealed", action="store_true", help="answer, and leave the seal closed")
    a.add_argument("--workers", type=int, default=2)
    a.add_argument("--out", type=Path, default=Path("out/rivals"))
    asked = a.parse_args()
    names = SetFolder(asked.set).names()[: asked.first]
    do = partial(answer, asked.set.resolve(), asked.out.resolve(), tuple(asked.methods))
    for _ in spread(do, names, Crew(asked.workers, None), "cases"):
        pass
    if not asked.keep_sealed:
        report(asked.set, asked.out, [m for m in METHODS if (asked.out / m).is_dir()])


if __name__ == "__main__":
    main()
