"""The rod: one description (`Rods`), one verb (`solve`), one answer (`Solution`), and the methods behind it.

    description   Form, Rods: sections, loads and supports of n rods; columns: the number of each in a row
    solver        solve(rods, method) -> Solution
    solution      Solution, Status
    fast/         Fast: batches compiled to machine code, with sensitivities; what diagnosis and fits use
    paper         Paper: the paper's own scheme, explicit Euler and shooting from zeros
    beam          compliances of a cantilever under small deflections; stiffness trials

Other rooms come in by the names below; the columns alone are also known to `model.effects`, which writes rows itself.
"""

from model.rods.fast.compiler import drop_stale_kernels

drop_stale_kernels()

from model.rods.description import Form, Rods, rods  # noqa: E402
from model.rods.fast.derivatives.sensitivity import sensitivities  # noqa: E402
from model.rods.fast.method import FAST, FINE, Fast  # noqa: E402
from model.rods.fast.stations import Stations, gauss_points, stations  # noqa: E402
from model.rods.paper import PAPER, Paper  # noqa: E402
from model.rods.solution import Solution, Status  # noqa: E402
from model.rods.solver import Method, solve  # noqa: E402

__all__ = [
    "FAST",
    "FINE",
    "PAPER",
    "Fast",
    "Form",
    "Method",
    "Paper",
    "Rods",
    "Solution",
    "Stations",
    "Status",
    "gauss_points",
    "rods",
    "sensitivities",
    "solve",
    "stations",
]
