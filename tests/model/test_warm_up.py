"""What is compiled ahead is what is asked for later."""

import subprocess
import sys
from itertools import permutations


def test_rod_and_fakes_are_compiled_for_the_same_processor_whichever_is_imported_first() -> None:
    """Machine code on disk is found by what the processor is told to be: else one of the two is compiled anew."""
    code = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]\n"
    code += "from numba.core.registry import cpu_target; print(cpu_target.target_context.codegen().magic_tuple())"
    told = {
        subprocess.run([sys.executable, "-c", code, *order], capture_output=True, text=True, check=True).stdout
        for order in permutations(("model.rods", "sim_fakes.virtual_robot"))
    }
    assert len(told) == 1 and told != {""}
