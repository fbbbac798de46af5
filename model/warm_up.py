"""Have the kernels of the rod compiled ahead, at low priority: `python -m model.warm_up [rods|derivatives]`.

The first solve compiles for a while, once a machine. What keeps a processor idle meanwhile (a rig, a person) can have that done
in processes beside it, one a part; a kernel that is ready is on disk and ready for every process.
"""

from __future__ import annotations

import argparse
import gc
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from model import rods as rod
from model.effects import history
from model.rods.fast.compiler import compiled_here
from model.rods.solution import AT_ORIENTATION, RESULT, Solution

BUCKLING = 2.0
"""A margin that no rod has: every rod is loaded in steps."""


def rods() -> None:
    """What every solve needs: solving directly, following the load, stations."""
    one = _one()
    rod.stations(one, rod.solve(one), np.array([[0.1]]))
    rod.solve(one, replace(rod.FAST, least_margin=BUCKLING))


def derivatives() -> None:
    """What diagnoses need besides: derivatives (of a rod that is taken to be straight, so that nothing is solved), the laws with
    memory and the paper's own integration."""
    first, at_once = np.zeros(1, np.int64), np.zeros(1)
    path, drive = (history.Path(first, first, np.array([True]), at_once, at_once, at_once), np.zeros((1, 1, history.DRIVES)))
    path.lag(drive, 1.0)
    path.sliding(np.zeros((1, 1, 2)), np.ones((1, 1)))
    path.held(np.zeros((1, 1, 1)), np.zeros((1, 1, 2, 2)))
    path.extremes(drive, np.zeros((1, 1, history.CELLS)), at_once, at_once, 1.0)
    batch = _one()
    rod.solve(batch, rod.PAPER)
    values = np.zeros((1, RESULT))
    values[0, AT_ORIENTATION] = 1.0
    straight = Solution(values, np.zeros(1, np.int8), np.zeros((1, 0, 3)))
    rod.sensitivities(batch, straight, np.zeros((1, 1, batch.form.width)), strain=True)


PARTS: Mapping[str, Callable[[], None]] = {"rods": rods, "derivatives": derivatives}


def warm_up(parts: Sequence[str] = tuple(PARTS)) -> bool:
    """Solve one rod in every way that fits, comparisons and diagnoses do; whether this process has compiled anything so far."""
    gc.disable()  # collections take a tenth of the time of compiling, and find little
    try:
        for part in parts:
            PARTS[part]()
    finally:
        gc.enable()
    return compiled_here() > 0


def _one() -> rod.Rods:
    return rod.rods(rod.Form(elements=2), 1, length=0.1, bend_stiffness=0.1, stretch_stiffness=100.0, tip_force=[0.1, 0.0, 0.0])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m model.warm_up", description=__doc__)
    parser.add_argument("part", nargs="?", choices=list(PARTS), help="one part; all unless given")
    only = parser.parse_args().part
    # others come first
    os.nice(5)
    warm_up([only] if only else list(PARTS))
