"""Have the kernels of the rod compiled ahead, at low priority: `python -m model.warm_up`.

The first solve of each kind of rod compiles for a while, once a machine. What keeps a processor idle meanwhile (a rig, a
person) can have that done in a process beside it; a kernel that is ready is on disk and ready for every process.
"""

from __future__ import annotations

import os

import numpy as np

from model import statics
from model.effects import history, layout, solver

PRIORITY = 19
"""Only what nobody else wants."""
BUCKLING = 2.0
"""A margin that no rod has: every rod is loaded in steps."""


def warm_up() -> None:
    """Solve one rod of each form that fits, comparisons and diagnoses use, in every way they do; what all need first."""
    plain, full = (_one(form) for form in (statics.Form(elements=2), layout.FORM))
    found = statics.solve(plain, statics.FINE)
    rows, arcs = full.values.copy(), np.array([0.1])
    solved = solver.solve(rows, arcs, solver.integration_steps(rows))
    solver.differentiate(solved, np.zeros((1, *rows.shape)))
    statics.stations(plain, found, np.array([[0.1]]), statics.FINE)
    first, at_once = np.zeros(1, np.int64), np.zeros(1)
    path = history.Path(first, first, np.array([True]), at_once, at_once, at_once)
    path.lag(np.zeros((1, 1, history.DRIVES)), 1.0)
    path.sliding(np.zeros((1, 1, 2)), np.ones((1, 1)))
    for rods in (plain, full):
        statics.solve(rods, solver.ACCURACY, least_margin=BUCKLING)


def _one(form: statics.Form) -> statics.Rods:
    return statics.rods(form, 1, length=0.1, bend_stiffness=0.1, stretch_stiffness=100.0, tip_force=[0.1, 0.0, 0.0])


if __name__ == "__main__":
    os.nice(PRIORITY)
    warm_up()
