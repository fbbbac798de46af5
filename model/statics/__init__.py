"""The fast static Cosserat rod: millions of solves, in batches of arrays, with their sensitivities."""

from model.statics.jit import drop_stale_kernels

drop_stale_kernels()

from model.statics.problem import Form, Rods, blank, rods  # noqa: E402
from model.statics.sensitivity import Sensitivities, sensitivities  # noqa: E402
from model.statics.shape import Stations, energy, gauss_points, stations, strains  # noqa: E402
from model.statics.solver import DEFAULT, FINE, Accuracy, Solution, solve  # noqa: E402
from model.statics.work import energy_sensitivities  # noqa: E402

__all__ = [
    "DEFAULT",
    "FINE",
    "Accuracy",
    "Form",
    "Rods",
    "Sensitivities",
    "Solution",
    "Stations",
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
