"""A weighed hypothesis, and the part of it that is sent to another process."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .evidence import Hypothesis, Weighed
from .fit import Fit
from .jacobian import Jacobian
from .linear import SizePrior
from .problem import FitParameters


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with its evidence, and the fit around which it was weighed."""

    named: Hypothesis
    weighed: Weighed
    fit: Fit
    with_tolerances: bool
    """Fitted with every other effect free within its tolerance; else with all others absent."""
    turns: int = 0
    """How often its search was continued; 0: weighed at a start, or where another hypothesis was fitted."""
    ended: bool = False
    """Whether its search has ended."""

    def prior(self, p: FitParameters) -> SizePrior:
        """Of the effects, at the most probable point of the grid, in the linear problem of the fit."""
        return p.prior(p.mask(self.named), self.weighed.peak.spike, self.weighed.peak.slab, p.effect_size(self.fit.theta))

    @property
    def base(self) -> Jacobian | None:
        """Derivatives shared with others; None if all are its own."""
        return None if self.fit.slope is None else self.fit.slope.base

    @property
    def log_evidence(self) -> float:
        """That of the linear problem (Laplace approximation) less the decrease of the cost that it predicts and the model did not
        reach."""
        return self.weighed.log_evidence - self.fit.predicted_decrease


Bases = dict[str, Jacobian]
"""By name."""


def light(c: Candidate, bases: Bases) -> Candidate:
    """The same without derivatives that another process already has."""
    slope = c.fit.slope
    name = next((n for n, r in bases.items() if r is c.base), None)
    return c if slope is None or name is None else replace(c, fit=replace(c.fit, slope=replace(slope, base=None, left=name)))


def complete(c: Candidate, bases: Bases) -> Candidate:
    """The inverse of `light`."""
    slope = c.fit.slope
    if slope is None or slope.left is None:
        return c
    return replace(c, fit=replace(c.fit, slope=replace(slope, base=bases[slope.left], left=None)))
