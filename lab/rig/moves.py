"""`lab check --move`: each actuator is moved a little, and other instruments show whether it did what was commanded.

A regulator's own reading cannot show that its range or its hoses differ from rig.yaml. The tip can: its direction shows the
chambers, its distance the pressure, both compared with the rod model of robot.yaml.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InstrumentError
from model.condition import conditions
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from protocols.actions import grow, home, ramp, release, vent
from protocols.bench import Bench
from protocols.errors import ProtocolError, Stopped
from protocols.parameters import Jam, SpineMotion

from ..files.checked import Moved
from ..files.rig_file import RigFile
from ..guard.messages import RigLanded
from .actuators import ActuatorsLost

Array = NDArray[np.float64]

STEP = 5e3
"""Pa to which each channel is inflated; no more is ever asked for."""
AGREE = 1e3
"""Pa by which a reading may differ from its set-point, and the other channels may move."""
REST = 2.0
"""Rig seconds in which the robot comes to rest."""
FRAMES = 200
"""Of the tip that are averaged: 0.3 mm of camera noise becomes 0.03 mm in a difference."""
LEAST_VISIBLE = 0.3e-3
"""m; smaller expected displacements are not evaluated."""
LEAST_RATIO, MOST_RATIO, NOISE = 0.7, 1.45, 0.1e-3
"""Least and largest ratio of measured to expected displacement, and m of camera noise. The ranges of ITVs are further
apart (100, 500, 900 kPa)."""
MOST_ANGLE = math.radians(25)
"""Largest angle between measured and expected direction; the next of nine chambers is 40 deg off."""
SPINE_TRAVEL, ARM_TRAVEL = 10e-3, 5e-3
"""m that spine and arm are moved."""
ARM_SPEED, ARM_ACCELERATION, ARRIVED = 0.01, 0.1, 1e-3
"""m/s, m/s^2, and m by which the arm's own state may differ from where it was sent."""
VACUUM = 10e3
"""Pa below ambient that the gauge must show when the valve opens."""
WITHIN = 30.0
"""Rig seconds for each wait."""


def moves(bench: Bench, rig: RigFile, robot: Robot) -> Iterator[Moved]:
    """Try what the rig has, the air last, and end with the first that fails; the caller lands the rig.

    The robot hangs free; `rig` as `limits.within_robot` gives it.
    """
    trials: list[tuple[str, object, Callable[[], str]]] = [
        ("valve", bench.valve, lambda: _valve(bench)),
        ("spine", bench.spine, lambda: _spine(bench, rig)),
        ("arm", bench.arm, lambda: _arm(bench, rig)),
    ]
    per_pascal = _expected(bench, robot) if bench.pressure is not None else ()
    for channel, group in enumerate(bench.chambers.channels):
        name = f"pressure channel {channel + 1} (chambers {', '.join(map(str, group))})"
        trials.append((name, bench.pressure, lambda c=channel: _channel(bench, rig, per_pascal, c)))  # type: ignore[misc]
    for name, instrument, trial in trials:
        if instrument is None:
            continue
        try:
            bench.check_stop()
            yield Moved(name, True, trial())
        except Stopped:
            raise
        except (InstrumentError, ProtocolError, ActuatorsLost, RigLanded) as e:
            yield Moved(name, False, str(e))
            return


class NotAsCommanded(ProtocolError):
    """An actuator moved, but not as commanded."""


def _valve(bench: Bench) -> str:
    valve = bench.need(bench.valve, "valve")
    gauge = bench.gauge
    if gauge is None:
        valve.set(True)
        valve.set(False)
        return "switched on and off, according to its own read-back; without a gauge the vacuum in the spine is unknown"
    ambient = release(bench, Jam())
    valve.set(True)

    def reached() -> float | None:
        vacuum = ambient - gauge.read().absolute
        return vacuum if vacuum > VACUUM else None

    vacuum = bench.wait(f"valve: {VACUUM / 1e3:g} kPa below ambient at the gauge", reached, WITHIN)
    release(bench, Jam())
    return f"{vacuum / 1e3:.0f} kPa below ambient at the gauge when on, none when off"


def _spine(bench: Bench, rig: RigFile) -> str:
    unit, config = bench.need(bench.spine, "spine"), rig.instruments.spine
    if bench.valve is None or bench.gauge is None:
        return "not moved: without valve and gauge the spine may still be jammed"
    home(bench)
    most = config.max_length if config is not None else SPINE_TRAVEL
    displacement = min(SPINE_TRAVEL, most)
    motion = SpineMotion(speed=min(SpineMotion().speed, config.max_speed if config is not None else math.inf))
    grow(bench, displacement, motion)
    there = unit.read().length
    grow(bench, 0.0, motion)
    return f"homed, to {there * 1e3:.1f} mm and back to {unit.read().length * 1e3:.1f} mm"


def _arm(bench: Bench, rig: RigFile) -> str:
    arm, state, config = bench.need(bench.arm, "arm"), bench.need(bench.arm_state, "arm"), rig.instruments.arm
    start = state.latest().tcp_pose
    low, high = (config.workspace_min, config.workspace_max) if config is not None else ((-9.0,) * 3, (9.0,) * 3)
    outside = [f"{a} = {x:.3f} m" for a, x, lo, hi in zip("xyz", start, low, high, strict=False) if not lo <= x <= hi]
    if outside:
        raise NotAsCommanded(f"arm: its tool is at {', '.join(outside)}, outside its workspace; move it inside by hand")
    middle = [(lo + hi) / 2 for lo, hi in zip(low, high, strict=True)]
    goal = list(start)
    goal[2] += math.copysign(ARM_TRAVEL, middle[2] - start[2])
    speed, acceleration = ARM_SPEED, ARM_ACCELERATION
    if config is not None:
        speed, acceleration = min(speed, config.max_speed), min(acceleration, config.max_acceleration)
    for target in (goal, list(start)):
        arm.move_to(target, speed, acceleration)
        bench.wait("arm: at its target", lambda: None if arm.moving() else True, WITHIN)
        aim = target[:3]
        bench.wait(
            "arm: target confirmed by its state",
            lambda aim=aim: True if math.dist(state.latest().tcp_pose[:3], aim) < ARRIVED else None,  # type: ignore[misc]
            WITHIN,
        )
    return f"{ARM_TRAVEL * 1e3:g} mm along z and back"


# ------------------------------------------------------------------ pressure
def _expected(bench: Bench, robot: Robot) -> tuple[Array, ...]:
    """Displacement of the tip by each channel, (3,) m per Pa in the base frame, by the rod at no spine; none without cameras."""
    if bench.mocap is None:
        return ()
    pressures = np.zeros((1 + len(bench.chambers.channels), bench.chambers.count))
    for row, group in enumerate(bench.chambers.channels, 1):
        pressures[row, [c - 1 for c in group]] = STEP
    n = len(pressures)
    states = conditions(robot, np.zeros(n), pressures, np.full(n, robot.tip_mass), np.zeros(n))
    tips = solve(rods_of(robot, states), FINE)
    if not tips.converged.all():
        return ()
    return tuple((tip - tips.tip[0]) / STEP for tip in tips.tip[1:])


def _channel(bench: Bench, rig: RigFile, per_pascal: tuple[Array, ...], channel: int) -> str:
    """One channel, from empty to 5 kPa and back; what was seen, for the report. Raises NotAsCommanded."""
    vent(bench)
    bench.wait("pressure: all channels empty", lambda: True if max(abs(_pressures(bench))) < AGREE else None, WITHIN)
    bench.pause(REST)
    displacement = per_pascal[channel] if per_pascal else None
    rest = _tip(bench) if displacement is not None else None
    before = _pressures(bench)
    config = rig.instruments.pressure
    if config is not None and config.widest is not None and config.full_scale < config.widest:
        # The regulator cannot be asked for its range, and a wider one would deliver widest / full_scale of what is commanded: a
        # first step is so small that even then no more than 5 kPa come, and it is judged for coming too far alone.
        pressure = STEP * config.full_scale / config.widest
        _inflate(bench, channel, pressure, before)
        if displacement is not None and rest is not None:
            _compare(_tip(bench) - rest, displacement * pressure, pressure, least=None)
    _inflate(bench, channel, STEP, before)
    observed = "its own reading agrees, the other channels do not change"
    if displacement is None or rest is None:
        observed += "; without cameras, or without a model of these chambers, range and hoses are not checked"
    elif math.hypot(*displacement[:2]) * STEP < LEAST_VISIBLE:
        observed += "; the tip should not move sideways, so range and hoses are not checked"
    else:
        moved = _tip(bench) - rest
        _compare(moved, displacement * STEP, STEP, LEAST_RATIO)
        observed += f", and the tip moved {math.hypot(*moved[:2]) * 1e3:.1f} mm in the right direction"
    vent(bench)
    return observed


def _inflate(bench: Bench, channel: int, pressure: float, before: Array) -> None:
    """Ramp one channel to a pressure (Pa); NotAsCommanded when its reading does not get there, or another moves."""
    channels = len(bench.chambers.channels)
    ramp(bench, [pressure if c == channel else 0.0 for c in range(channels)], 5e3)  # Pa/s
    wanted = before * 0.0
    wanted[channel] = pressure
    bench.wait(
        f"pressure: channel {channel + 1} at {pressure / 1e3:.1f} kPa by its own reading",
        lambda: True if abs(_pressures(bench)[channel] - pressure) < AGREE else None,
        WITHIN,
    )
    bench.pause(REST)
    off = _pressures(bench) - np.where(np.arange(channels) == channel, 0.0, before) - wanted
    for other, by in enumerate(off, 1):
        if abs(by) > AGREE:
            raise NotAsCommanded(
                f"pressure: channel {other} changes by {by / 1e3:.1f} kPa when channel {channel + 1} is set to "
                f"{pressure / 1e3:.1f} kPa, limit {AGREE / 1e3:g} kPa; look for a hose that connects them"
            )


def _pressures(bench: Bench) -> Array:
    """Mean of five readings, Pa, by channel."""
    regulators = bench.need(bench.pressure, "pressure")
    return np.mean([regulators.read().measured for _ in range(5)], axis=0)  # type: ignore[no-any-return]


def _compare(moved: Array, expected: Array, pressure: float, least: float | None) -> None:
    """Raise NotAsCommanded for a tip (m) that went elsewhere than the model's, beyond it, or by less than `least` of it."""
    size, should = math.hypot(*moved[:2]), math.hypot(*expected[:2])
    if size > MOST_RATIO * should + NOISE:
        raise NotAsCommanded(
            f"pressure: at {pressure / 1e3:.1f} kPa the tip moves {size * 1e3:.1f} mm, expected {should * 1e3:.1f} mm: the "
            "regulator delivers more than it reads; correct full_scale (or unit) in rig.yaml, else area_factor and "
            "youngs_modulus in robot.yaml"
        )
    if should < LEAST_VISIBLE or least is None:
        return
    if size < least * should - NOISE:
        raise NotAsCommanded(
            f"pressure: at {pressure / 1e3:.1f} kPa the tip moves {size * 1e3:.1f} mm, expected {should * 1e3:.1f} mm: the "
            "regulator delivers less than it reads, or its hose is off; correct full_scale (or unit) in rig.yaml, else "
            "area_factor and youngs_modulus in robot.yaml"
        )
    angle = math.acos(max(-1.0, min(1.0, float(moved[:2] @ expected[:2]) / (size * should))))
    if angle > MOST_ANGLE:
        raise NotAsCommanded(
            f"pressure: the tip moves towards {math.degrees(math.atan2(moved[1], moved[0])):.0f} deg about the axis, "
            f"{math.degrees(math.atan2(expected[1], expected[0])):.0f} deg expected: other chambers are inflated; look for "
            "swapped hoses, ports or unit letters, or correct chambers (or mocap_to_base) in rig.yaml"
        )


def _tip(bench: Bench) -> Array:
    """Mean place of the tip from now on, m, base frame."""
    since = bench.clock.now()

    def mean() -> Array | None:
        seen = bench.recorder.buffers.window("/tip", since, math.inf)
        seen = seen[seen["valid"]]
        return seen["position"][-FRAMES:].mean(axis=0) if len(seen) >= FRAMES else None

    return bench.wait(f"mocap: {FRAMES} frames of the tip", mean, 60.0)
