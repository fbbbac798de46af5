"""Have the kernels of the rod compiled ahead, at low priority: `python -m model.warm_up [plain|full|derivatives]`.

The first solve of each kind of rod compiles for a while, once a machine. What keeps a processor idle meanwhile (a rig, a
person) can have that done in processes beside it, one a part; a kernel that is ready is on disk and ready for every process.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from model.effects import history, layout, solver
from model.rods import FINE, PAPER, Form, Rods, rods, sensitivities, solve, stations
from model.rods.fast.compiler import compiled_here
from model.rods.solution import AT_ORIENTATION, RESULT, Solution, no_shape

BUCKLING = 2.0
"""A margin that no rod has: every rod is loaded in steps."""


def plain() -> None:
    """The rod of fits and comparisons, in every way they use it."""
    one = _one(Form(elements=2))
    stations(one, solve(one, FINE), np.array([[0.1]]), FINE)
    solve(one, replace(FINE, least_margin=BUCKLING))


def full() -> None:
    """The rod of diagnoses, with all that an effect may change."""
    uniform = layout.UNIFORM
    one = _one(uniform.form)
    rows, arcs = one.values.copy(), np.array([0.1])
    solver.solve(uniform, rows, arcs, solver.integration_steps(uniform, rows))
    solve(one, replace(solver.METHOD, least_margin=BUCKLING))


def derivatives() -> None:
    """What diagnoses differentiate, without solving anything: of a rod that is said to be straight; and what else they need, the
    laws with memory and the paper's own integration."""
    first, at_once = np.zeros(1, np.int64), np.zeros(1)
    path, drive = (
        history.Path(first, first, np.array([True]), at_once, at_once, at_once),
        np.zeros((1, 1, history.DRIVES)),
    )
    path.lag(drive, 1.0)
    path.sliding(np.zeros((1, 1, 2)), np.ones((1, 1)))
    path.held(np.zeros((1, 1, 1)), np.zeros((1, 1, 2, 2)))
    path.extremes(drive, np.zeros((1, 1, history.CELLS)), at_once, at_once)
    one = _one(layout.UNIFORM.form)
    solve(one, PAPER)
    values = np.zeros((1, RESULT))
    values[0, AT_ORIENTATION] = 1.0
    straight = Solution(values, np.zeros(1, np.int8), no_shape(1))
    sensitivities(one, straight, np.zeros((1, 1, one.form.width)), solver.METHOD, strain=True)


PARTS: Mapping[str, Callable[[], None]] = {"plain": plain, "full": full, "derivatives": derivatives}


def warm_up(parts: Sequence[str] = tuple(PARTS)) -> bool:
    """Solve one rod of each form that fits, comparisons and diagnoses use, in every way they do; whether anything had to be
    compiled for that."""
    before = compiled_here()
    for part in parts:
        PARTS[part]()
    return compiled_here() > before


def _one(form: Form) -> Rods:
    return rods(form, 1, length=0.1, bend_stiffness=0.1, stretch_stiffness=100.0, tip_force=[0.1, 0.0, 0.0])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m model.warm_up", description=__doc__)
    parser.add_argument("part", nargs="?", choices=list(PARTS), help="one part; all unless given")
    only = parser.parse_args().part
    # others come first
    os.nice(5)
    warm_up([only] if only else list(PARTS))
