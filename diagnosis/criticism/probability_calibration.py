"""How far stated probabilities are to be trusted: constants found on a bench of sealed cases.

Evidence is sharper than the model deserves, because no model is exact. Dividing log evidence by a temperature makes the
stated probabilities match how often they were right on the bench that is named here. How probable a cause outside the
catalogue is follows from its signs by logistic regression on the same bench: evidence cannot say, because no model of
such a cause exists.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .unknown import Signs

MOST_STRAIN = 20.0
"""More says no more."""
USUAL_ODD_SPINE = 3.5
"""The strangest of some forty spines is usually as far from its prior."""
USUAL_BEYOND, MOST_BEYOND = 2.0, 10.0
"""Factors by which repeats may differ more than usual: less is chance, more says no more."""
FEW = 2
"""So many effects at once are nothing strange."""
LEAST_TREND, USUAL_TREND = 1e-4, 0.7
"""Probability below which less says no more; orders of magnitude that chance makes as well."""


@dataclass(frozen=True)
class ProbabilityCalibration:
    """Constants that the bench set."""

    temperature: float
    base: float
    """Log odds of a cause outside the catalogue without any sign."""
    strain: float
    transport: float
    odd_spine: float
    trend: float
    beyond: float
    many: float
    """By how much each sign raises them."""
    spread: float
    """How much wider a size's standard deviation is than that of the linear problem."""
    flagged: float
    """Probability of a cause outside the catalogue from which the answer is `unknown`."""
    bench: str
    """What they were fitted on; shown with every probability."""

    def outside(self, s: Signs, trend: float) -> float:
        """Probability of a cause outside the catalogue; `trend` is the probability that repeats follow time by chance."""
        odds = self.base
        odds += self.strain * float(np.clip(s.strain, 0.0, MOST_STRAIN))
        odds += self.transport * math.log(max(s.transport or 1.0, 1.0))
        odds += self.odd_spine * max(s.odd_spine - USUAL_ODD_SPINE, 0.0)
        odds += self.beyond * max(math.log(min(s.beyond, MOST_BEYOND) / USUAL_BEYOND), 0.0)
        odds += self.many * max(s.named - FEW, 0)
        odds += self.trend * max(-math.log10(max(trend, LEAST_TREND)) - USUAL_TREND, 0.0)
        return 1 / (1 + math.exp(-odds))


CALIBRATED = ProbabilityCalibration(
    temperature=1.0, base=-2.7, strain=0.25, transport=1.0, odd_spine=0.8, trend=1.4, beyond=3.0, many=0.8,
    spread=1.2, flagged=0.5,
    bench="fitted on 180 development cases, clean and cluttered; docs/explanations/blind.md has the sealed ones",
)  # fmt: skip
