"""How large the named effects are: what the data say of each size, within what is physically possible.

Around the fit the problem is linear and its posterior normal, averaged over the grid of tolerances; sizes outside the
physical bounds (a negative stiffness, more than the whole of a law) are cut off. One parameter at a time: the others are
integrated out without bounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from model.actuators import Words
from model.effects.spec import EffectSpec
from model.robot import Robot

from .. import judgement
from ..arrays import Array
from ..inference.candidate import Candidate
from ..inference.prepare import Prepared
from .result import Value


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
    least: float = -np.inf
    """Smallest that is a cause (`spec.Parameter`)."""

    @property
    def effect(self) -> str:
        """The effect it is a parameter of."""
        return self.name.partition(".")[0]

    @property
    def certain(self) -> bool:
        """Whether it differs from zero by more than its error."""
        return self.determined and abs(self.mean) > judgement.SIZE_CERTAIN_SD * self.sd

    @property
    def impossible(self) -> bool:
        """The data ask for a size well beyond the bounds; those of a shape are no physics, but the textbooks'."""
        return self.role == "size" and max(self.low - self.mean, self.mean - self.high) > judgement.BOUND_SD * self.sd


def sizes(p: Prepared, c: Candidate) -> tuple[Size, ...]:
    """The parameters of the effects that a hypothesis names; none for no effect."""
    parameters = p.problem.parameters
    mean, sd = c.weighed.averaged_mean * parameters.scale, judgement.SIZE_SD_FACTOR * c.weighed.averaged_sd * parameters.scale
    seen = c.weighed.averaged_sd < judgement.UNDETERMINED_SHARE * np.sqrt(c.prior(parameters).variance)
    of_effects, out = (info for info in parameters.infos if info.group == "effect"), list[Size]()
    for info, m, s, determined in zip(of_effects, mean.tolist(), sd.tolist(), seen.tolist(), strict=True):
        if info.source in c.named:
            low, high = float(info.low), float(info.high)
            low90, median, high90 = (cut_quantile(m, s, low, high, q) for q in (0.05, 0.5, 0.95))
            out.append(Size(info.name, info.unit, median, m, s, low, high, low90, high90, determined, info.role, info.least))
    return tuple(out)


def as_fitted(s: Size, v: Value) -> Size:
    """A size with the value and standard deviation of the robot that was fitted with the effects."""
    low90, high90 = (cut_quantile(v.value, v.sd, s.low, s.high, q) for q in (0.05, 0.95))
    low90, high90 = min(low90, v.value), max(high90, v.value)  # a value at its bound is no quantile
    pushed = s.impossible and min(v.value - s.low, s.high - v.value) <= judgement.BOUND_SD * v.sd  # to its bound, by the data
    mean, determined = s.mean if pushed else v.value, s.determined and v.determined
    return replace(s, median=v.value, mean=mean, sd=v.sd, low90=low90, high90=high90, determined=determined)


def values(found: tuple[Size, ...]) -> dict[str, Value]:
    """The same as parameter name -> median with its standard deviation."""
    return {s.name: Value(s.median, s.sd, s.unit, s.determined) for s in found}


def places_found(at_places: Mapping[str, Value]) -> list[str]:
    """Places (name -> size there) that stand out, the largest first; none unless all others are clear of it."""
    found = [name for name, v in at_places.items() if abs(v.value) > judgement.PLACE_FOUND_SD * v.sd]
    clear = all(abs(v.value) < judgement.PLACE_CLEAR_SD * v.sd for name, v in at_places.items() if name not in found)
    return sorted(found, key=lambda name: -abs(at_places[name].value)) if clear and len(found) <= judgement.MOST_PLACES else []


@dataclass(frozen=True)
class ByActuator:
    """What an effect makes of each actuator."""

    effect: str
    factor: tuple[float, ...]
    """On what each does."""
    spread: float
    """Relative standard deviation of their differences."""
    sd: tuple[float, ...]
    """(n) of each factor."""

    def by_name(self, words: Words) -> dict[str, Value]:
        """`EFFECT of chamber 1` and so on -> factor."""
        each = enumerate(zip(self.factor, self.sd, strict=True), 1)
        return {f"{self.effect} of {words.actuator} {k}": Value(f, sd, "1") for k, (f, sd) in each}

    def says(self, words: Words, spread: bool = True) -> str:
        """Which one differs from the others, or the two that differ most, by number and in percent."""
        factor = np.array(self.factor)
        others = (factor.sum() - factor) / (len(factor) - 1)
        away = factor / others - 1
        odd = int(np.argmax(np.abs(away)))
        alike = np.ptp(np.delete(factor, odd)) < judgement.ALIKE_SHARE * abs(factor[odd] - others[odd])
        of, by = "the others", away[odd]
        if not alike:  # the two that differ most
            odd, strongest = int(factor.argmin()), int(factor.argmax())
            of, by = f"{words.actuator} {strongest + 1}", factor[odd] / factor[strongest] - 1
        sd = 100 * abs(by) * self.spread
        amount = f"{100 * abs(by):.0f}{f' ± {sd:.0f}' if spread and sd >= 0.5 else ''} %"
        return f"{words.actuator} {odd + 1} {words.pushes} {amount} {'more' if by > 0 else 'less'} than {of}"


def by_actuator(robot: Robot, spec: EffectSpec, sizes: Mapping[str, Value], covariance: Array | None = None) -> ByActuator | None:
    """What an effect of these sizes (EFFECT.PARAMETER -> value) makes of each actuator; None where it is more than a factor on
    each. `covariance`: of these sizes; unless given, they are independent, and shapes exact."""
    known = {p.name: v for p in spec.parameters if (v := sizes.get(f"{spec.id}.{p.name}")) is not None}
    if spec.each is None or not known or len(robot.actuators.azimuths_deg) < 2:
        return None
    of_size = [p.role == "size" for p in spec.parameters if p.name in known]
    found = np.array([v.value for v in known.values()])
    if not (size := float(np.linalg.norm(found[of_size]))):
        return None
    if covariance is None:
        covariance = np.diag([v.sd**2 * one for v, one in zip(known.values(), of_size, strict=True)])
    drawn = np.vstack([found, np.random.default_rng(0).multivariate_normal(found, covariance, 1000)])
    absent = {p.name: np.array(0.0) for p in spec.parameters}
    factor = spec.each(robot, absent | dict(zip(known, drawn.T, strict=True)))
    spread = float(np.linalg.norm(drawn[1:, of_size], axis=1).std()) / size
    return ByActuator(spec.id, tuple(factor[0].tolist()), spread, tuple(factor[1:].std(axis=0).tolist()))


def cut_quantile(mean: float, sd: float, low: float, high: float, share: float) -> float:
    """Quantile of a normal that is cut at `low` and `high`; `share` is the probability below it.

    In logarithms, mirrored where both bounds are above the mean, so that it keeps its digits however far out they are.
    (`scipy.stats.truncnorm` takes as long to import as a hundred predictions.)
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    side = -1.0 if a > 0 else 1.0
    a, b, share = (a, b, share) if side > 0 else (-b, -a, 1 - share)
    log_below = np.logaddexp(np.log1p(-share) + log_ndtr(a), np.log(share) + log_ndtr(b))
    return float(np.clip(mean + side * sd * ndtri_exp(log_below), low, high))
