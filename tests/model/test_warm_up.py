"""What is compiled ahead is what is asked for later."""

import subprocess
import sys
from itertools import permutations

import numpy as np
from numba.core import event

from model.effects import solver
from model.effects.layout import UNIFORM
from model.rods import FINE, Form, rods, solve, stations
from model.warm_up import warm_up


def test_after_warming_up_no_kernel_of_the_diagnosis_is_compiled() -> None:
    warm_up()
    with event.install_recorder("numba:compile") as compiled:
        n = 3 * 8 + 1
        rows = rods(UNIFORM.form, n, length=0.2, bend_stiffness=0.2, stretch_stiffness=90.0, tip_force=[0.0, 0.2, 0.0]).values
        solved = solver.solve(UNIFORM, rows, np.array([0.05, 0.1]), solver.integration_steps(UNIFORM, rows))
        solver.solve(UNIFORM, rows, np.array([0.05, 0.1]), solved.steps, solved, inside=False)
        solver.differentiate(solved, np.zeros((2, UNIFORM.width)))
        plain = rods(Form(elements=2), n, length=0.2, bend_stiffness=0.2, stretch_stiffness=90.0)
        stations(plain, solve(plain, FINE), np.full((n, 2), 0.1), FINE)
    assert compiled.buffer == []


def test_rod_and_fakes_are_compiled_for_the_same_processor_whichever_is_imported_first() -> None:
    """Machine code on disk is found by what the processor is told to be: else one of the two is compiled anew."""
    code = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]\n"
    code += "from numba.core.registry import cpu_target; print(cpu_target.target_context.codegen().magic_tuple())"
    told = {
        subprocess.run([sys.executable, "-c", code, *order], capture_output=True, text=True, check=True).stdout
        for order in permutations(("model.rods", "sim_fakes.virtual_robot"))
    }
    assert len(told) == 1 and told != {""}
