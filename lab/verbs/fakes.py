"""`lab fakes`: start the fake instruments and print the rig.yaml that reaches them."""

from __future__ import annotations

import argparse
import functools
import math
import re
import signal
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from rich.table import Column

from model.errors import unit_text
from model.robot import Robot
from recordings.messages import NAME
from recordings.numbers import number
from recordings.own_files import copied
from sim_fakes.alicat import UNITS
from sim_fakes.instrument import Fake, FakeRegulators, faults
from sim_fakes.registry import GROUP, OWN, of_role
from sim_fakes.rig import USUAL, FakeRig
from sim_fakes.virtual_robot import RobotTruth, list_effects

from ..console import err, note, out, titled
from ..files.config import ConfigError, in_si, in_units, load, read_yaml
from ..files.packages import Registered, installed, without
from ..files.rig_file import RigFile, drivers, found_drivers
from ..files.robot_file import paper_robot
from ..options import Option, Result, Verb, option, path_option, repeatable
from ..rig.real_time import process_of

PATIENT: dict[str, Any] = {
    "instruments": {
        "arm": {"max_age": 5.0, "timeout": 3.0, "watchdog_frequency": 2.0},
        "force": {"max_age": 5.0, "timeout": 1.0},
        "mocap": {"max_age": 5.0},
        "pressure": {"timeout": 1.0},
        "spine": {"timeout": 0.5},
        "valve": {"timeout": 1.0},
        "gauge": {"timeout": 1.0},
    },
    "limits": {"max_age": 8.0, "max_hidden": 8.0, "pressure_error_time": 60.0},
    "safe": {"heartbeat": 10.0},
}
"""Ages and time-outs (host s) for fakes, which share the processors and may be late; a rig.yaml for hardware keeps the
defaults. `pressure_error_time` is rig time: at clock speed 20 the default of 5 s passes in 0.25 s of real time."""

PATIENT_PAUSES = ("settle.max_hidden=5 s", "settle.max_gap=10 s", "settle.within=300 s")
"""The same for the protocols' settling rule, in rig time: at clock speed 20, 0.5 s are 25 ms of a busy computer."""
PATIENT_SETTLE = ("settle.still_distance=5 mm", *PATIENT_PAUSES)
"""The same, and how still the tip must be."""


def serve(a: argparse.Namespace) -> Result:
    """Run fakes until Ctrl-C, and write or print the rig.yaml that reaches them; with --list-effects only list effects."""
    if a.list_effects:
        title = "Effects of the virtual robot, for --effect ID[=SIZE]"
        rows = ((e.id, f"{e.scale:.4g}{unit_text(e.unit)}", e.physics) for e in list_effects())
        out.print(titled(title, (Column("effect", no_wrap=True), "plausible size", "what it is"), rows))
        return Result()
    demand_speed(a.speed)
    _demand_free(a.rig)
    if err.is_terminal:
        err.print("Starting the fakes; compiling their physics takes up to a minute on a busy computer ..")
    rig = _rig(a)
    ended = threading.Event()
    for caught in (signal.SIGINT, signal.SIGTERM):
        signal.signal(caught, lambda *_: ended.set())
    with rig:
        unlike = beyond(rig, effects(a.effect), a.robot)
        if a.rig is not None:
            _demand_free(a.rig)
            write_rig(rig, a.rig, robot=a.robot)
            out.print(f"{a.rig} reaches the fakes; Ctrl-C stops them\n{unlike}", soft_wrap=True)
        else:
            out.print(f"{rig_yaml(rig, str(a.robot or paper_robot()))}# {unlike}", soft_wrap=True)
        ended.wait()
    return Result()


def beyond(rig: FakeRig, effects: Mapping[str, float], robot: Path | None) -> str:
    """State which effects the fakes have beyond the model of robot.yaml, and what of it they do not simulate."""
    has = [f"{e.id} = {effects[e.id]:.4g}{unit_text(e.unit)}" for e in list_effects() if e.id in effects]
    if "arm" in rig.parts and rig.truth.arm_errors:
        has.append(f"errors of the arm's build (--arm-errors {rig.truth.arm_errors:g})")
    stated = load(robot or paper_robot(), Robot)
    lacks = [name for name in UNPLAYED if getattr(stated, name) != Robot.model_fields[name].default]
    return f"Beyond the model of robot.yaml: {', '.join(has) or 'no effect'}{'; not simulated: ' * bool(lacks)}{', '.join(lacks)}"


UNPLAYED = ("effects", "tolerances", "tip_moment", "residual")
"""Keys of robot.yaml that the fakes do not simulate."""


def demand_speed(speed: float) -> None:
    """Raise ConfigError for a clock speed that rig.yaml cannot state."""
    if not 0.1 <= speed <= 200:
        raise ConfigError(f"--speed {speed:g}: must be 0.1 to 200, times real time")


def _demand_free(rig: Path | None) -> None:
    """Raises ConfigError when other fakes serve this rig.yaml."""
    if rig is None:
        return
    try:
        spec = read_yaml(rig).table["operator"]
    except (OSError, ConfigError, LookupError):
        return
    if process := process_of(str(spec)):
        raise ConfigError(
            f"{rig}: the fakes of process {process} serve it; stop them (kill {process}, or Ctrl-C in their terminal), or "
            "give another file with --rig"
        )


@functools.cache
def found_fakes() -> Registered[Fake]:
    """All fakes by the name of their driver: the project's own and those of installed packages."""
    return installed(GROUP, OWN, without(faults))


def _asked(option: str, role: str, driver: str) -> str:
    """Return the driver named by an option if it has a fake for this key of rig.yaml. Raises ConfigError."""
    for what, offers in (("fake", found_fakes()), ("driver", found_drivers())):
        if driver in offers.broken and driver not in OWN:  # ours are played where their libraries are not installed too
            raise ConfigError(f"{option}: its {what} cannot be used: {offers.broken[driver]}")
        if driver in offers.doubts:
            note([offers.doubts[driver]])
    playable = of_role(role, found_fakes().usable)
    if driver not in playable:
        raise ConfigError(
            f"{option}: must be one of {', '.join(playable)}" if playable else f"{option}: no fake for {role} is installed"
        )
    if driver in OWN:
        return driver
    if driver not in drivers():
        raise ConfigError(
            f"{option}: a fake {driver} exists, but no driver of this name; register it in the entry-point group softlab.drivers"
        )
    if drivers()[driver].role != role:
        raise ConfigError(f"{option}: its fake is for {role}, its driver for {drivers()[driver].role}; make them agree")
    return driver


def _rig(a: argparse.Namespace) -> FakeRig:
    """Return the fakes for the options. Raises ConfigError."""
    other_drivers = {role: getattr(a, role) for role in ("arm", "force", "valve", "gauge", "mocap")}
    for name, role, driver in (("regulators", "pressure", a.regulators), ("spine", "spine", a.spine),
                               *((role, role, driver) for role, driver in other_drivers.items())):  # fmt: skip
        _asked(f"--{name} {driver}", role, driver)
    sensors = {}
    for setting in a.sensor:
        name, equals, driver = setting.partition("=")
        if not equals or not NAME.fullmatch(name):
            raise ConfigError(f"--sensor {setting}: must be NAME=DRIVER; small letters, digits and _ in the name")
        sensors[name] = _asked(f"--sensor {setting}", "sensor", driver)
    robot = None if a.robot is None else load(a.robot, Robot)
    truth = RobotTruth() if robot is None else played(robot)
    if not 0 <= a.arm_errors <= 10:
        raise ConfigError(f"--arm-errors {a.arm_errors:g}: must be 0 to 10")
    how = regulators(a)
    without = left_out(a.without, robot)
    try:
        return FakeRig(
            truth=truth.model_copy(update={"arm_errors": a.arm_errors}),
            speed=a.speed,
            effects=effects(a.effect),
            seed=a.seed,
            regulators=how,
            spine=a.spine,
            others=other_drivers,
            without=without,
            sensors=sensors,
            known=found_fakes().usable,
        )
    except ValueError as e:
        if a.swap is None:
            raise
        raise ConfigError(f"--swap {a.swap}: {e}; name two of the rig's channels, such as 2,3") from e


def left_out(roles: str | None, robot: Robot | None) -> set[str]:
    """Instruments that are not played: the spine's for a robot without one, and `roles`, KEY[,KEY..]; raises ConfigError.

    Arm and force sensor push on a spine; so unless `roles` is given (perhaps as ""), a robot without one has none, except where
    its robot.yaml states the error of a stand."""
    spineless = robot is not None and robot.spine is None
    if roles is None:
        pushed = robot is not None and robot.uncertainty.push_place is not None
        return {"spine", *(() if pushed else ("arm", "force"))} if spineless else set()
    named = {role.strip() for role in roles.split(",") if role.strip()}
    if wrong := named - {*USUAL, "pressure"}:
        raise ConfigError(f"--without {min(wrong)}: is no instrument; give some of {', '.join(USUAL)}")
    return named | ({"spine"} if spineless else set())


def played(robot: Robot) -> RobotTruth:
    """Return the virtual robot with geometry and material of a robot.yaml. Raises ConfigError if the fakes cannot simulate it."""
    factor, unlike = robot.area_factor, [name for name in ("sections", "tendons") if getattr(robot, name)]
    unlike += ["chambers.ends"] * bool(robot.chambers and robot.chambers.ends)
    unlike += ["markers beside the axis"] * bool(robot.marker_places()[:, :2].any())
    if robot.chambers is None or unlike:
        raise ConfigError(f"{robot.name}: cannot be simulated: the fakes do not support {', '.join(unlike)}")
    same = ("length", "outer_radius", "inner_radius", "density", "youngs_modulus", "gravity", "markers", "max_pressure",
            "bending_stiffness", "axial_stiffness", "torsional_stiffness", "mass_per_length")  # fmt: skip
    values: dict[str, Any] = {name: getattr(robot, name) for name in same} | {
        "thrust_on_walls": robot.thrust == "walls",
        "shear_ratio": robot.shear_modulus / robot.youngs_modulus,
        "chamber_radius": robot.chambers.radius,
        "chamber_path_radius": robot.chambers.path_radius,
        "chamber_azimuths_deg": robot.chambers.azimuths_deg,
        "area_factor": factor[min(factor)] if isinstance(factor, Mapping) else factor,
    }
    if robot.spine is not None:
        values |= {"spine_radius": robot.spine.radius}
        if len(robot.spine.modulus) > 1:
            values |= {"spine_modulus": dict(robot.spine.modulus)}
    try:
        return RobotTruth(**values)
    except ValidationError as e:
        wrong = [f"robot.yaml: {'.'.join(map(str, f['loc']))}: cannot be simulated: {f['msg']}" for f in e.errors()]
        raise ConfigError(*(w.replace("shear_ratio", "shear_modulus over youngs_modulus") for w in wrong)) from e


def regulators(a: argparse.Namespace) -> FakeRegulators:
    """Return the fake regulators for the options. Raises ConfigError."""
    full_scale = in_si("--full-scale", a.full_scale, "Pa") if a.full_scale else None
    swapped = re.fullmatch(r"\s*([0-9]{1,3})\s*,\s*([0-9]{1,3})\s*", a.swap or "")
    if a.swap and swapped is None:
        raise ConfigError(f"--swap {a.swap}: name two channels, such as 2,3")
    if a.unit not in UNITS:
        raise ConfigError(f"--unit {a.unit}: must be one of {', '.join(UNITS)}")
    pair = None if swapped is None else (int(swapped[1]), int(swapped[2]))
    return FakeRegulators(a.regulators, full_scale, a.firmware, a.unit, pair)


def write_rig(rig: FakeRig, path: Path, changes: Mapping[str, Any] | None = None, robot: Path | None = None) -> None:
    """Write rig.yaml, with `changes` to its tables, and beside it robot.yaml, the paper's unless given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    copied(robot or paper_robot(), path.parent / "robot.yaml")
    path.write_text(rig_yaml(rig, "robot.yaml", changes))


def rig_yaml(rig: FakeRig, robot: str, changes: Mapping[str, Any] | None = None) -> str:
    """The rig.yaml that reaches the fakes, with `changes` to its tables; its numbers have units."""
    tables = in_units(merged(rig.rig_file(robot), changes or {}), RigFile)
    return yaml.safe_dump(tables, sort_keys=False, default_flow_style=None, width=120)


def merged(tables: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with `changes`, of tables within them too."""
    both = {k: merged(tables[k], v) for k, v in changes.items() if k in tables and isinstance(v, Mapping)}
    return {**tables, **changes, **both}


def effects(settings: list[str]) -> dict[str, float]:
    """ID[=SIZE] -> {id: size}; without a size the effect's plausible one. Raises ConfigError."""
    catalogue = {e.id: e for e in list_effects()}
    chosen: dict[str, float] = {}
    for setting in settings:
        name, _, size = setting.partition("=")
        if name not in catalogue:
            raise ConfigError(f"--effect {name}: unknown; one of {', '.join(catalogue)}")
        try:
            chosen[name] = number(size) if size else catalogue[name].scale
        except ValueError:
            chosen[name] = math.nan
        if not math.isfinite(chosen[name]):
            raise ConfigError(f"--effect {setting}: {size!r} is not a finite number in {catalogue[name].unit}")
    return chosen


def _driver(role: str, usual: str, what: str) -> Option:
    return option(f"--{role}", metavar="DRIVER", default=usual, help=f"{what}: {usual}, or a package's fake")


VERBS = (
    Verb(
        "fakes",
        serve,
        options=(
            option("--speed", type=float, default=1.0, help="clock speed, times real time (default 1)"),
            repeatable("--effect", "ID[=SIZE]", "switch an effect on (repeatable)"),
            option("--arm-errors", type=float, default=1.0, help="errors of the arm's build, multiples of a UR5's (default 1)"),
            option("--seed", type=int, default=0, help="seed of all noise"),
            option("--regulators", metavar="DRIVER", default="alicat", help="alicat, smc_itv, or a package's fake"),
            option("--full-scale", "PRESSURE", "range of the regulators, such as '900 kPa'"),
            option("--firmware", default="10v20.0-R24", help="firmware of an Alicat; before 6v00 it reports no unit"),
            option("--unit", default="kPa", help="unit that an Alicat reads and accepts, such as psi"),
            option("--swap", "I,K", "swap the hoses of two channels"),
            option("--spine", metavar="DRIVER", default="dynamixel", help="dynamixel, tmcl, or a package's fake"),
            _driver("arm", "ur5", "the arm"),
            _driver("force", "ft300s", "the force sensor"),
            _driver("valve", "numato", "the jamming valve"),
            _driver("gauge", "pfeiffer", "the vacuum gauge"),
            _driver("mocap", "natnet", "the motion capture"),
            option("--without", "KEY[,KEY..]", "instruments to leave out (default: what the robot does not need)"),
            repeatable("--sensor", "NAME=DRIVER", "an additional sensor (repeatable)"),
            path_option("--robot", "ROBOT.yaml", "the robot to simulate (default: the paper's robot)"),
            path_option("--rig", "RIG.yaml", "write rig.yaml and robot.yaml here instead of printing"),
            option("--list-effects", action="store_true", help="list the effects of --effect"),
        ),
        examples=("lab fakes --rig rig/rig.yaml --speed 20", "lab fakes --list-effects"),
        page="docs/howto/fakes.md",
    ),
)
