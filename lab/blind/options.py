"""Options of `lab blind`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Literal, get_args

Stratum = Literal[
    "clean", "none", "cluttered", "cluttered_none", "pairs", "cluttered_pairs", "outside", "cluttered_outside", "walls"
]
STRATA: tuple[Stratum, ...] = get_args(Stratum)
"""What `--kind` may ask for."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The three steps and their options."""
    steps = parser.add_subparsers(dest="step", required=True, metavar="STEP")
    p = steps.add_parser("make", help="draw the truth, measure the cases, seal the truth")
    p.add_argument("out", type=Path, help="an empty folder")
    p.add_argument("--n", type=int, default=200, help="cases (default 200)")
    p.add_argument("--seed", type=int, required=True, help="seed, one that was not used before")
    p.add_argument("--design", default="full", help="tip, full (orientation and unload), full+markers, full+extras")
    p.add_argument(
        "--clutter",
        type=float,
        help="of cluttered kinds: every other effect at this share of its scale (default: the world's own)",
    )
    p.add_argument(
        "--world",
        default="bench",
        metavar="W",
        help="physics of the robots: bench (default), workshop, cellar, attic, shared, field, quiet, or drawn:SEED",
    )
    p.add_argument(
        "--kind",
        action="append",
        choices=STRATA,
        help="only cases of this kind (repeatable; default: a mixture)",
    )
    p.add_argument(
        "--held-out",
        action="store_true",
        help="held-out outside causes, for a final score",
    )
    p.add_argument(
        "--sizes", type=float, nargs=2, default=(0.5, 1.5), metavar=("LOW", "HIGH"), help="effects, in plausible scales"
    )
    p.add_argument("--settled", action="store_true", help="stop and read, instead of reading while ramping slowly")
    p.add_argument("--per-length", action="store_true", help="an area factor of its own for each spine length")
    p.add_argument("--no-menu", action="store_true", help="offer no further experiments")
    p.add_argument(
        "--simulator",
        metavar="NAME|FILE.py",
        help="its predictions are the baseline, in the rod's place; no further experiments",
    )
    p.add_argument(
        "--cause",
        action="append",
        metavar="ID",
        help="draw causes from these effects (repeatable)",
    )
    _crew(p)
    p = steps.add_parser("run", help="diagnose every case; the seal stays closed")
    p.add_argument("out", type=Path)
    p.add_argument("--chosen", type=int, default=0, help="experiments that the diagnosis may request (0 to 3)")
    p.add_argument(
        "--choose",
        choices=("information", "random", "repeat"),
        default="information",
        help="next experiment: what the diagnosis asks for (default), any of the menu, or the sweep again",
    )
    _crew(p)
    p.add_argument("--quick", action="store_true", help="no held-out errors, and without --chosen no next experiments")
    p = steps.add_parser("score", help="open the seal and score")
    p.add_argument("out", type=Path)
    p.add_argument("--after", type=int, help="score the answers given after this many experiments (default: the last)")
    p.add_argument("--json", action="store_true", help="print the result as JSON")


def _crew(p: argparse.ArgumentParser) -> None:
    p.add_argument("--workers", type=int, default=1, help="processes of this machine (default 1)")
    p.add_argument("--scheduler", help="a Dask scheduler instead, tcp://host:port (extra `cluster`)")
