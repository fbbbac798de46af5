"""`lab check`: connect to every instrument. With `--move`: verify that each actuator follows its commands.

Each actuator is moved a little, and other instruments verify the movement. A regulator's own reading cannot reveal a wrong range
or swapped hoses. The tip can: its direction shows the chambers, its distance the pressure, both compared with the rod model of
robot.yaml.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

import timing
from drivers.errors import InstrumentError
from drivers.frames import matrix_from_quaternion
from drivers.interfaces import BodySample, Identity
from model.arrays import Array
from model.robot import Robot
from protocols.actions import grow, home, ramp, release, vent
from protocols.bench import Bench, Setup
from protocols.errors import ProtocolError, Stopped
from protocols.parameters import Jam, SpineMotion
from recordings.states.demands import too_far

from ..console import Screen, err, out, questions, styled, titled, warn
from ..files.checked import Moved, adapters_now, keep, place
from ..files.config import ConfigError, unit_of
from ..files.rig_file import RigFile, load_rig, table_of
from ..files.units import shown
from ..guard.latch import Latch
from ..guard.messages import RigLanded
from ..options import JSON, OneOf, Result, Verb, option, rig
from ..plain import typed
from ..rig.actuators import ActuatorsLost
from ..rig.assembly import Rig, newly_lost
from ..rig.by_hand import by_hand
from ..rig.limits import bodies, unlimited
from .calibrate import NotDetermined, base_seen, lines

STEP = 5e3
"""Pa to which each channel is inflated, and never above."""
AGREE = 1e3
"""Pa by which a reading may differ from its set-point, and the other channels may move."""
REST = 2.0
"""Rig seconds in which the robot comes to rest."""
FRAMES = 200
"""Averaged frames of the tip: 0.3 mm of camera noise becomes 0.03 mm in a difference."""
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
    """Move each actuator of the rig (see `within_robot`), regulators last, until one fails; the caller lands it. The robot
    hangs free."""
    trials: list[tuple[str, object, Callable[[], str]]] = [
        ("valve", bench.valve, lambda: _valve(bench)),
        ("spine", bench.spine, lambda: _spine(bench, rig)),
        ("arm", bench.arm, lambda: _arm(bench, rig)),
    ]
    tips = _model_tips(bench, robot) if bench.pressure is not None else None
    per_pascal = () if tips is None else tuple((tips[1:] - tips[0]) / STEP)
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
    """Open and close the valve; the gauge, if there is one, must show it. Returns the observation."""
    valve = bench.need(bench.valve, "valve")
    gauge = bench.gauge
    if gauge is None:
        valve.set(True)
        valve.set(False)
        return "switched on and off by its own read-back; without a gauge the vacuum in the spine is unknown"
    ambient = release(bench, Jam())  # Pa absolute in the spine without vacuum
    valve.set(True)

    def reached() -> float | None:
        vacuum = ambient - gauge.read().absolute
        return vacuum if vacuum > VACUUM else None

    vacuum = bench.wait(f"valve: {VACUUM / 1e3:g} kPa below ambient at the gauge", reached, WITHIN)
    release(bench, Jam())
    return f"{vacuum / 1e3:.0f} kPa below ambient at the gauge when on, none when off"


def _spine(bench: Bench, rig: RigFile) -> str:
    """Home the spine, grow it by up to `SPINE_TRAVEL` and retract it, unless it may be jammed. Returns the observation."""
    unit, config = bench.need(bench.spine, "spine"), rig.instruments.spine
    if bench.valve is None or bench.gauge is None:
        return "not moved: without valve and gauge the spine may still be jammed"
    home(bench)
    assert config is not None  # it is open
    displacement = min(SPINE_TRAVEL, config.max_length)
    motion = SpineMotion(speed=min(SpineMotion().speed, config.max_speed))
    grow(bench, displacement, motion)
    grown = unit.read().length
    grow(bench, 0.0, motion)
    return f"homed, to {grown * 1e3:.1f} mm and back to {unit.read().length * 1e3:.1f} mm"


def _arm(bench: Bench, rig: RigFile) -> str:
    """Move the arm by `ARM_TRAVEL` along z, towards the middle of its workspace, and back; its own state must show it."""
    arm, state, config = bench.need(bench.arm, "arm"), bench.need(bench.arm_state, "arm"), rig.instruments.arm
    assert config is not None  # it is open
    start, low, high = state.latest().tcp_pose, config.workspace_min, config.workspace_max
    outside = [f"{a} = {x:.3f} m" for a, x, lo, hi in zip("xyz", start, low, high, strict=False) if not lo <= x <= hi]
    if outside:
        raise NotAsCommanded(f"arm: its tool is at {', '.join(outside)}, outside its workspace; move it inside by hand")
    middle = [(lo + hi) / 2 for lo, hi in zip(low, high, strict=True)]
    goal = list(start)
    goal[2] += math.copysign(ARM_TRAVEL, middle[2] - start[2])
    for target in (goal, list(start)):
        arm.move_to(target, min(ARM_SPEED, config.max_speed), min(ARM_ACCELERATION, config.max_acceleration))
        bench.wait("arm: at its target", lambda: None if arm.moving() else True, WITHIN)
        aim = target[:3]
        bench.wait(
            "arm: target confirmed by its state",
            lambda aim=aim: True if math.dist(state.latest().tcp_pose[:3], aim) < ARRIVED else None,  # type: ignore[misc]
            WITHIN,
        )
    return f"{ARM_TRAVEL * 1e3:g} mm along z and back"


# ------------------------------------------------------------------ pressure
def _model_tips(bench: Bench, robot: Robot) -> Array | None:
    """(1 + channels, 3) m, base frame: the rod model's tip at rest, and with each channel at `STEP`; None without cameras."""
    if bench.mocap is None:
        return None
    from model.prediction import Predictor

    chambers = np.arange(1, bench.chambers.count + 1)
    driven = [np.isin(chambers, group) for group in ((), *bench.chambers.channels)]
    tip = Predictor(robot)(STEP * np.array(driven, float)).tip
    return tip if np.isfinite(tip).all() else None


def calibrate(bench: Bench, rig: RigFile, robot: Robot) -> Iterator[str]:
    """Inflate each channel to `STEP`; yields what the tip shows of base, axes and chambers. Raises NotAsCommanded."""
    bench.need(bench.pressure, "pressure")
    bench.need(bench.mocap, "mocap")
    tips = _model_tips(bench, robot)
    if tips is None:
        raise NotAsCommanded("calibrate: the model of robot.yaml has no equilibrium at rest or when inflated; correct it first")
    rests, moved = [], []
    for channel, per_pascal in enumerate((tips[1:] - tips[0]) / STEP):
        bench.check_stop()
        rest, displacement = _inflated(bench, rig, per_pascal, channel)
        assert rest is not None and displacement is not None  # the cameras are there
        rests.append(rest)
        moved.append(displacement)
        vent(bench)
        yield f"channel {channel + 1}: the tip moves by {1e3 * np.linalg.norm(displacement):.2f} mm"
    to_base = getattr(rig.instruments.mocap, "mocap_to_base", None)  # drivers of packages may have none
    turn = np.eye(3) if to_base is None else matrix_from_quaternion(to_base.quaternion)
    shift = np.zeros(3) if to_base is None else np.array(to_base.position)
    try:
        seen = base_seen((np.mean(rests, axis=0) - shift) @ turn, np.array(moved) @ turn, tips[1:] - tips[0], tips[0])
    except NotDetermined as e:
        raise NotAsCommanded(f"calibrate: {e}") from e
    yield from lines(seen, bench.chambers.channels, robot.actuators.azimuths_deg)


def _channel(bench: Bench, rig: RigFile, per_pascal: tuple[Array, ...], channel: int) -> str:
    """Inflate a channel to `STEP` and vent it; `per_pascal`: (3,) m per Pa expected of the tip by each. Raises NotAsCommanded."""
    displacement = per_pascal[channel] if per_pascal else None
    _, moved = _inflated(bench, rig, displacement, channel)
    observed = "its own reading agrees, the other channels do not change"
    if displacement is None or moved is None:
        observed += "; without cameras, or without a model of these chambers, range and hoses are not checked"
    elif math.hypot(*displacement[:2]) * STEP < LEAST_VISIBLE:
        observed += "; the tip should not move sideways, so range and hoses are not checked"
    else:
        _compare(moved, displacement * STEP)
        observed += f", and the tip moved {math.hypot(*moved[:2]) * 1e3:.1f} mm in the right direction"
    vent(bench)
    return observed


def _inflated(bench: Bench, rig: RigFile, displacement: Array | None, channel: int) -> tuple[Array | None, Array | None]:
    """Inflate a channel to `STEP`; returns the tip at rest and how far it moved (3,) m, where `displacement` is expected per Pa.

    Raises NotAsCommanded."""
    vent(bench)
    bench.wait("pressure: all channels empty", lambda: True if max(abs(_pressures(bench))) < AGREE else None, WITHIN)
    bench.pause(REST)
    rest = _tip(bench) if displacement is not None else None
    at_rest = _pressures(bench)
    config = rig.instruments.pressure
    if config is not None and config.widest is not None and config.full_scale < config.widest:
        # The regulator cannot be asked for its range, and a wider one would deliver widest / full_scale of what is commanded: a
        # first step is so small that even then no more than 5 kPa come, and it is judged for coming too far alone.
        pressure = STEP * config.full_scale / config.widest
        _inflate(bench, channel, pressure, at_rest)
        if displacement is not None and rest is not None:
            _demand_size(_tip(bench) - rest, displacement * pressure, pressure)
    _inflate(bench, channel, STEP, at_rest)
    moved = None if rest is None else _tip(bench) - rest
    if displacement is not None and moved is not None:
        _demand_size(moved, displacement * STEP, STEP, LEAST_RATIO)
    return rest, moved


def _inflate(bench: Bench, channel: int, pressure: float, at_rest: Array) -> None:
    """Ramp one channel to a pressure (Pa). Raises NotAsCommanded if its reading does not reach it, or another channel moves."""
    channels = len(bench.chambers.channels)
    ramp(bench, [pressure if c == channel else 0.0 for c in range(channels)], 5e3)  # Pa/s
    bench.wait(
        f"pressure: channel {channel + 1} at {pressure / 1e3:.1f} kPa by its own reading",
        lambda: True if abs(_pressures(bench)[channel] - pressure) < AGREE else None,
        WITHIN,
    )
    bench.pause(REST)
    deviations = _pressures(bench) - np.where(np.arange(channels) == channel, pressure, at_rest)
    for other, deviation in enumerate(deviations, 1):
        if abs(deviation) > AGREE:
            raise NotAsCommanded(
                f"pressure: channel {other} changes by {deviation / 1e3:.1f} kPa when channel {channel + 1} is set to "
                f"{pressure / 1e3:.1f} kPa, limit {AGREE / 1e3:g} kPa; look for a hose that connects them"
            )


def _pressures(bench: Bench) -> Array:
    """Mean of five readings, Pa, by channel."""
    regulators = bench.need(bench.pressure, "pressure")
    return np.mean([regulators.read().measured for _ in range(5)], axis=0)  # type: ignore[no-any-return]


def _demand_size(moved: Array, expected: Array, pressure: float, least: float = 0.0) -> None:
    """Raise NotAsCommanded where the tip moved clearly farther than expected, or less than the share `least`."""
    size, should = math.hypot(*moved), math.hypot(*expected)
    more = size > MOST_RATIO * should + NOISE
    if more or (should >= LEAST_VISIBLE and size < least * should - NOISE):
        raise NotAsCommanded(
            f"pressure: at {pressure / 1e3:.1f} kPa the tip moves {size * 1e3:.1f} mm, expected {should * 1e3:.1f} mm: the "
            f"regulator delivers {'more than it reads' if more else 'less than it reads, or its hose is off'}; correct "
            "full_scale (or unit) in rig.yaml, else area_factor and youngs_modulus in robot.yaml"
        )


def _compare(moved: Array, expected: Array) -> None:
    """Raise NotAsCommanded where the tip moved in another direction than expected."""
    size, should = math.hypot(*moved[:2]), math.hypot(*expected[:2])
    angle = math.acos(max(-1.0, min(1.0, float(moved[:2] @ expected[:2]) / (size * should))))
    if angle > MOST_ANGLE:
        raise NotAsCommanded(
            f"pressure: the tip moves towards {math.degrees(math.atan2(moved[1], moved[0])):.0f} deg about the axis, "
            f"{math.degrees(math.atan2(expected[1], expected[0])):.0f} deg expected: other chambers are inflated; look for "
            "swapped hoses, ports or unit letters, or correct chambers (or mocap_to_base) in rig.yaml"
        )


def _tip(bench: Bench) -> Array:
    """Mean position of the tip over the next frames, m, base frame."""
    since = bench.clock.now()

    def mean() -> Array | None:
        seen = bench.recorder.buffers.window("/tip", since, math.inf)
        seen = seen[seen["valid"]]
        return seen["position"][-FRAMES:].mean(axis=0) if len(seen) >= FRAMES else None

    return bench.wait(f"mocap: {FRAMES} frames of the tip", mean, 60.0)


LOOK = 0.05
"""Host seconds between two polls for samples."""


def check(rig_path: Path, seconds: float, move: bool = False, yes: bool = False, calibrating: bool = False) -> Result:
    """Connect to all instruments, count samples for `seconds` of host time, report what is missing; `move`: also move the
    actuators (`yes`: without asking).

    `calibrating`: inflate the channels alone, and report base, axes and chambers, see `lab.verbs.calibrate`."""
    file = load_rig(rig_path)
    asked = ("--calibrate", PRESSURES) if calibrating else ("--move", ALL)
    robot = _may_move(file, yes, *asked) if move or calibrating else None
    if move:
        place(rig_path).unlink(missing_ok=True)  # this check takes its place, whatever it finds, also other adapters
    moved, said = list[Moved](), list[str]()
    with Rig(file, despite_latch=robot is None) as rig:
        failures = rig.open_all(lambda line: out.print(line, style="dim"))
        outcome: dict[str, Identity | InstrumentError] = {**rig.identities, **failures}
        counts_before, lost_before = dict(rig.counts), rig.lost()
        span, seen = _listen(rig, counts_before, seconds)
        rows = [_row(rig, name, outcome[name], counts_before, lost_before, span) for name in rig.names]
        still = np.array([sample.position for sample in seen if sample.valid])
        scatter = [round(1e3 * sd, 3) for sd in still.std(axis=0)] if len(still) > 1 else []
        places = np.array([[s.position, *s.markers] for s in seen[-1:]])
        if seen and (far := too_far(places, bodies(rig.file, rig.file.body))):
            rig.notices.append(
                f"mocap: {far}; check mocap_to_base, the names of the bodies, and length and markers of robot.yaml"
            )
        if robot is not None and all(r["ok"] for r in rows):
            moved, said = _moved(rig, robot, calibrate if calibrating else moves)
            if move:
                keep(rig_path, file, moved, adapters_now(file, rig.identities))
    lost = sum(r.get("lost", 0) for r in rows)
    warn(rig.notices)

    def show() -> None:
        out.print(_table(rig.file.name, rows, span))
        if scatter:
            sd = ", ".join(f"{axis} {value:.2g} mm" for axis, value in zip("xyz", scatter, strict=True))
            out.print(f"mocap: the tip at rest scatters by {sd} (sd; OptiTrack promises less than 0.5 mm)", soft_wrap=True)
        for f in failures.values():
            err.print(f"missing: {f}")
        for r in (r for r in rows if not r["ok"] and "samples" in r):
            err.print(f"silent: {r['instrument']}: {r['problem']}")
        if locked := Latch(rig_path).read():
            err.print(f"locked: {locked}. To unlock the rig: {typed('lab', 'safe', '--clear', '--rig', rig_path)}")

    data = {"rig": rig.file.name, "seconds": span, "instruments": rows, "scatter_mm": scatter, "warnings": rig.notices}
    failed = not all(r["ok"] for r in rows) or not all(m.ok for m in moved)
    data |= ({"moved": [asdict(m) for m in moved]} if robot is not None else {}) | ({"calibration": said} if calibrating else {})
    return Result(data, show, 1 if failed else (3 if lost else 0))


PRESSURES = f"inflates each channel to {STEP / 1e3:g} kPa"
ALL = f"{PRESSURES}, homes the spine and moves it by 1 cm, opens the valve and moves the arm by 5 mm"


def _may_move(file: RigFile, yes: bool, option: str, what: str) -> Robot:
    """Return the robot that may be moved. Raises ConfigError, or Stopped if the person refuses."""
    import model.rods  # noqa: F401 (with its kernels; no other check waits for it, and no rig that is open)

    robot = file.body
    if missing := unlimited(file, robot):
        raise ConfigError(*missing)
    if yes:
        return robot
    if not sys.stdin.isatty():
        need = f"no terminal on which to confirm that it {what}; add --yes, only if nobody is within reach of the robot"
        raise ConfigError(f"{option}: {need}")
    questions().print(
        f"This {what}. The robot must hang free with {robot.tip_mass * 1e3:g} g at its tip, with nobody within reach."
    )
    if input("Type yes to continue: ").strip().lower() not in ("y", "yes"):
        raise Stopped("not confirmed; nothing moved")
    return robot


def _moved(rig: Rig, robot: Robot, do: Callable[[Bench, RigFile, Robot], Iterator[Moved | str]]) -> tuple[list[Moved], list[str]]:
    """`do` something (`moves` or `calibrate`), land the rig, and print each outcome and line, the landing last; returns both."""
    outcomes, said = list[Moved](), list[str]()
    screen = Screen("check", rig.clock.speed)

    def tell(result: Moved) -> None:
        outcomes.append(result)
        out.print(f"  {result.what}: {'ok' if result.ok else 'FAILED'}: {result.text}")

    with by_hand(rig, screen, lambda r: tell(Moved("safe state", r.confirmed, str(r))), list(rig.identities)) as bench:
        try:
            if rig.file.operator != "console":  # a person at the console has just been asked
                bench.operator.prepare(Setup("robot", robot.tip_mass, 0.0, 80e3))  # Pa below ambient
            for result in do(bench, rig.file, robot):
                if isinstance(result, Moved):
                    tell(result)
                else:
                    out.print(result, soft_wrap=True)
                    said.append(result)
        except (ProtocolError, KeyboardInterrupt) as e:
            tell(Moved("check", False, str(e) or "stopped immediately by the operator"))
    return outcomes, said


def _listen(rig: Rig, before: dict[str, int], seconds: float) -> tuple[float, list[BodySample]]:
    """Collect samples for `seconds` of host time, until each instrument sent one; return the time taken and some of the tip."""
    began, seen = timing.now(), list[BodySample]()
    awaited = [topic for name in rig.identities if (topic := rig.topic(name))]
    while (span := timing.now() - began) < max(seconds, rig.file.limits.max_age):
        with suppress(InstrumentError):  # a body that is not tracked: reported when it is needed
            seen += [rig.streams["mocap"].latest()] if "mocap" in rig.identities else []
        if span >= seconds and all(rig.counts.get(topic, 0) > before.get(topic, 0) for topic in awaited):
            break
        timing.sleep(LOOK)
    return span, seen


def _row(
    rig: Rig, name: str, result: Identity | InstrumentError, before: dict[str, int], lost_before: dict[str, int], span: float
) -> dict[str, Any]:
    """One instrument for JSON: identity, limits, and samples and losses since the previous counts, in `span` host s."""
    if isinstance(result, InstrumentError):
        return {"instrument": name, "ok": False, "problem": result.message}
    row: dict[str, Any] = {"instrument": name, "ok": True, **asdict(result)}
    topic = rig.topic(name)
    if topic:
        row["samples"] = rig.counts.get(topic, 0) - before.get(topic, 0)
        row["rate_hz"] = round(row["samples"] / span, 1) if span > 0 else None
    if topic in lost_before:
        row["lost"] = newly_lost(lost_before[topic], rig.lost()[topic])
        if row["samples"] == 0:
            row |= {
                "ok": False,
                "problem": f"opened, and no sample in {span:.1f} s; " + timing.busy_or("check its cable, and that it sends"),
            }
    config = table_of(rig.file.instruments, name)
    row["limits"] = {k: v for k, v in config.model_dump(mode="json").items() if k.startswith("max_")}
    row["units"] = {k: unit_of(type(config).model_fields[k]) or "" for k in row["limits"]}
    return row


def _table(title: str, rows: list[dict[str, Any]], span: float) -> Table:
    """The rows of `_row` as a table for the screen."""
    table = titled(f"{title}: instruments, counted over {span:.1f} s", ("instrument", "identity", "rate", "lost", "limits"))
    for r in rows:
        if not r["ok"]:
            table.add_row(r["instrument"], styled("missing" if "samples" not in r else "silent", "red"), "", "", "")
            continue
        identity = " ".join(x for x in (r["maker"], r["model"], r["serial"], r["firmware"]) if x)
        rate = f"{r['rate_hz']:g} Hz" if r.get("rate_hz") is not None else ""
        limits = ", ".join(
            f"{k.removeprefix('max_')} {' or '.join(shown(x, r['units'][k]) for x in dict.fromkeys(np.ravel(v).tolist()))}"
            for k, v in r["limits"].items()
            if isinstance(v, (int, float)) or k == "max_pressure"
        )
        table.add_row(r["instrument"], identity, rate, str(r.get("lost", "")), limits)
    return table


VERBS = (
    Verb(
        "check",
        lambda a: check(a.rig, a.seconds, a.move, a.yes, a.calibrate),
        options=(
            JSON,
            rig(),
            OneOf(
                option("--move", action="store_true", help="move each actuator a little and compare with rig.yaml"),
                option("--calibrate", action="store_true", help="inflate each channel a little; prints azimuths, base and axes"),
            ),
            option("--yes", action="store_true", help="with these: skip the confirmation; only if nobody is within reach"),
            option("--seconds", type=float, default=2.0, help="host seconds over which rates and losses are counted"),
        ),
        examples=("lab check --rig rig/rig.yaml", "lab check --rig rig/rig.yaml --move"),
        page="docs/tutorials/your-rig.md",
    ),
)
