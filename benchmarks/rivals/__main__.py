"""Answer sealed sets with other methods, then open the seals and compare: `python -m benchmarks.rivals SET ..`

The diagnosis answers the sets first; all seals are opened at the end. Each method writes OUT/SET/METHOD/CASE.json, in the form
that `score SET --answers OUT/SET/METHOD` of `benchmarks.blind` reads.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from benchmarks.blind.folder import SetFolder
from benchmarks.blind.workers import spread

from .methods import METHODS, answer
from .table import report


def main() -> None:
    """Answer, then open the seals."""
    a = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    a.add_argument("sets", metavar="SET", type=Path, nargs="+")
    a.add_argument("--methods", nargs="+", choices=tuple(METHODS), default=tuple(METHODS))
    a.add_argument("--workers", type=int, default=2)
    a.add_argument("--out", type=Path, default=Path("out/rivals"))
    asked = a.parse_args()
    sets = [place.resolve() for place in asked.sets]
    for place in sets:
        do = partial(answer, place, asked.out.resolve() / place.name, tuple(asked.methods))
        for _ in spread(do, SetFolder(place).names(), asked.workers, place.name):
            pass
    report(sets, asked.out, list(METHODS))


if __name__ == "__main__":
    main()
