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

from ..judgement import (
    CROSS_PREDICTION_WEIGHT,
    EXCESS_SCATTER_WEIGHT,
    LARGEST_EXCESS,
    LARGEST_LAW_ODDS,
    LARGEST_ODDS,
    MANY_EFFECTS_WEIGHT,
    NO_SIGN,
    OUTSIDE_PROBABILITY,
    PRIOR_OF_NUMBER,
    SIZE_SD_FACTOR,
    TEMPERATURE,
    USUAL_EFFECTS,
    USUAL_EXCESS,
    USUAL_STAGE_GAIN,
)
from .misfit import MisfitDiagnostics


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
        odds += max(stage_gain - USUAL_STAGE_GAIN, 0.0) / self.temperature
        odds += min(max(s.law_error_gain, 0.0) / self.temperature, LARGEST_LAW_ODDS)
        odds += self.cross_prediction * math.log(max(s.cross_prediction or 1.0, 1.0))
        odds += self.excess_scatter * max(math.log(min(s.excess_scatter, LARGEST_EXCESS) / USUAL_EXCESS), 0.0)
        odds += self.many_effects * max(s.effects_named - USUAL_EFFECTS, 0)
        return 1 / (1 + math.exp(-min(odds, LARGEST_ODDS)))


CALIBRATED = ProbabilityCalibration(
    temperature=TEMPERATURE, prior_outside=1 - sum(PRIOR_OF_NUMBER.values()), cross_prediction=CROSS_PREDICTION_WEIGHT,
    excess_scatter=EXCESS_SCATTER_WEIGHT,
    many_effects=MANY_EFFECTS_WEIGHT, sd_factor=SIZE_SD_FACTOR, unknown_threshold=OUTSIDE_PROBABILITY,
    benchmark="calibrated on the blind bench, docs/explanations/blind.md",
)  # fmt: skip
