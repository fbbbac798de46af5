"""When a state is read: pure functions of samples and rules, for the live run and for replay alike.

All are causal. A window is found as soon as its last sample is there and does not depend on anything later, so it does
not matter when, or how often, one asks. `watermark` is the stamp (s) before which every stream relied on is complete:
the oldest of the streams' newest stamps. A window must end before it.

Samples are arrays as `recordings.messages` decodes them, oldest first, from `t_start` on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import NotSettled
from .rules import Crossing, Settled, Window

Samples = NDArray[np.void]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Span:
    """The samples to average: t0 <= t <= t1 (s); for a crossing also the moment `at` (s) the reading is for."""

    t0: float
    t1: float
    at: float


def tracked(tip: Samples) -> Samples:
    """The tip samples that may be used: tracking valid and a position there."""
    return tip[tip["valid"] & np.isfinite(tip["position"]).all(axis=1)]


def settled_window(
    pressure: Samples,
    tip: Samples,
    others: Mapping[str, Numbers],
    targets: Sequence[float],
    rule: Settled,
    t_start: float,
    watermark: float,
) -> Span | None:
    """The first window in which the robot is at rest (see `Settled`); None while it may still come.

    `targets`: Pa by chamber. `others`: stamps (s) of further streams, by topic, that the window must hold samples of.
    Windows end at a tracked tip sample; of those ending there the shortest long enough counts. Raises `NotSettled`
    after the time-out.
    """
    end = t_start + rule.timeout
    tip = tracked(tip)
    ends = tip["t"][(tip["t"] < watermark) & (tip["t"] <= end)]
    off_target = ~(np.abs(pressure["measured"] - np.asarray(targets)) <= rule.band).all(axis=1)
    stamps = {"/pressure": pressure["t"], "/tip": tip["t"], **others}

    # of each end the latest begin: the window is long enough, and holds enough samples of each stream
    begins = ends - max(rule.still, rule.average)
    good = np.ones(len(ends), dtype=bool)
    for topic, times in stamps.items():
        count = max(rule.min_samples, rule.smooth) if topic == "/tip" else rule.min_samples
        last = np.searchsorted(times, ends, side="right")
        good &= last >= count
        if good.any():
            begins = np.minimum(begins, times[np.maximum(last - count, 0)])
    good &= begins >= t_start
    if good.any():
        ends, begins = ends[good], begins[good]
        good = np.ones(len(ends), dtype=bool)
        for topic, times in stamps.items():
            first, last = _bounds(times, begins, ends)
            longest = _pause(rule, topic)  # between samples, and at either end of a window
            long = np.concatenate(([0], np.cumsum(np.diff(times) > longest)))
            good &= (long[last - 1] == long[first]) & (times[first] - begins <= longest) & (ends - times[last - 1] <= longest)
        first, last = _bounds(pressure["t"], begins, ends)
        count_off = np.concatenate(([0], np.cumsum(off_target)))
        good &= count_off[last] == count_off[first]  # no sample in the window is off its target
        good &= _extent(tip, begins, ends, rule.smooth) <= rule.still_distance
    if good.any():
        first_good = int(np.argmax(good))
        t0, t1 = float(begins[first_good]), float(ends[first_good])
        return Span(t0, t1, (t0 + t1) / 2)
    if watermark > end:
        raise NotSettled(_why_not(pressure, tip, stamps, targets, rule, end))
    return None


def fixed_window(rule: Window, t_start: float, watermark: float) -> Span | None:
    """The window at a fixed time after `t_start` (s); None while it is not over."""
    t0 = t_start + rule.delay
    t1 = t0 + rule.average
    return Span(t0, t1, (t0 + t1) / 2) if t1 < watermark else None


def crossing_window(pressure: Samples, rule: Crossing, t_start: float, ramp_end: float, watermark: float) -> Span | None:
    """The window around the first crossing of the level, cut to the ramp (it ends at `ramp_end`, s); None while it may
    come.

    Raises `NotSettled` when the level was passed before `t_start` or is not crossed within the time-out.
    """
    t = pressure["t"]
    mean: Numbers = np.asarray(sum(pressure["measured"][:, chamber] for chamber in rule.chambers) / len(rule.chambers))
    over = mean >= rule.level if rule.rising else mean <= rule.level
    way = "above" if rule.rising else "below"
    if len(over) and over[0]:
        raise NotSettled(
            f"chambers {_names(rule.chambers)}: {mean[0]:.0f} Pa is already {way} the level {rule.level:.0f} Pa at "
            f"t = {t[0]:.2f} s; start looking before the ramp reaches it"
        )
    i = int(np.argmax(over)) if over.any() else -1
    if i < 0 or t[i] > t_start + rule.timeout:
        if watermark <= t_start + rule.timeout:
            return None
        finite, extreme = mean[np.isfinite(mean)], ""
        if len(finite):
            extreme = f", highest {finite.max():.0f} Pa" if rule.rising else f", lowest {finite.min():.0f} Pa"
        raise NotSettled(
            f"chambers {_names(rule.chambers)} did not get {way} {rule.level:.0f} Pa within {rule.timeout:g} s{extreme}; "
            "check supply and ramp, or raise the time-out"
        )
    share = (rule.level - mean[i - 1]) / (mean[i] - mean[i - 1])
    crossing = float(t[i - 1] + share * (t[i] - t[i - 1]))
    t0, t1 = max(t_start, crossing - rule.average / 2), crossing + rule.average / 2
    if ramp_end > crossing:
        t1 = min(t1, ramp_end)
    # The crossing itself is known from the sample after it, which the window need not hold.
    return Span(t0, t1, crossing) if max(t1, float(t[i])) < watermark else None


def _pause(rule: Settled, topic: str) -> float:
    """How long a stream may have no usable sample, s."""
    return rule.max_hidden if topic == "/tip" else rule.max_gap


def _names(chambers: Sequence[int]) -> str:
    return ", ".join(f"p{chamber + 1}" for chamber in chambers)


def _bounds(times: Numbers, begins: Numbers, ends: Numbers) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Samples first..last-1 lie in each window."""
    return np.searchsorted(times, begins), np.searchsorted(times, ends, side="right")


def _extent(tip: Samples, begins: Numbers, ends: Numbers, smooth: int) -> Numbers:
    """Peak to peak (m) of the tip's moving average in each window, the largest of the three axes."""
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(tip["position"], axis=0)))
    average = (total[smooth:] - total[:-smooth]) / smooth
    first, last = _bounds(tip["t"], begins, ends)
    last = last - smooth + 1
    # Tables of the extremes over 1, 2, 4, .. samples answer any window by two look-ups.
    # One at a time: all of them would take the memory of the samples many times over.
    highs = lows = average
    extents = np.empty(len(ends))
    level = np.floor(np.log2(last - first)).astype(int)
    for k in range(int(level.max(initial=0)) + 1):
        if k:
            half = 2 ** (k - 1)
            highs, lows = np.maximum(highs[:-half], highs[half:]), np.minimum(lows[:-half], lows[half:])
        at_level = level == k
        a, b = first[at_level], last[at_level] - 2**k
        high, low = np.maximum(highs[a], highs[b]), np.minimum(lows[a], lows[b])
        extents[at_level] = (high - low).max(axis=1)
    return extents


MOST_CHANNELS = 3
"""Channels off their set-points that a message names."""


def _why_not(
    pressure: Samples, tip: Samples, stamps: Mapping[str, Numbers], targets: Sequence[float], rule: Settled, end: float
) -> str:
    """What was not at rest in the last seconds before the time-out, by how much, against what."""
    duration = max(rule.still, rule.average)
    since = end - duration
    parts = _why_unseen(stamps, rule, since, end)
    parts += _why_off(pressure[(pressure["t"] >= since) & (pressure["t"] <= end)], targets, rule)
    late = tip[(tip["t"] >= since) & (tip["t"] <= end)]
    if len(late) >= rule.smooth:
        motion = float(_extent(late, np.array([since]), np.array([end]), rule.smooth)[0])
        if not motion <= rule.still_distance:
            parts.append(f"the tip still moved {motion * 1e3:.2f} mm in {duration:g} s, limit {rule.still_distance * 1e3:.2f} mm")
    if not parts:
        parts.append(f"all were at rest at the end, but for less than {duration:g} s: raise the time-out")
    return f"not settled within {rule.timeout:g} s: {'; '.join(parts)}"


def _why_unseen(stamps: Mapping[str, Numbers], rule: Settled, since: float, end: float) -> list[str]:
    """The streams (see `settled_window`) that paused too long from `since` to `end` (s), or have too few samples."""
    parts = []
    for topic, times in stamps.items():
        late = times[(times >= since) & (times <= end)]
        pause = float(np.diff(late, prepend=since, append=end).max())
        needed = max(rule.min_samples, rule.smooth) if topic == "/tip" else rule.min_samples
        if pause > _pause(rule, topic):
            what = "the tip was not tracked (check the cameras' view)" if topic == "/tip" else f"{topic} paused"
            parts.append(f"{what} for {pause:.2f} s, limit {_pause(rule, topic):g} s")
        elif len(times) < needed:
            parts.append(f"{len(times)} usable samples of {topic}, needed {needed}")
    return parts


def _why_off(pressure: Samples, targets: Sequence[float], rule: Settled) -> list[str]:
    """The channels that are furthest from their set-points (Pa), at their worst sample."""
    if not len(pressure):
        return []
    measured: Any = pressure["measured"]
    off = np.abs(measured - np.asarray(targets)).max(axis=0)
    wrong = [c for c in np.argsort(-off, kind="stable").tolist() if not off[c] <= rule.band]
    parts = [
        f"channel {c + 1} is {off[c] / 1e3:.1f} kPa from its set-point {targets[c] / 1e3:.1f} kPa, band {rule.band / 1e3:.1f} kPa"
        if np.isfinite(off[c])
        else f"channel {c + 1} gives no number; check the regulator and its cable"
        for c in wrong[:MOST_CHANNELS]
    ]
    return parts + ([f"{len(wrong) - MOST_CHANNELS} further channels are off"] if len(wrong) > MOST_CHANNELS else [])
