"""How the zero of a force sensor moved during a stiffness trial, and what follows for its rows: pure, live and in replay.

The unloaded sensor is read three times, with the probe in the same orientation: before the spine is jammed, before the
approach (where its zero is taken), and after the retreat. The last two tell by how much the zero moved over the trial.
The first two tell how fast it moved before: at the same pace it is a constant drift, which is removed from the forces as
a line; at another pace (a step, a sensor that warms up) no line is right, and the rows are marked instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from ..errors import NotSettled, TooFewSamples
from ..trials import TrialRow
from .averaging import along_push, mean
from .buffer import Streams

TOLERATED = 0.1
"""N that a line may miss the drift by before rows are marked: the noise of one sample of an FT 300-S."""

Span = tuple[float, float]


@dataclass(frozen=True)
class Zeros:
    """When the unloaded sensor was read about one trial, each from and to (rig time, s), and along which direction."""

    trial: int
    direction: tuple[float, float, float]
    """Unit vector of the push, arm base frame."""
    before: Span
    """Before the spine was jammed."""
    start: Span
    """Before the approach."""
    end: Span
    """After the retreat."""
    offset_at: float
    """s; forces of the rows count from what was read then, at the first contact."""


@dataclass(frozen=True)
class Unloaded:
    """What the unloaded sensor read along the push: mean time (s), force (N), standard error (N)."""

    t: float
    force: float
    error: float


@dataclass(frozen=True)
class Drift:
    """How the zero moved during one trial."""

    force: float
    """N along the push, from before the approach to after the retreat."""
    rate: float
    """N/s over that time."""
    linear: bool
    """It moved at a constant pace, as far as the readings can tell."""


def unloaded(streams: Streams, direction: Sequence[float], span: Span) -> Unloaded | None:
    """Average the unloaded sensor over a span of time; None while samples are missing that may still come.

    Raises TooFewSamples with fewer than two of /force or none of /arm.
    """
    t0, t1 = span
    if not min(streams.newest(topic) for topic in ("/force", "/arm")) > t1:
        return None
    force, arm = streams.window("/force", t0, t1), streams.window("/arm", t0, t1)
    n = len(force)
    if n < 2 or not len(arm):
        raise TooFewSamples(f"{n} samples of /force and {len(arm)} of /arm from {t0:.2f} to {t1:.2f} s for a zero")
    along = along_push(direction, force["raw"], arm["tcp_pose"])
    if not all(map(math.isfinite, along.tolist())):
        raise NotSettled(f"/force: raw is not a number from {t0:.2f} to {t1:.2f} s; check the sensor and its connection")
    read = mean(force["t"], along)
    return Unloaded(math.fsum(force["t"].tolist()) / n, read.value, read.sd / math.sqrt(n))


def drift(before: Unloaded, start: Unloaded, end: Unloaded) -> Drift:
    """How the zero moved from `start` to `end`, and whether at the pace at which it moved before."""
    span_before, span_trial, force = start.t - before.t, end.t - start.t, end.force - start.force
    if not (span_before > 0 and span_trial > 0):
        return Drift(force, 0.0, False)
    rate = force / span_trial
    rate_change = (start.force - before.force) / span_before - rate
    error = math.hypot(before.error / span_before, end.error / span_trial, start.error * (1 / span_before + 1 / span_trial))
    # at four standard errors, one constant drift in 15 000 is mistaken
    linear = abs(rate_change) <= 4.0 * error or abs(rate_change) * span_trial <= TOLERATED
    return Drift(force, rate, linear)


def without_drift(rows: Iterable[TrialRow], drifts: Iterable[tuple[Zeros, Drift]]) -> list[TrialRow]:
    """Rows with what is known of the zero's drift: removed from their forces where it is a line, else marked."""
    corrected = list(rows)
    for zeros, zero_drift in drifts:
        for i, row in enumerate(corrected):
            if row.trial != zeros.trial or row.force is None or not zeros.start[1] <= row.t <= zeros.end[0]:
                continue
            if zero_drift.linear:
                shift = zero_drift.rate * (row.t - zeros.offset_at)
                corrected[i] = replace(row, force=row.force - shift, force_drift=zero_drift.force)
            else:
                corrected[i] = replace(row, force_drift=zero_drift.force, doubt=row.doubt or "drift")
    return corrected
