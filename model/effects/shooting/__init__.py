"""Equilibria of rods by shooting from the tip, with base compliance, springs at the tip and hyperelastic sections.

Unknowns of a rod: the rotation of its tip and, where springs hold it, the tip's position. A pass integrates from the
tip to the base; the base then misses its pose, and Newton's method with Broyden's updates closes the gap. Derivatives
follow from the implicit function theorem at the solution, their parts by differences of single passes.

Beside what `model.statics` gives, these rods tell the orientation of the spine's end and of the base, mean strains and
positions along the arc with all their derivatives, which effects with memory and markers need.
"""

from pathlib import Path

from model.statics.jit import drop_stale_kernels

drop_stale_kernels(Path(__file__).parent)

from model.effects.shooting.kernels import sensitivities, solve_rows  # noqa: E402

__all__ = ["sensitivities", "solve_rows"]
