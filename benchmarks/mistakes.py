"""Mistakes in robot.yaml or the table: is the mistake named? `python -m benchmarks.mistakes [--kind K] [--robot R] [--draw SEED]`

Three robots are measured by the rod model, each with a modulus, an area factor and a noise that its robot.yaml does not state:
nine chambers hanging, three chambers hanging, four chambers held horizontally; or three that `--draw` makes, of other numbers,
sizes and attitudes. Each of `KINDS` makes one mistake in what is written down of it. A line for each: the verdict, whether the
mistake is named, and whether the answer is acceptable (it is named, or nothing else is stated with a probability above 0.9).
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from benchmarks.blind.metrics import clopper_pearson
from diagnosis.diagnose import Options, diagnose
from diagnosis.errors import BadCase
from lab.files.config import ConfigError
from lab.files.inputs import read_case
from lab.files.robot_file import robot_yaml
from model.arrays import Array
from model.body import body_of
from model.condition import conditions
from model.robot import Robot, robot_from_dict
from model.rods import FINE, solve
from model.section import rods_of
from recordings.errors import BadTable

PSI, ATMOSPHERE = 6894.76, 101_325.0
FLOOR, TRUE_MODULUS, TRUE_AREA = 0.15e-3, 1.06, 1.25
"""m of noise at each reading; what the robot's E and area are in units of what robot.yaml states."""


def _robot(
    length: float, radius: float, chambers: int, pressure: float, gravity: Sequence[float], modulus: float = 450e3
) -> Robot:
    return robot_from_dict(
        {
            "name": f"{chambers} chambers", "length": length, "outer_radius": radius, "inner_radius": 0.0, "density": 1080.0,
            "youngs_modulus": modulus, "shear_modulus": modulus / 3, "tip_mass": 0.25 * 1080 * np.pi * radius**2 * length,
            "gravity": list(gravity), "max_pressure": pressure, "area_factor": 1.0,
            "chambers": {"radius": min(0.22, 0.55 * np.pi / (chambers + 1)) * radius, "path_radius": 0.62 * radius,
                         "azimuths_deg": [360.0 / chambers * k for k in range(chambers)]},
        }
    )  # fmt: skip


ROBOTS = {
    "nine": _robot(0.36, 0.045, 9, 150e3, (0.0, 0.0, 9.81)),
    "three": _robot(0.15, 0.018, 3, 90e3, (0.0, 0.0, 9.81)),
    "four": _robot(0.20, 0.021, 4, 110e3, (-9.81, 0.0, 0.0)),
}


def drawn(seed: int) -> dict[str, Robot]:
    """Three robots: one hangs, one is held horizontally, one stands tilted; the highest pressure bends them by about a radian."""
    rng = np.random.default_rng(seed)
    robots = {}
    for attitude, angle in (("hanging", 0.0), ("horizontal", 90.0), ("tilted", rng.uniform(20, 70))):
        length, chambers = rng.uniform(0.1, 0.6), int(rng.integers(2, 10))
        modulus = float(np.exp(rng.uniform(np.log(150e3), np.log(2e6))))
        radius = length * rng.uniform(0.09, 0.14)
        down = 9.81 * np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
        gravity = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).apply(down).round(4).tolist()
        one = _robot(length, radius, chambers, 100e3, gravity, modulus)
        arm = abs(one.bending_directions[:1].sum()) * one.actuators.area * one.actuators.path_radius
        pressure = rng.uniform(0.5, 1.0) * modulus * body_of(one).mean_second / (TRUE_AREA * arm * length)
        robots[attitude] = one.model_copy(update={"max_pressure": float(pressure), "name": f"{attitude}, {chambers} chambers"})
    return robots


@dataclass
class Told:
    """What is written down of a robot: its robot.yaml as a dictionary, and its table."""

    robot: dict[str, Any]
    frame: pd.DataFrame

    @property
    def pressures(self) -> list[str]:
        return [c for c in self.frame if re.fullmatch(r"p\d+", c)]

    @property
    def tips(self) -> Array:
        return self.frame[["x", "y", "z"]].to_numpy()

    def place(self, tips: Array) -> None:
        """Write other places of the tip."""
        self.frame[["x", "y", "z"]] = tips

    def turn(self, rotation: Rotation) -> None:
        """Turn places and attitudes."""
        self.place(rotation.apply(self.tips))
        self.attitudes((rotation * self.rotations).as_quat(scalar_first=True))

    @property
    def rotations(self) -> Rotation:
        return Rotation.from_quat(self.frame[["qw", "qx", "qy", "qz"]].to_numpy(), scalar_first=True)

    def attitudes(self, quaternions: Array) -> None:
        """Write other attitudes."""
        self.frame[["qw", "qx", "qy", "qz"]] = quaternions


def measured(robot: Robot, seed: int, change: Callable[[Array], Array] = lambda p: p) -> pd.DataFrame:
    """The table of a robot: single chambers and neighbours, four levels up and two down, twice; `change`: of the pressures that
    act, from those that are read."""
    rng = np.random.default_rng(seed)
    count = len(robot.bending_directions)
    step = max(count // 4, 1)
    groups = [*((k,) for k in range(0, count, step)), *((k, (k + 1) % count) for k in range(0, count, step)), tuple(range(count))]
    levels = np.array([0.0, 0.3, 0.6, 0.8, 1.0, 0.6, 0.3]) * float(robot.max_pressure or 0)
    read, trial = [], []
    for number, (_repeat, group) in enumerate(itertools.product(range(2), groups), start=1):
        for level in levels:
            read.append([level * (k in group) for k in range(count)])
            trial.append(number)
    pressures = np.array(read)
    moduli = {name: getattr(robot, name) * TRUE_MODULUS for name in ("youngs_modulus", "shear_modulus")}
    built = robot.model_copy(update=moduli).replace(area_factor=TRUE_AREA)
    found = solve(rods_of(built, conditions(built, np.zeros(len(read)), change(pressures))), FINE)
    order, numbers = np.flatnonzero(found.converged), np.array(trial)[found.converged]  # a body that snaps is not read
    found, pressures = found.take(order), pressures[order]
    frame = pd.DataFrame({"trial": numbers, "step": order % len(levels) + 1, "protocol": "bending"})
    frame["repeat"] = np.where(numbers > len(groups), 2, 1)
    frame["branch"] = np.where(order % len(levels) > 4, "unload", "load")
    frame["t"], frame["hold"], frame["spine_length"] = 8.0 * order + 20 * numbers, 5.0, 0.0
    for k in range(count):
        frame[f"p{k + 1}"] = pressures[:, k] + 0.001 * float(robot.max_pressure or 0) * rng.normal(size=len(order))
    frame[["x", "y", "z"]] = found.tip + FLOOR * rng.normal(size=found.tip.shape)
    turn = Rotation.from_quat(found.orientation, scalar_first=True) * Rotation.from_rotvec(
        2e-3 * rng.normal(size=found.tip.shape)
    )
    frame[["qw", "qx", "qy", "qz"]] = turn.as_quat(canonical=True, scalar_first=True)
    return frame


# ------------------------------------------------------------------ the mistakes
def _plain(robot: Robot, seed: int) -> Told:
    return Told(robot.model_dump(mode="json", exclude_defaults=True), measured(robot, seed))


def written(act: Callable[[Told, Robot], None]) -> Callable[[Robot, int], Told]:
    """A mistake that is made when the robot or its table is written down."""

    def made(robot: Robot, seed: int) -> Told:
        told = _plain(robot, seed)
        act(told, robot)
        return told

    return made


def acting(change: Callable[[Array], Array]) -> Callable[[Robot, int], Told]:
    """Pressures act that are not those of the table."""
    return lambda robot, seed: Told(
        robot.model_dump(mode="json", exclude_defaults=True), measured(robot, seed, lambda p: change(p.copy()))
    )


def _dead(p: Array) -> Array:
    p[:, min(2, p.shape[1] - 1)] = 0.0
    return p


def _weak(p: Array) -> Array:
    p[:, 1] *= 0.6
    return p


def _exchanged(t: Told, _robot: Robot) -> None:
    other = 3 if len(t.pressures) > 3 else 2
    t.frame[["p1", f"p{other}"]] = t.frame[[f"p{other}", "p1"]].to_numpy()


def _reversed(t: Told, _robot: Robot) -> None:
    t.frame[t.pressures] = t.frame[t.pressures[::-1]].to_numpy()


def _shifted(t: Told, _robot: Robot) -> None:
    t.frame[t.pressures] = np.roll(t.frame[t.pressures].to_numpy(), 1, axis=1)


def _times(columns: Callable[[Told], list[str]], factor: float, more: float = 0.0) -> Callable[[Told, Robot], None]:
    def act(t: Told, _robot: Robot) -> None:
        t.frame[columns(t)] = t.frame[columns(t)] * factor + more

    return act


def _moved(t: Told, robot: Robot) -> None:
    later = (t.frame["trial"] > t.frame["trial"].max() / 2).to_numpy()
    t.place(t.tips + later[:, None] * robot.length * np.array([0.012, -0.008, 0.004]))


def _pivot(t: Told, robot: Robot) -> None:
    t.place(t.tips + t.rotations.apply(robot.length * np.array([0.04, 0.0, 0.0])))


def _turned(degrees: float) -> Callable[[Told, Robot], None]:
    return lambda t, _robot: t.turn(Rotation.from_euler("z", degrees, degrees=True))


def _robot_number(name: str, factor: float) -> Callable[[Told, Robot], None]:
    def act(t: Told, robot: Robot) -> None:
        t.robot[name] = (np.array(getattr(robot, name)) * factor).tolist()

    return act


def _tilted(t: Told, robot: Robot) -> None:
    """The base leans by 20 degrees, so that gravity lies aslant in its frame, and robot.yaml does not say so."""
    built = robot.model_copy(update={"gravity": tuple(Rotation.from_euler("y", 20, degrees=True).apply(robot.gravity))})
    t.frame = measured(built, 3)


Mistake = tuple[str, Callable[[Robot, int], Told]]
KINDS: Mapping[str, Mistake] = {
    "gravity reversed": (r"gravity|upside", written(_robot_number("gravity", -1.0))),
    "base tilted": (r"tilt|gravity", written(_tilted)),
    "frame turned by 90 deg": (r"azimuth|turned|frame|axes", written(_turned(90))),
    "frame turned by 35 deg": (r"azimuth|turned|frame", written(_turned(35))),
    "y mirrored": (r"mirror|sign|left-handed|-y|order|count|axis", written(lambda t, _: t.place(t.tips * [1, -1, 1]))),
    "axes permuted": (r"ax[ei]s|z", written(lambda t, _: t.place(t.tips[:, [2, 0, 1]]))),
    "cameras moved": (r"moved|trial \d+|frame", written(_moved)),
    "positions in cm": (r"cm|unit", written(_times(lambda t: ["x", "y", "z"], 100.0))),
    "quaternion order": (r"quaternion|order|qw|attitude",
                         written(lambda t, _: t.attitudes(t.frame[["qx", "qy", "qz", "qw"]].to_numpy()))),
    "marker pivot": (r"marker|pivot|origin|tracked", written(_pivot)),
    "absolute pressures": (r"absolute|atmosph|offset", written(_times(lambda t: t.pressures, 1.0, ATMOSPHERE))),
    "all pressures in psi": (r"psi", written(_times(lambda t: t.pressures, 1 / PSI))),
    "one column in psi": (r"psi|p2", written(_times(lambda t: ["p2"], 1 / PSI))),
    "pressures 1.3 times too high": (r"area|pressure|gain|stiffer", written(_times(lambda t: t.pressures, 1.3))),
    "a chamber dead": (r"chamber 3|p3", acting(_dead)),
    "a chamber weak": (r"chamber 2|p2", acting(_weak)),
    "two chambers exchanged": (r"order|swap|chambers? 1|p1", written(_exchanged)),
    "order reversed": (r"order|revers|mirror|direction", written(_reversed)),
    "order shifted": (r"order|shift|azimuth|turned", written(_shifted)),
    "length under pressure": (r"length|origin", written(_robot_number("length", 1.06))),
    "mass at the tip missing": (r"mass|carries|weigh|payload", written(_robot_number("tip_mass", 0.0))),
}  # fmt: skip
"""Pattern of an answer that names it, and how it is made."""
OWN = {
    "base tilted": {"base_tilt"}, "marker pivot": {"marker_offset"}, "a chamber dead": {"chamber_gain"}, "a chamber weak":
    {"chamber_gain"}, "two chambers exchanged": {"chamber_order"}, "order reversed": {"chamber_order"}, "order shifted":
    {"chamber_order", "chamber_azimuth"}, "frame turned by 35 deg": {"chamber_azimuth", "frame_misalignment"},
    "frame turned by 90 deg": {"chamber_azimuth", "frame_misalignment"},
    "mass at the tip missing": {"tip_payload", "self_weight"},
    "one column in psi": {"chamber_gain"}, "pressures 1.3 times too high": {"body_modulus"},
}  # fmt: skip
"""Effects of the catalogue that are the mistake."""


def answer(told: Told) -> tuple[str, str, set[str]]:
    """Verdict in a word or two, all that is said of causes and mistakes, and the effects that are stated as sure."""
    with tempfile.TemporaryDirectory(prefix="mistake-") as place:
        folder = Path(place)
        (folder / "robot.yaml").write_text(robot_yaml(robot_from_dict(told.robot)))
        told.frame.to_csv(folder / "trials.csv", index=False)
        try:
            found = diagnose(read_case([folder]), Options(experiments=False, quantify=False))
        except (BadCase, BadTable, ConfigError) as error:
            return "refused", str(error), set()
    said = " ".join([found.headline, found.statement,
                     *(f.text for f in found.findings if f.severity != "note")])  # fmt: skip
    a = found.attribute
    sure = set(a.effects) if a.conclusion == "cause" or a.probability > 0.9 and a.verdict == "effect" else set()
    return f"{a.conclusion} {','.join(a.effects)} {a.probability:.2f}", said, sure


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mistakes", description=__doc__)
    parser.add_argument("--kind", action="append", choices=KINDS)
    parser.add_argument("--robot", action="append")
    parser.add_argument("--draw", type=int, metavar="SEED", help="three other robots")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--text", action="store_true", help="print what was said")
    a = parser.parse_args()
    robots = ROBOTS if a.draw is None else drawn(a.draw)
    named = acceptable = count = 0
    for name, kind in itertools.product(a.robot or robots, a.kind or KINDS):
        pattern, make = KINDS[kind]
        began = time.process_time()
        verdict, said, sure = answer(make(robots[name], a.seed + count))
        own = OWN.get(kind, set())
        is_named = bool(re.search(pattern, said)) and not sure - own
        is_acceptable = is_named or not sure - own
        named, acceptable, count = named + is_named, acceptable + is_acceptable, count + 1
        rating = "named" if is_named else "acceptable" if is_acceptable else "WRONG"
        print(f"{name:6s} {kind:30s} {rating:10s} {verdict} ({time.process_time() - began:.0f} s)", flush=True)
        if a.text:
            print(f"       {said[:600]}")
    for word, number in (("named", named), ("acceptable", acceptable)):
        low, high = clopper_pearson(number, count)
        print(f"{word}: {number} of {count} ({low:.2f} .. {high:.2f})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
