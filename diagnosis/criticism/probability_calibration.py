"""Calibration of probabilities: constants fitted on a benchmark of sealed cases.

Evidence is overconfident, because no model is exact. Log evidence is divided by a temperature, so that the stated
probabilities match how often they were right on the benchmark. The probability of a cause outside the catalogue begins at the
share that the prior leaves to it, less what it tells against one that nothing asks for it. It follows from what free-form errors
of the stages and large errors of the laws gain, which is evidence like any other, and from three misfit diagnostics
(decision 059).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..inference.posterior import PRIOR_SHARES
from .misfit import MisfitDiagnostics

TYPICAL_EXCESS, MOST_EXCESS = 2.0, 10.0
"""Factors of excess scatter: less than the first is chance, more than the second counts as the second."""
NO_SIGN = 0.77
"""How much rarer a cause outside the catalogue is where nothing asks for it: in seven unseen worlds at most 31 of 42 such causes
gave no sign, and 227 of 238 robots without one."""
USUAL_GAIN = 4.0
"""Log evidence that free-form errors of the stages gain where the cause is known: slow errors of cameras, laws that differ."""
MOST_LAW_ODDS = 2.0
"""Log odds that laws far off add at most: a known cause may have a law that none of ours comes near."""
FEW_EFFECTS = 2
"""Up to this many effects at once are not unusual."""
MOST_ODDS = 7.0
"""Log odds above which no misfit makes a cause outside the catalogue more probable."""


@dataclass(frozen=True)
class ProbabilityCalibration:
    """Constants fitted on the benchmark."""

    temperature: float
    prior_outside: float
    """Probability of a cause outside the catalogue when no diagnostic stands out: what the prior leaves to it."""
    cross_prediction: float
    excess_scatter: float
    many_effects: float
    """Coefficients of the log odds, one for each diagnostic."""
    sd_factor: float
    """Factor on the standard deviation of a size in the linear problem."""
    unknown_threshold: float
    """Probability of a cause outside the catalogue from which the answer is `unknown`."""
    benchmark: str
    """What they were fitted on; shown with every probability."""

    @property
    def outside_without_sign(self) -> float:
        """Probability of a cause outside the catalogue where nothing asks for it: its least."""
        odds = NO_SIGN * self.prior_outside / (1 - self.prior_outside)
        return odds / (1 + odds)

    def probability_outside(self, s: MisfitDiagnostics, stage_gain: float = 0.0) -> float:
        """Probability of a cause outside the catalogue; `stage_gain` the log evidence that free-form errors of the stages
        gain."""
        odds = math.log(self.outside_without_sign / (1 - self.outside_without_sign))
        odds += max(stage_gain - USUAL_GAIN, 0.0) / self.temperature
        odds += min(max(s.law_error_gain, 0.0) / self.temperature, MOST_LAW_ODDS)
        odds += self.cross_prediction * math.log(max(s.cross_prediction or 1.0, 1.0))
        odds += self.excess_scatter * max(math.log(min(s.excess_scatter, MOST_EXCESS) / TYPICAL_EXCESS), 0.0)
        odds += self.many_effects * max(s.effects_named - FEW_EFFECTS, 0)
        return 1 / (1 + math.exp(-min(odds, MOST_ODDS)))


CALIBRATED = ProbabilityCalibration(
    temperature=4.0, prior_outside=1 - sum(PRIOR_SHARES.values()), cross_prediction=1.0, excess_scatter=1.0,
    many_effects=0.8, sd_factor=1.2, unknown_threshold=0.5,
    benchmark="calibrated on the blind bench, docs/explanations/blind.md",
)  # fmt: skip
