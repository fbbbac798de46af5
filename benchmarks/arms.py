"""Sealed arms: `python -m benchmarks.arms FOLDER --n 60 --seed S [--arm examples/ur5/arm.yaml] [--workers 2]`.

Each arm has hidden causes, drawn here, and is diagnosed from a fifth of its poses as `lab diagnose poses.csv` does. Its positions
are those of a second kinematics program, and what that does not know is real: the residuals of a measured arm, FOLDER/grid.csv
(see `benchmarks.ur5`), are laid on the same poses, turned and mirrored anew with each draw.

The second program is a product of exponentials (Brockett 1984): with the screw axes S_k of the arm at q = 0 and a displacement
D_k of all behind link k, p = B prod_k [exp(S_k theta_k) D_k] p_0. Gravity's torques are slopes of the potential energy.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.table import Table

from diagnosis.judgement import CAUSE_PROBABILITY
from lab.verbs.diagnose_arm import diagnose_poses
from model.arm import load_arm
from model.arrays import Array

from .blind.metrics import HALF, carries_enough, counted
from .blind.workers import spread
from .ur5 import read

HIDDEN = {
    "zeros": ([1] * 6, "joint_zeros"),
    "lengths": ([1, 1, 1, 1, 1, 0, 1, 0, 0, 1, 1, 0], "link_lengths"),
    "twists": ([1, 1, 1, 1, 1, 0, 0, 1, 1, 0, 0, 0], "axis_twists"),
    "sag": ([0, 1, 1, 0, 0, 0], "gravity_sag"),
    "gear_once": ([1] * 12, "gear_once"),
    "gear_twice": ([1] * 12, "gear_twice"),
    "scale": ([1], "tracker_scale"),
    "mount": ([1, 0.3], "loose_mount"),
}
"""Errors: relative sizes of their values, and what the catalogue calls them."""
OUTSIDE = {"gear_thrice": [1] * 12, "coupled": [1], "hose": [1], "worn_tooth": [1], "lens": [1]}
"""Errors that the catalogue does not list."""
PLACES = {"base": [10, 10, 10, 10, 10, 10], "tool": [2, 2, 2]}
"""mm and mrad by which base and tool of every arm are off."""
KINDS = ("one", "two", "one", "none", "one", "outside")
"""In turn."""
SIZES, SHARE = (1.0, 10.0), 0.2
"""Noise floors that a hidden cause carries, and share of the poses that are measured."""
LARGEST, MOST = {"gear_once": 1e-3, "gear_twice": 1e-3, "gear_thrice": 1e-3, "scale": 1e-3}, 5e-3
"""rad, m or 1: largest value of an error, and of all others, that an arm may have."""
APART, TRIES = 1.0, 100
"""Noise floors by which it differs from what any other cause of the list can do in its place, else it is drawn anew; draws until
another cause is taken."""
PLAUSIBLE, STEP, ROUNDS = 1e-3, 1e-5, 4
"""rad and m: prior of every error in the fit of the measured arm, steps of differences; and steps of that fit."""
MASSES = 0.1
"""Share by which masses differ from those stated."""
TRACKER = np.array([1.8, -0.6, 0.4])
"""m."""


def exponential(turn: Array, shift: Array, angle: Array) -> Array:
    """exp of the twist (turn, shift), the turn of length 1 or 0, times angles (n,): (n, 4, 4)."""
    w, a = np.cross(np.eye(3), turn), angle[:, None, None]
    out = np.zeros((len(angle), 4, 4))
    out[:, :3, :3] = np.eye(3) + np.sin(a) * w + (1 - np.cos(a)) * (w @ w)
    out[:, :3, 3], out[:, 3, 3] = (a * np.eye(3) + (1 - np.cos(a)) * w + (a - np.sin(a)) * (w @ w)) @ shift, 1.0
    return out


def displacement(turn: Array, about: Array, shift: Array) -> Array:
    """(4, 4) of a turn (rad) about a point and a shift."""
    angle = np.linalg.norm(turn)
    unit = turn / max(float(angle), 1e-300)
    out = exponential(unit, np.cross(about, unit), np.array([angle]))[0]
    out[:3, 3] += shift
    return np.asarray(out)


@dataclass(frozen=True)
class SecondArm:
    """An arm of a description at poses q (n, joints), rad."""

    description: Mapping[str, Any]
    q: Array

    @cached_property
    def home(self) -> list[Array]:
        """(4, 4) frames 0, 1 .. at q = 0."""
        frames, none = [np.eye(4)], np.zeros(3)
        for link in self.description["links"]:
            frames.append(frames[-1] @ displacement(none, none, np.array([link["a"], 0, link["d"]])))
            frames[-1] = frames[-1] @ displacement(np.array([np.radians(link["alpha_deg"]), 0, 0]), none, none)
        return frames

    def places(self, theta: Array, bent: Mapping[int, Array], points: Mapping[int, Array]) -> dict[int, Array]:
        """Link -> (n, 3) of the point behind it that is `points` (3,) in its frame; D_k (4, 4) of links that are bent."""
        out, pose = {}, np.broadcast_to(np.eye(4), (len(theta), 4, 4))
        for k, frame in enumerate(self.home[:-1]):
            axis = frame[:3, 2]
            pose = pose @ exponential(axis, np.cross(frame[:3, 3], axis), theta[:, k]) @ bent.get(k, np.eye(4))
            if k in points:
                out[k] = (pose @ self.home[k + 1] @ np.append(points[k], 1.0))[:, :3]
        return out

    def first_moment(self, q: Array) -> Array:
        """(n, 3) mass times place, summed over the links, of which the arm's whole mass is 1."""
        links = dict(enumerate(self.description["links"]))
        mass = np.array([link["mass"] * (1 + MASSES * np.sin(7.0 * k)) for k, link in links.items()])
        at = self.places(q, {}, {k: np.array(link["centre"]) for k, link in links.items()})
        return np.asarray(np.tensordot(mass / mass.sum(), np.array([*at.values()]), 1))

    @cached_property
    def torques(self) -> Array:
        """(n, joints) of gravity about each joint, over the greatest of all."""
        moves = STEP * np.eye(self.q.shape[1])
        slopes = [(self.first_moment(self.q - move) - self.first_moment(self.q + move))[:, 2] for move in moves]
        return np.transpose(slopes) / np.abs(slopes).max()

    @cached_property
    def moment(self) -> Array:
        """(n, 3) of the weight on the base, over its greatest."""
        moment = np.cross(self.first_moment(self.q), [0, 0, -1])
        return np.asarray(moment / np.linalg.norm(moment, axis=1).max())

    def positions(self, errors: Mapping[str, Array]) -> Array:
        """(n, 3) of the measured point, m, with some of the errors in `HIDDEN`, `OUTSIDE` and `PLACES` (m, rad, 1)."""
        known = {name: np.zeros(len(sizes)) for name, (sizes, _) in HIDDEN.items()}
        e = known | {name: np.zeros(len(sizes)) for name, sizes in (OUTSIDE | PLACES).items()} | dict(errors)
        q, none = self.q, np.zeros(3)
        theta = q + e["zeros"] + self.torques * e["sag"]
        for h, name in enumerate(("gear_once", "gear_twice", "gear_thrice"), 1):
            sine, cosine = np.split(e[name], 2)
            theta = theta + sine * np.sin(h * q) + cosine * np.cos(h * q)
        theta[:, 4] += e["coupled"] * np.cos(q[:, 3]) * np.sin(q[:, 2])
        theta[:, 0] += e["hose"] * np.maximum(q[:, 0] - np.median(q[:, 0]), 0.0) ** 2
        theta[:, 2] += e["worn_tooth"] * (q[:, 2] > np.median(q[:, 2]))
        (along, across), (twist, tilt) = np.split(e["lengths"], 2), np.split(e["twists"], 2)
        bent = {
            k: displacement(
                twist[k] * frame[:3, 0] + tilt[k] * frame[:3, 1], frame[:3, 3],
                along[k] * frame[:3, 0] + across[k] * self.home[k][:3, 2],
            )
            for k, frame in enumerate(self.home[1:])
        }  # fmt: skip
        last = q.shape[1] - 1
        point = self.places(theta, bent, {last: self.description["tool"] + e["tool"]})[last]
        lean = (e["mount"][0] + e["mount"][1] / np.linalg.norm(self.moment, axis=1)[:, None]) * self.moment
        point = (point + np.cross(lean, point)) @ displacement(e["base"][3:], none, none)[:3, :3].T + e["base"][:3]
        away = point - TRACKER
        return np.asarray(point + e["scale"] * away + e["lens"] * away * (point[:, 2:] - TRACKER[2]) ** 2)

    def slopes(self, errors: Mapping[str, Array], sizes: Mapping[str, Any]) -> tuple[Array, list[tuple[str, Array]]]:
        """(3 n, k) by every value of the errors `sizes` that has one, at `errors`, and which those are."""
        moves = [
            (name, STEP * row) for name, own in sizes.items() for row, size in zip(np.eye(len(own)), own, strict=True) if size
        ]
        at = self.positions(errors)
        moved = [self.positions({**errors, name: errors.get(name, 0.0) + move}) - at for name, move in moves]
        return np.transpose([m.ravel() for m in moved]) / STEP, moves


def left_by_all(arm: SecondArm, at: Array) -> Array:
    """(n, 3) what all errors of the list together leave of the measured positions, m."""
    errors: dict[str, Any] = {}
    sizes = {name: own for name, (own, _) in HIDDEN.items()} | PLACES
    for _ in range(ROUNDS):
        slope, moves = arm.slopes(errors, sizes)
        prior = np.array([PLAUSIBLE if name in HIDDEN else 1.0 for name, _ in moves])
        now = np.array([np.sum(errors.get(name, 0.0) * move) / STEP for name, move in moves])
        missed = (at - arm.positions(errors)).ravel() + slope @ now
        noise = float(np.std(missed - slope @ np.linalg.lstsq(slope, missed, rcond=None)[0]))
        scaled = slope * prior
        values = prior * np.linalg.solve(scaled.T @ scaled + noise**2 * np.eye(len(prior)), scaled.T @ missed)
        errors = {name: np.zeros(len(own)) for name, own in sizes.items()}
        for (name, move), value in zip(moves, values.tolist(), strict=True):
            errors[name] = errors[name] + value * move / STEP
    return at - arm.positions(errors)


@dataclass(frozen=True)
class Judged:
    """One arm: what was hidden, in noise floors, and what was answered."""

    kind: str
    carries: Mapping[str, float]
    named: tuple[str, ...]
    verdict: str
    probability: float
    seconds: float

    @property
    def right(self) -> bool:
        """By mm: what carries most, or half as much, is named, and nothing that carries less than a floor; none, where nothing
        carries two floors, as in `benchmarks.blind.metrics`; of a cause outside the list nothing is named."""
        if self.kind == "outside" or not self.named:
            return not self.named and (self.kind == "outside" or carries_enough((), self.carries, 1.0))
        carried = [self.carries.get(name, 0.0) for name in self.named]
        return min(carried) >= 1.0 and max(carried) >= HALF * max(self.carries.values())

    @property
    def sure(self) -> bool:
        """Whether causes are named as certain."""
        return self.verdict == "effect" and self.probability > CAUSE_PROBABILITY


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def judged(number: int, seed: int, path: Path, q: Array, residual: Array) -> Judged:
    """Draw an arm, measure it and diagnose it."""
    rng, kind = np.random.default_rng([seed, number]), KINDS[number % len(KINDS)]
    chosen = np.sort(rng.choice(len(q), int(SHARE * len(q)), replace=False))
    mirrored = residual[chosen][:, rng.permutation(3)] * rng.choice([-1, 1], 3)
    arm = SecondArm(yaml.safe_load(path.read_text()), q[chosen])
    errors = {name: PLAUSIBLE * rng.normal(0, sizes) for name, sizes in PLACES.items()}
    of_places, _ = arm.slopes(errors, PLACES)
    basis = np.linalg.qr(of_places)[0]
    nowhere, floor = arm.positions(errors), rms(mirrored)

    def moved(name: str, values: Array) -> Array:
        """Displacements (3 n,) that no base or tool makes, in noise floors."""
        own = (arm.positions({**errors, name: values}) - nowhere).ravel()
        return np.asarray(own - basis @ (basis.T @ own)) / floor

    alike = {n: np.linalg.qr(arm.slopes(errors, {n: s} | PLACES)[0])[0] for n, (s, _) in HIDDEN.items()}

    def drawn(name: str, sizes: list[float]) -> Array | None:
        """Values of an error that no other cause of the list can stand in for."""
        for _ in range(TRIES):
            values = rng.normal(0, 1, len(sizes)) * sizes
            if rng.random() < 0.5:  # one part alone
                values = values * (np.arange(len(values)) % 6 == rng.choice(np.flatnonzero(values)) % 6)
            values = PLAUSIBLE * values / np.abs(values).max()
            once = moved(name, values)
            size = np.exp(rng.uniform(*np.log(SIZES))) / max(rms(once), 1e-3)
            small = kind == "outside" or size * np.abs(values).max() <= LARGEST.get(name, MOST)
            if small and size * min(rms(once - b @ (b.T @ once)) for n, b in alike.items() if n != name) > APART:
                return np.asarray(size * values)
        return None

    listed = OUTSIDE if kind == "outside" else {name: sizes for name, (sizes, _) in HIDDEN.items()}
    hidden: dict[str, Array] = {}
    while len(hidden) < {"one": 1, "two": 2, "none": 0, "outside": 1}[kind]:
        name = str(rng.choice([n for n in listed if n not in hidden]))
        if (values := drawn(name, listed[name])) is not None:
            hidden[name] = values
    carries = {HIDDEN[n][1] if n in HIDDEN else n: rms(moved(n, values)) for n, values in hidden.items()}
    names = [f"q{k}" for k in range(1, q.shape[1] + 1)]
    poses = pd.DataFrame(np.hstack([q[chosen], arm.positions(errors | hidden) + mirrored]), columns=[*names, "x", "y", "z"])
    began = time.process_time()
    answer, _ = diagnose_poses(load_arm(path), poses)
    seconds = time.process_time() - began
    return Judged(kind, carries, answer.effects, answer.verdict, answer.probability, seconds)


def main() -> None:
    """Print how many answers are right, by kind of arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--arm", type=Path, default=Path("examples/ur5/arm.yaml"))
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="print every arm")
    options = parser.parse_args()
    inputs, at = read(options.folder / "grid.csv")
    q = inputs.to_numpy()[:, :6]
    residual = left_by_all(SecondArm(yaml.safe_load(options.arm.read_text()), q), at)
    judge = partial(judged, seed=options.seed, path=options.arm, q=q, residual=residual)
    arms, console = list[Judged](), Console()
    for arm in spread(judge, range(options.n), options.workers, "arms"):
        arms.append(arm)
        if options.each:
            hidden = ", ".join(f"{name} {floors:.1f}" for name, floors in arm.carries.items()) or "nothing"
            mark = "right" if arm.right else "WRONG"
            console.print(f"{mark} {hidden}: {arm.verdict} {' '.join(arm.named)} {arm.probability:.2f} {arm.seconds:.1f} s")
    table = Table("", f"{options.n} arms, floor {1e3 * rms(residual):.4f} mm")
    listed = [arm for arm in arms if arm.kind != "outside"]
    table.add_row("right by mm", counted([a.right for a in listed]))
    for kind in dict.fromkeys(a.kind for a in listed):
        table.add_row(f"  {kind} hidden", counted([a.right for a in listed if a.kind == kind]))
    table.add_row("right, of those named with p > 0.9", counted([a.right for a in arms if a.sure]))
    table.add_row("outside the list: not named with p > 0.9", counted([not a.sure for a in arms if a.kind == "outside"]))
    table.add_row("outside the list: nothing named", counted([a.right for a in arms if a.kind == "outside"]))
    table.add_row("processor, s each (median)", f"{np.median([a.seconds for a in arms]):.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
