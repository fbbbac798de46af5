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

MOST_STRAIN, MOST_GAIN = 20.0, 20.0
"""More says no more."""
USUAL_ODD_SPINE = 3.5
"""The strangest of some forty spines is usually as far from its prior."""
LEAST_TREND = 1e-4


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
    gain: float
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
        odds += self.trend * max(-math.log10(max(trend, LEAST_TREND)) - 0.7, 0.0)
        odds += self.gain * float(np.clip(s.discrepancy_gain, 0.0, MOST_GAIN))
        return 1 / (1 + math.exp(-odds))


DEVELOPED = "fitted on 100 development cases, clean and cluttered; docs/blind.md has the sealed ones"
FEW = Tempering(1.0, -3.0, 0.3, 1.0, 1.0, 1.2, 0.0, 0.5, DEVELOPED)

TABLE: dict[str, Tempering] = {
    "tip": FEW,
    "tip, orientation": FEW,
    "tip, unload": FEW,
    "tip, orientation, unload": FEW,
}
"""By what the data set holds."""


SEVERAL_KINDS = 8.0
"""Temperature where experiments of several kinds are in one fit: small errors of many laws add up over them, and 40
cluttered cases of that kind would have scored best at 11."""


def tempering(orientation: bool, unload: bool, several_kinds: bool) -> Tempering:
    """The constants for a data set with or without tip orientation and unload branch, of one kind of experiment or more."""
    own = TABLE[", ".join(["tip"] + ["orientation"] * orientation + ["unload"] * unload)]
    return replace(own, temperature=SEVERAL_KINDS) if several_kinds else own
