"""What every experiment does; each is confirmed by a reading before it returns."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import fmean

from drivers.pressure_limits import LONGEST_CREDIT, VENTED
from recordings.ambient import AMBIENT
from recordings.states.demands import VacuumBand, left_band

from .bench import Bench, Jammed
from .errors import JamLost
from .parameters import Jam, SpineMotion

LOWEST_AMBIENT = 80e3
"""Pa absolute; a spine below this is still evacuated."""
CLIPPED = 1e3
"""Pa between asked and set that are more than an instrument's rounding."""
VACUUM_NOISE = 3e3
"""Pa by which one reading of a gauge may be off: six times a noise of 0.5 % of the reading, at ambient pressure."""
REST_READINGS = 6
"""A gauge is judged to rest from at least this many readings."""


def vent(bench: Bench, within: float = 20.0) -> None:
    """Vent all chambers."""
    regulators = bench.need(bench.pressure, "pressure")
    regulators.vent()
    bench.wait(
        f"pressure: all chambers below {VENTED / 1e3:g} kPa",
        lambda: True if max(regulators.read().measured) < VENTED else None,
        within,
    )


def home(bench: Bench, within: float = 120.0) -> None:
    """Find the spine's zero when it is not known."""
    unit = bench.spine
    if unit is None or unit.read().homed:
        return
    release(bench, Jam())
    bench.say("Homing the spine")
    unit.home()
    bench.wait("spine: homed", lambda: True if unit.read().homed else None, within)


def release(bench: Bench, jam: Jam) -> float:
    """Un-jam the spine and wait until the gauge rests, at least six readings; returns ambient pressure, Pa absolute."""
    valve, gauge = bench.need(bench.valve, "valve"), bench.need(bench.gauge, "gauge")
    bench.jammed = None
    valve.set(False)
    readings: list[tuple[float, float]] = []

    def recently() -> list[tuple[float, float]]:  # those of the last `jam.rest` s, at least REST_READINGS
        first = next(i for i, (t, _) in enumerate(readings) if t >= readings[-1][0] - jam.rest)
        return readings[max(0, min(first, len(readings) - REST_READINGS)) :]

    def at_rest() -> float | None:
        readings.append((bench.clock.now(), gauge.read().absolute))
        recent = [p for _, p in recently()]
        if readings[-1][0] - readings[0][0] < jam.rest or len(recent) < REST_READINGS:
            return None
        half = len(recent) // 2
        drift = fmean(recent[half:]) - fmean(recent[:half])
        return fmean(recent) if abs(drift) < jam.released_below / 5 and min(recent) > LOWEST_AMBIENT else None

    def describe() -> str:
        times, recent = zip(*recently(), strict=True)
        variation, lowest = max(recent) - min(recent), min(recent)
        return (
            f"the gauge still varied by {variation / 1e3:.2f} kPa in {times[-1] - times[0]:.3g} s (its drift must be below "
            f"{jam.released_below / 5e3:.2f} kPa) and read {lowest / 1e3:.1f} kPa absolute (must be above "
            f"{LOWEST_AMBIENT / 1e3:.1f} kPa)"
        )

    return bench.wait("valve and gauge: vacuum released", at_rest, jam.within, describe)


def jam(bench: Bench, ambient: float, vacuum: float, rules: Jam) -> float:
    """Jam the spine; returns the vacuum reached, Pa below ambient. States read from then on need a vacuum between `rules.share`
    and 2 - `rules.share` of `vacuum`, with `VACUUM_NOISE` on either side."""
    bench.jammed = None
    valve, gauge = bench.need(bench.valve, "valve"), bench.need(bench.gauge, "gauge")
    if vacuum <= 0:
        return 0.0
    valve.set(True)

    def jammed() -> float | None:
        reached = ambient - gauge.read().absolute
        return reached if reached >= rules.share * vacuum else None

    goal = rules.share * vacuum / 1e3
    reached = bench.wait(
        f"valve and gauge: spine jammed at {goal:.0f} kPa below ambient", jammed, rules.within,
        lambda: f"the gauge is {(ambient - gauge.read().absolute) / 1e3:.1f} kPa below ambient",
    )  # fmt: skip
    lowest, highest = rules.share * vacuum - VACUUM_NOISE, (2 - rules.share) * vacuum + VACUUM_NOISE
    bench.jammed = Jammed(ambient, VacuumBand(bench.clock.now(), lowest, highest))
    return reached


def grow(bench: Bench, length: float, motion: SpineMotion) -> None:
    """Bring the spine to a length, m; it must not be jammed."""
    unit = bench.need(bench.spine, "spine")
    start = unit.read().length
    goal = unit.move_to(length, motion.speed)
    if abs(goal - length) > motion.tolerance:
        bench.say(f"Spine goal {length * 1e3:.0f} mm was clipped to {goal * 1e3:.0f} mm by the unit's limit")
    bench.wait(
        f"spine: at {goal * 1e3:.0f} mm",
        lambda: True if (s := unit.read()) and not s.moving and abs(s.length - goal) <= motion.tolerance else None,
        5.0 + 3.0 * abs(goal - start) / motion.speed,  # s: three times what the way takes
        lambda: (
            f"{'still moving, ' if (s := unit.read()).moving else ''}{abs(s.length - goal) * 1e3:.1f} mm from its goal, "
            f"tolerance {motion.tolerance * 1e3:.1f} mm"
        ),
    )
    bench.pause(motion.settle)


def set_spine(bench: Bench, length: float, vacuum: float, motion: SpineMotion, rules: Jam) -> float:
    """Vent, un-jam, grow to `length` and jam at `vacuum`; returns ambient pressure, Pa absolute."""
    if bench.pressure is not None:
        vent(bench)
    if bench.spine is None and length == 0:
        return AMBIENT
    ambient = release(bench, rules)
    grow(bench, length, motion)
    jam(bench, ambient, vacuum, rules)
    return ambient


def keep_jammed(bench: Bench, jam: Callable[[], object]) -> None:
    """After a pause, jam a soft spine again by `jam`, and raise JamLost."""
    if jam_lost(bench):
        jam()
        raise JamLost("the spine was jammed anew")


def jam_lost(bench: Bench) -> bool:
    """Whether the spine was soft at any time since it was jammed."""
    jammed = bench.jammed
    if jammed is None or jammed.soft:
        return jammed is not None
    since = jammed.vacuum.begin(bench.clock.now())
    reason = left_band(bench.recorder.buffers.window("/vacuum", since, math.inf), jammed.ambient, jammed.vacuum)
    if since > jammed.vacuum.since:  # a long pause: readings from before `since` are gone
        reason = reason or f"whether it kept its vacuum is known since {since:.0f} s only"
    if not reason:
        return False
    bench.say(f"The spine must be jammed anew: {reason}")
    return True


def play(bench: Bench, function: Callable[[float], Sequence[float]], seconds: float) -> Sequence[float]:
    """Play a waveform: set all channels to `function(t)` (Pa) ten times a second, from t = 0 to `seconds` s of rig time.

    Returns the last set-points as confirmed, and sets `bench.clipped` if limits clipped one."""
    bench.clipped = False
    regulators = bench.need(bench.pressure, "pressure")
    t, now = 0.0, bench.clock.now()
    while True:
        previous, now = now, bench.clock.now()
        t = min(seconds, t + min(now - previous, LONGEST_CREDIT))  # after a standstill of this computer nothing jumps
        wanted = function(t)
        confirmed = regulators.set(wanted)
        bench.clipped |= max(abs(c - w) for c, w in zip(confirmed, wanted, strict=True)) > CLIPPED
        if t >= seconds:
            return confirmed
        bench.pause(0.1)  # rig seconds between two set-points


def ramp(bench: Bench, target: Sequence[float], rate: float) -> float:
    """Ramp all channels (Pa) to `target` at `rate` Pa/s; returns the rig time of arrival.

    Sets `bench.clipped` if limits clipped a set-point. Raises NotReached when the regulators hold other set-points in the end.
    """
    regulators = bench.need(bench.pressure, "pressure")
    start = regulators.read().setpoint
    duration = max((abs(b - a) for a, b in zip(start, target, strict=True)), default=0.0) / rate

    def on_the_way(t: float) -> list[float]:
        share = t / duration if t < duration else 1.0
        return [a + share * (b - a) for a, b in zip(start, target, strict=True)]

    def held(confirmed: Sequence[float]) -> float | None:
        """The time at which the regulators have confirmed the target."""
        return bench.clock.now() if max(abs(c - t) for c, t in zip(confirmed, target, strict=True)) < CLIPPED else None

    if (arrived := held(play(bench, on_the_way, duration))) is not None:
        return arrived
    return bench.wait("pressure: set-points confirmed", lambda: held(regulators.set(target)), 30.0)
