"""The single way from samples to a row of the table: `conclude`, used by the protocols while they run and by replay."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import Misplaced, NoResistance, NotSettled, TooFewSamples, VacuumLost
from ..messages import SENSORS
from ..trials import SENSOR, TrialRow
from .averaging import Average, Estimator, along_push, line, line_quaternion, mean, mean_quaternion
from .buffer import Streams
from .demands import jumped, left_band, places_of, too_far
from .rules import LARGEST, Crossing, Probe, Settled, State, Window
from .settling import Span, crossing_window, fixed_window, settled_window, tracked

Samples = NDArray[np.void]

SLOW = ("/spine", "/vacuum")
SLOW_BACK, SLOW_OLDEST = 1.0, 10.0
"""These streams are polled seldom and hardly change while a state is read: a reading whose time is fixed takes those
of the last second (s) before its end, one sample is enough; where there is none, the newest of the last ten seconds."""

AVERAGED = {
    "/pressure": ("measured",), "/spine": ("length",), "/vacuum": ("absolute",), "/force": ("raw", "zero"),
    "/arm": ("tcp_pose", "joints"),
}  # fmt: skip
"""What must be a number in every sample that is averaged; of the tip only tracked samples count."""
SEEN = {"/tip": ("position", "orientation", "markers")}
"""What may be missing (NaN), but not beyond all measure."""


def of_sensor(topic: str) -> bool:
    """Whether a topic is a sensor of the lab's own, which is read like those that are polled seldom."""
    return topic.startswith(SENSORS)


def sensor_column(topic: str, quantity: str) -> str:
    """The column of what a sensor measures."""
    return f"sensor_{topic.removeprefix(SENSORS)}_{quantity}"


def conclude(streams: Streams, state: State, count: Callable[[int], object] = lambda _: None) -> TrialRow | None:
    """Read a state: its row, or None while samples are missing that may still come. `count` gets the number of samples to be
    averaged.

    Depends on the samples up to the end of the window only: the same row whenever it is asked for, live or from a file.
    Raises `NotSettled` when the rule can no longer be met, `TooFewSamples` when its window holds too few, `VacuumLost` as
    soon as a jammed spine has lost its vacuum, `NoResistance` when it hardly pushes back, `Misplaced` when a body is where the
    robot cannot have brought it.
    """
    where = f"trial {state.trial} step {state.step}"
    watermark = min(streams.newest(topic) for topic in state.topics)
    if not watermark > state.t_start:
        return None
    try:
        span = _span(streams, state, watermark)
        _demand_vacuum(streams, state, span, watermark)
        if span is None:
            return None
        _demand_places(streams, state, span)
        return _row(streams, state, span, count)
    except NotSettled as error:
        raise type(error)(f"{where}: {error}") from error


def _span(streams: Streams, state: State, watermark: float) -> Span | None:
    """The time over which the state is averaged, by its rule; None while that may still come. Raises NotSettled."""
    rule, start = state.rule, state.t_start
    if isinstance(rule, Window):
        return fixed_window(rule, start, watermark)
    until = min(watermark, start + rule.timeout)
    pressure = streams.window("/pressure", start, until)
    chambers = pressure["measured"].shape[1]
    if isinstance(rule, Crossing):
        if max(rule.chambers) >= chambers:
            raise NotSettled(f"chamber {max(rule.chambers) + 1} is requested, but /pressure has {chambers}")
        return crossing_window(pressure, rule, start, state.ramp_end, watermark)
    if len(state.targets) != chambers:
        raise NotSettled(f"{len(state.targets)} pressures are requested, but /pressure has {chambers}")
    further = [topic for topic in state.topics if topic not in ("/pressure", "/tip") and not of_sensor(topic)]
    others = {topic: streams.window(topic, start, until)["t"] for topic in further}
    return settled_window(pressure, streams.window("/tip", start, until), others, state.targets, rule, start, watermark)


def _demand_vacuum(streams: Streams, state: State, span: Span | None, watermark: float) -> None:
    """Raise VacuumLost when the vacuum left its band before the window's end, or before `watermark` without one."""
    band = state.vacuum
    if band is None:
        return
    if span is None:
        samples = streams.window("/vacuum", band.begin(watermark), watermark)
    else:
        samples = streams.window("/vacuum", band.begin(span.t1), span.t1 + SLOW_OLDEST)
        samples = samples[: int(np.searchsorted(samples["t"], span.t1, side="right")) + 1]
    if loss := left_band(samples, state.ambient, band):
        raise VacuumLost(f"{loss}; check pump, valve and hoses")


def _demand_places(streams: Streams, state: State, span: Span) -> None:
    """Raises Misplaced when a body is, in the window, where the robot cannot have brought it."""
    bodies = state.bodies
    if bodies is None:
        return
    reason = too_far(places_of(tracked(streams.window("/tip", span.t0, span.t1))), bodies)
    if reason := reason or jumped(tracked(streams.window("/tip", bodies.begin(span.t1), span.t1))):
        raise Misplaced(
            f"{reason}; the cameras may have taken one body for another, or the base frame is not where mocap_to_base says"
        )


def _row(streams: Streams, state: State, span: Span, count: Callable[[int], object]) -> TrialRow:
    """Average every stream that the state relies on over the span."""
    rule = state.rule
    estimate: Estimator = partial(line, span.at) if isinstance(rule, Crossing) else mean
    of_sensors = tuple(filter(of_sensor, state.topics))
    slow = of_sensors if isinstance(rule, Settled) else SLOW + of_sensors
    starts = {topic: min(span.t0, span.t1 - SLOW_BACK) if topic in slow else span.t0 for topic in state.topics}
    samples = {topic: streams.window(topic, start, span.t1) for topic, start in starts.items()}
    for topic in slow:
        if topic in samples and not len(samples[topic]):
            starts[topic] = span.t1 - SLOW_OLDEST
            samples[topic] = streams.window(topic, starts[topic], span.t1)[-1:]
    if "/tip" in samples:
        samples["/tip"] = tracked(samples["/tip"])
    for topic, usable in samples.items():
        needed = 1 if topic in slow else rule.min_samples
        if len(usable) < needed:
            raise TooFewSamples(
                f"{len(usable)} usable samples of {topic} from {starts[topic]:.2f} to {span.t1:.2f} s, needed {needed}; "
                "check the instrument's rate, or average longer"
            )
        _demand_numbers(topic, usable)
    count(sum(len(usable) for usable in samples.values()))
    measured: dict[str, Average] = {}
    pressures = state.targets
    if (pressure := samples.get("/pressure")) is not None:
        of_chambers = _each(estimate, pressure, "measured")
        pressures = tuple(e.value for e in of_chambers)
        measured |= {f"p{i}": e for i, e in enumerate(of_chambers, 1)}
    tip = samples.get("/tip")
    if tip is not None:
        measured |= dict(zip("xyz", _each(estimate, tip, "position"), strict=True))
    if (spine := samples.get("/spine")) is not None:
        measured["spine_length"] = mean(spine["t"], spine["length"])
    if (vacuum := samples.get("/vacuum")) is not None:
        absolute = mean(vacuum["t"], vacuum["absolute"])
        measured["vacuum"] = Average(state.ambient - absolute.value, absolute.sd)
    if tip is not None and (arm := samples.get("/arm")) is not None:
        measured |= {f"joint{k}": e for k, e in enumerate(_each(estimate, arm, "joints"), 1)}
    for topic in of_sensors:
        for name in (samples[topic].dtype.names or ())[1:]:
            measured[sensor_column(topic, name)] = mean(samples[topic]["t"], samples[topic][name])
    if state.probe is not None:
        force, deflection = _push(estimate, state.probe, samples["/force"], samples["/arm"])
        measured |= {"force": force, "deflection": deflection}
        if state.least_force is not None and not force.value >= state.least_force:
            raise NoResistance(
                f"the force rose by {force.value:.2f} N since the first contact, expected are {state.least_force:.2f} N or more"
            )
    value = {name: e.value for name, e in measured.items()}
    asked = ("trial", "step", "protocol", "repeat", "branch", "rate", "tip_mass", "roll_deg", "specimen", "clipped")
    return TrialRow(
        **{name: getattr(state, name) for name in asked},
        t=span.at, hold=0.0 if isinstance(rule, Crossing) else max(0.0, span.at - state.ramp_end), pressures=pressures,
        spine_length=value.get("spine_length", state.spine_length), vacuum=value.get("vacuum"),
        tip=None if tip is None else (value["x"], value["y"], value["z"]),
        orientation=None if tip is None else _orientation(rule, span, tip),
        markers=() if tip is None else _markers(estimate, tip), force=value.get("force"), deflection=value.get("deflection"),
        sensors={name: v for name, v in value.items() if SENSOR.fullmatch(name)},
        sd={name: e.sd for name, e in measured.items() if e.sd == e.sd},
    )  # fmt: skip


def _demand_numbers(topic: str, samples: Samples) -> None:
    """Raise NotSettled for a sample with NaN or a value beyond all measure, which an average would hide."""
    averaged = (samples.dtype.names or ())[1:] if of_sensor(topic) else AVERAGED.get(topic, ())
    for name in (*averaged, *SEEN.get(topic, ())):
        values = np.abs(samples[name].reshape(len(samples), -1))
        bad = (values > LARGEST).any(axis=1)
        if name in averaged:
            bad |= np.isnan(values).any(axis=1)
        if bad.any():
            raise NotSettled(
                f"{topic}: {name} is not a number in {int(bad.sum())} of {len(samples)} samples, first at "
                f"{samples['t'][bad][0]:.2f} s; check the instrument and its connection"
            )


def _each(estimate: Estimator, samples: Samples, field: str) -> list[Average]:
    """One estimate for each column of an array field."""
    return [estimate(samples["t"], samples[field][:, i]) for i in range(samples[field].shape[1])]


def _orientation(rule: Settled | Window | Crossing, span: Span, tip: Samples) -> tuple[float, float, float, float]:
    turns = tip["orientation"]
    try:
        if isinstance(rule, Crossing):
            return line_quaternion(span.at, tip["t"], turns)
        return mean_quaternion(turns.tolist())
    except ValueError as error:
        raise NotSettled(f"orientation on /tip: {error}; check the body's definition in the camera software") from error


def _markers(estimate: Estimator, tip: Samples) -> tuple[Any, ...]:
    places = tip["markers"]
    return tuple(tuple(estimate(tip["t"], places[:, i, axis]).value for axis in range(3)) for i in range(places.shape[1]))


def _push(estimate: Estimator, probe: Probe, force: Samples, arm: Samples) -> tuple[Average, Average]:
    """Force on the specimen along the push (N) and the TCP's way along it from the origin (m)."""
    along = along_push(probe.direction, force["raw"] - force["zero"], arm["tcp_pose"], probe.sensor_rotation)
    pushed = estimate(force["t"], along - probe.force_offset)
    x, y, z = (arm["tcp_pose"][:, :3] - np.array(probe.origin)).T
    way = x * probe.direction[0] + y * probe.direction[1] + z * probe.direction[2]
    return pushed, estimate(arm["t"], way)
