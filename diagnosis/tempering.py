"""How far stated probabilities are to be trusted: constants found on a bench of sealed cases.

Evidence is sharper than the model deserves, because no model is exact. Dividing log evidence by a temperature makes the
stated probabilities match how often they were right on the bench that is named here. How probable a cause outside the
catalogue is follows from its signs by logistic regression on the same bench: evidence cannot say, because no model of
such a cause exists.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .unknown import Signs

MOST_STRAIN = 20.0
"""More says no more."""
USUAL_ODD_SPINE = 3.5
"""The strangest of some forty spines is usually as far from its prior."""
LEAST_TREND, USUAL_TREND = 1e-4, 0.7
"""Probability below which less says no more; orders of magnitude that chance makes as well."""


@dataclass(frozen=True)
class Tempering:
    """Constants for one kind of data set."""

    temperature: float
    base: float
    """Log odds of a cause outside the catalogue without any sign."""
    strain: float
    transport: float
    odd_spine: float
    trend: float
    """By how much each sign raises them."""
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
        odds += self.trend * max(-math.log10(max(trend, LEAST_TREND)) - USUAL_TREND, 0.0)
        return 1 / (1 + math.exp(-odds))


BENCH = "fitted on 100 development cases, clean and cluttered; docs/blind.md has the sealed ones"
ONE_KIND = Tempering(1.0, -3.0, 0.3, 1.0, 1.0, 1.2, 0.5, BENCH)
"""Whatever the sweep holds: no bench so far told tips alone from tips with orientation and unload branch."""
SEVERAL_KINDS = replace(ONE_KIND, temperature=8.0)
"""Where experiments of several kinds are in one fit: small errors of many laws add up over them, and 40 cluttered cases of
that kind would have scored best at a temperature of 11."""
