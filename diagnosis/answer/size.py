"""How large the named effects are: what the data say of each size, within what is physically possible.

Around the fit the problem is linear and its posterior normal, averaged over the grid of tolerances; sizes outside the
physical bounds (a negative stiffness, more than the whole of a law) are cut off. One parameter at a time: the others are
integrated out without bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from ..inference.candidate import Candidate
from ..inference.prepare import Prepared
from ..judgement import BOUND_SD, SIZE_CERTAIN_SD, SIZE_SD_FACTOR, UNDETERMINED_SHARE
from .result import Value

PAYLOAD = "tip_payload.mass"


@dataclass(frozen=True)
class Size:
    """One parameter of a named effect, in its unit."""

    name: str
    unit: str
    median: float
    """Of the cut posterior: the value that is stated."""
    mean: float
    """Of the normal posterior before it is cut."""
    sd: float
    low: float
    high: float
    """Physical bounds."""
    low90: float
    high90: float
    """90 % interval of the cut posterior."""
    determined: bool
    """Whether the data say more of it than was assumed before."""
    role: str = "size"
    """size or shape."""

    @property
    def certain(self) -> bool:
        """Whether it differs from zero by more than its error."""
        return self.determined and abs(self.mean) > SIZE_CERTAIN_SD * self.sd

    @property
    def impossible(self) -> bool:
        """The data ask for a value well beyond the bounds."""
        return self.mean < self.low - BOUND_SD * self.sd or self.mean > self.high + BOUND_SD * self.sd


def sizes(p: Prepared, c: Candidate) -> tuple[Size, ...]:
    """The parameters of the effects that a hypothesis names; none for no effect."""
    parameters = p.problem.parameters
    if not c.named:
        return ()
    mean, sd = c.weighed.averaged_mean * parameters.scale, SIZE_SD_FACTOR * c.weighed.averaged_sd * parameters.scale
    seen = c.weighed.averaged_sd < UNDETERMINED_SHARE
    found = zip(np.flatnonzero(parameters.of_effect).tolist(), mean.tolist(), sd.tolist(), seen.tolist(), strict=True)
    return tuple(_size(p, i, *own) for i, *own in found if parameters.effects[i] in c.named)


def values(found: tuple[Size, ...]) -> dict[str, Value]:
    """The same as parameter name -> median with its standard deviation."""
    return {s.name: Value(s.median, s.sd, s.unit, s.determined) for s in found}


def _size(p: Prepared, i: int, mean: float, sd: float, seen: bool) -> Size:
    parameters = p.problem.parameters
    low, high = float(parameters.lower[i]), float(parameters.upper[i])
    if parameters.names[i] == PAYLOAD:  # no more is taken off the tip than hangs there
        low = max(low, -float(p.forward.design.tip_mass[p.states.main].min()))
    low90, median, high90 = (float(np.clip(cut_quantile(mean, sd, low, high, q), low, high)) for q in (0.05, 0.5, 0.95))
    return Size(
        parameters.names[i], parameters.infos[i].unit, median, mean, sd, low, high, low90, high90, seen, parameters.infos[i].role
    )


def cut_quantile(mean: float, sd: float, low: float, high: float, share: float) -> float:
    """Quantile of a normal that is cut at `low` and `high`; `share` is the probability below it.

    In logarithms, mirrored where both bounds are above the mean, so that it keeps its digits however far out they are.
    (`scipy.stats.truncnorm` takes as long to import as a hundred predictions.)
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    side = -1.0 if a > 0 else 1.0
    a, b, share = (a, b, share) if side > 0 else (-b, -a, 1 - share)
    log_below = np.logaddexp(np.log1p(-share) + log_ndtr(a), np.log(share) + log_ndtr(b))
    return float(mean + side * sd * ndtri_exp(log_below))
