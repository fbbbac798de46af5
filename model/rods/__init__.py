"""The rod: one description (`Rods`), one verb (`solve`), one answer (`Solution`), and the methods behind it.

    description   Form, Rods: sections, loads and supports of n rods; columns: the number of each in a row
    solver        solve(rods, method) -> Solution
    solution      Solution, Status
    fast/         Fast: batches compiled to machine code, with sensitivities; what diagnosis and fits use
    reference     Reference: slow and converged, shares no code with fast/; what it is checked against
    paper         Paper: the paper's own scheme, explicit Euler and shooting from zeros
    beam          Beam: the limit of small deflections in closed form; stiffness trials

Other rooms come in by the names below; the columns alone are also known to `model.effects`, which writes rows itself.
"""

from model.rods.fast.jit import drop_stale_kernels

drop_stale_kernels()

from model.rods.beam import BEAM, Beam  # noqa: E402
from model.rods.description import Form, Rods, blank, rods  # noqa: E402
from model.rods.fast.derivatives.energy_sensitivity import energy_sensitivities  # noqa: E402
from model.rods.fast.derivatives.sensitivity import Sensitivities, sensitivities  # noqa: E402
from model.rods.fast.method import FAST, FINE, Fast  # noqa: E402
from model.rods.fast.stations import Stations, energy, gauss_points, stations, strains  # noqa: E402
from model.rods.paper import PAPER, Paper  # noqa: E402
from model.rods.reference import REFERENCE, Reference  # noqa: E402
from model.rods.solution import Solution, Status  # noqa: E402
from model.rods.solver import Method, solve  # noqa: E402

__all__ = [
    "BEAM",
    "FAST",
    "FINE",
    "PAPER",
    "REFERENCE",
    "Beam",
    "Fast",
    "Form",
    "Method",
    "Paper",
    "Reference",
    "Rods",
    "Sensitivities",
    "Solution",
    "Stations",
    "Status",
    "blank",
    "energy",
    "energy_sensitivities",
    "gauss_points",
    "rods",
    "sensitivities",
    "solve",
    "stations",
    "strains",
]
