"""Answer a sealed set with other methods, then open the seal and compare: `python -m benchmarks.rivals SET [--methods M ..]
[--first N] [--workers N] [--keep-sealed] [--out FOLDER]`. Run the set first (`lab blind run SET`); the seal is opened at the
end, for all alike.

Each method writes OUT/METHOD/CASE.json, in the form that `lab blind score SET --answers OUT/METHOD` reads.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from lab.blind.folder import SetFolder
from lab.blind.workers import Crew, spread

from .answers import METHODS, answer
from .table import report


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
