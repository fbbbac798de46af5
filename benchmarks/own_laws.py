"""What could a diagnosis know? Robots of a world, weighed with the very laws that made them, or with the other forms of each law.

Linear about the truth, by the same evidence and prior as the diagnosis:

    y = sum_e s_e c_e + N u + e,     s_e ~ N(0, v_e),

y the readings of the campaign beside the truth, c_e what a plausible scale of effect e does there, N what trials, mounting,
drift and calibration change, e cameras. A named effect has v = 1, the others what the world's tolerances and clutter are. With
the world's own laws c_e is exact. With the other forms it is any mixture of what those do, each as probable: the laws that a
catalogue may know when it does not hold the true one. A cause outside the catalogue is one of `worlds.outside`, or
an error of no known law: a smooth function of pressure and length, or of time, in every channel.

What is lost with the world's own laws, the data do not hold; what is lost with the other forms only, better laws would.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.special import logsumexp

from benchmarks.blind.make import ATTEMPTS, Drawn, Unequal, drawn, noise_floor, table_of
from benchmarks.blind.metrics import APART, FLOORS, HALF, carries_enough, counted
from benchmarks.blind.sweeps import BASE
from benchmarks.blind.truth import KINDS, LESS_CLUTTER, SMALL, THRUST, TOLERANCES, Recipe, Stratum, draw
from benchmarks.blind.worlds.campaign import (
    DRIFT,
    GROWN,
    JAMMED,
    MEMORY,
    STEPS,
    Readings,
    Response,
    Robot,
    Sweep,
    drifted,
    read,
    respond,
)
from benchmarks.blind.worlds.carried import TRIED, nearest
from benchmarks.blind.worlds.equilibrium import NoEquilibrium
from benchmarks.blind.worlds.forms import EFFECTS, FORMS
from benchmarks.blind.worlds.frames import rotation_vector, transposed
from benchmarks.blind.worlds.outside import OUTSIDE
from benchmarks.blind.worlds.robot import LENGTH
from benchmarks.figures import write
from diagnosis.criticism.stage_errors import smooth_functions
from diagnosis.inference.posterior import hypothesis_prior
from diagnosis.judgement import CAUSE_PROBABILITY, PRIOR_OF_NUMBER
from model.effects.catalogue import CATALOGUE

Array = NDArray[np.float64]
Hypothesis = tuple[str, ...]

LEVELS = (0.1, 1.0)
"""Clutter is not known beforehand: shares of the world's, each as probable."""
WIDE_AREA = 0.2
"""Relative, standard deviation of the area factor before it is calibrated."""
FREE = (0.1, 0.4, 1.0, 2.0, 4.0)
"""Sizes of an error of no known law, in noise floors or plausible scales."""
ARM = 0.1
"""m, by which floors become rad."""
DRAWS = 400
ANALYSES = {
    "own laws, the cause among nine known ones": ("own", True),
    "own laws, no law of the cause": ("own", False),
    "other forms of each law, no law of the cause": ("others", False),
}
"""What is known: laws of the effects, and whether the cause outside the catalogue is among `OUTSIDE`."""


@dataclass(frozen=True)
class Judged:
    """What an analysis says of a robot."""

    named: Hypothesis
    """What is most probably right by mm: an effect, or nothing."""
    probability: float
    """That it is, if the cause is in the catalogue."""
    outside: float
    """Log odds of a cause outside the catalogue."""
    carriers: Hypothesis
    """All effects that more probably than not carry a floor and half of what the largest carrier does."""


@dataclass(frozen=True)
class Case:
    """One robot: what is measured beside what its effects do, whitened, and what is true."""

    stratum: str
    causes: frozenset[str]
    carries: Mapping[str, float]
    floor: float
    leaves: float
    """mm that the nearest known effect leaves of a cause outside the catalogue."""
    answers: Mapping[str, Judged]
    """By analysis."""


class Evidence:
    """y ~ N(0, I + N N^T + sum v_j x_j x_j^T): log evidence of variances v, up to a constant, and what is known of x then."""

    def __init__(self, y: Array, nuisances: Array, columns: Array) -> None:
        x = np.column_stack([columns, y])
        inner = cho_factor(np.eye(nuisances.shape[1]) + nuisances.T @ nuisances)
        across = nuisances.T @ x
        gram = x.T @ x - across.T @ cho_solve(inner, across)
        self._gram, self._score = gram[:-1, :-1], gram[:-1, -1]

    def _factors(self, variance: Array) -> tuple[Array, Array, Array, Array]:
        kept = np.flatnonzero(variance)
        root = np.sqrt(variance[kept])
        factor = cholesky(np.eye(kept.size) + root[:, None] * self._gram[np.ix_(kept, kept)] * root, lower=True)
        return kept, root, factor, solve_triangular(factor, root * self._score[kept], lower=True)

    def log(self, variance: Array) -> float:
        """Of variances (p,)."""
        _, _, factor, half = self._factors(variance)
        return float(0.5 * half @ half - np.log(np.diag(factor)).sum())

    def draws(self, variance: Array, normal: Array) -> Array:
        """(d, p) coefficients as probable as they are, from normal numbers (d, p)."""
        kept, root, factor, half = self._factors(variance)
        found = np.zeros_like(normal)
        found[:, kept] = root * solve_triangular(factor, half[:, None] + normal[:, kept].T, lower=True, trans=1).T
        return found


@dataclass(frozen=True)
class Campaign:
    """One robot's sweep as lists of columns (T, R, 6): m and rad."""

    robot: Robot
    walked: Sweep
    where: NDArray[np.intp]
    """The distinct state of each trial."""

    def column(self, response: Response, name: str, size: float = 1.0) -> Array:
        """What a change does in all trials, for a size of 1."""
        tip, turns = (np.swapaxes(a[:, self.where], 0, 1) for a in response.by[name][:2])
        found = np.concatenate([tip, turns], axis=-1) / size
        cause = OUTSIDE.get(name)
        return found if cause is None or cause.course is None else cause.course(self.walked.passed)[:, None, None] * found

    def nuisances(self, response: Response) -> list[Array]:
        """What calibration, trials, mounting, drift and the camera's place change, for one standard deviation each."""
        world, count = self.robot.world, len(self.walked.trials)
        found = [WIDE_AREA * self.column(response, "area", STEPS["area"])]
        for name, sd in (("grown", world.spread * GROWN), ("jammed", world.spread * JAMMED)):
            if name in response.by:
                each = sd * self.column(response, name, STEPS[name])
                found += [each * (np.arange(count) == t)[:, None, None] for t in range(count)]
        course = drifted(world.drift / DRIFT.scale, self.walked.passed)
        found.append(course[:, None, None] * self.column(response, DRIFT.id))
        mounting = np.array([t.repeat if world.remounts else 1 for t in self.walked.trials])
        for name in ("tilt_x", "tilt_y"):
            each = np.radians(world.remount) * self.column(response, name, STEPS[name])
            found += [each * (mounting == m)[:, None, None] for m in np.unique(mounting)]
        for axis in range(3):
            found.append(np.zeros_like(found[0]))
            found[-1][..., axis] = world.tolerance * SMALL
        return found

    def beside(self, response: Response, readings: Readings) -> Array:
        """(T, R, 6) readings beside the truth."""
        tip = readings.tip - np.swapaxes(response.tip[:, self.where], 0, 1)
        there = np.swapaxes(response.turns[:, self.where], 0, 1)
        return np.concatenate([tip, rotation_vector(transposed(there) @ readings.turns)], axis=-1)

    def whitened(self, t: Array) -> Whitening:
        """By the cameras' noise at these times (T, R)."""
        world, flat = self.robot.world, t.reshape(-1)
        kernel = np.exp(-np.abs(flat[:, None] - flat) / MEMORY)
        sd = np.array([world.camera * 1e-3] * 3 + [np.radians(world.camera)] * 3)
        return Whitening(cholesky((1 - world.correlated) * np.eye(flat.size) + world.correlated * kernel, lower=True), sd)


@dataclass(frozen=True)
class Whitening:
    """Takes noise apart: L^-1 over all readings of a channel, each channel by its standard deviation."""

    factor: Array
    sd: Array

    def __call__(self, columns: Sequence[Array]) -> Array:
        """(n, k) of columns (T, R, 6)."""
        stacked = np.stack([(c / self.sd).reshape(-1, 6) for c in columns], axis=-1)
        k = stacked.shape[-1]
        return solve_triangular(self.factor, stacked.reshape(len(stacked), -1), lower=True).reshape(-1, k)


def first_drawn(recipe: Recipe, place: int, stratum: Stratum, causes: Sequence[str]) -> tuple[int, Drawn]:
    """The first attempt that has an equilibrium, and its robot."""
    for attempt in range(ATTEMPTS):
        try:
            return attempt, drawn(recipe, place, stratum, causes, attempt)
        except (NoEquilibrium, Unequal):
            continue
    raise NoEquilibrium(f"{recipe.world}, case {place + 1}")


def other_forms(robot: Robot, k: int) -> Robot:
    """The same robot with the k-th other form of every law."""
    forms = {}
    for effect, own in robot.world.forms.items():
        others = [f for f in FORMS[effect] if f != own]
        forms[effect] = others[k % len(others)]
    return replace(robot, world=replace(robot.world, forms=forms))


def case(recipe: Recipe, place: int, stratum: Stratum, causes: Sequence[str]) -> Case:
    """One robot weighed: the one that its set holds. Raises NoEquilibrium where another form of its laws has none."""
    attempt, made = first_drawn(recipe, place, stratum, causes)
    robot, walked = made.robot, made.walked
    absent = {e: TRIED for e in EFFECTS if e not in robot.present}
    known = replace(robot, causes=OUTSIDE)
    response = respond(known, walked, tuple(robot.present), absent | {o: TRIED for o in OUTSIDE if o not in robot.outside})
    c = Campaign(robot, walked, response.of(walked))
    size = {**absent, **dict.fromkeys(OUTSIDE, TRIED), **robot.present}
    own = {e: c.column(response, e, size[e]) for e in size}
    families: dict[str, list[Array]] = {e: [] for e in EFFECTS}
    for k in range(3):
        other = other_forms(robot, k)
        there = respond(other, walked, tuple(e for e in robot.present if e in EFFECTS), absent)
        for e in EFFECTS:
            if k < len(FORMS[e]) - 1:
                families[e].append(c.column(there, e, size[e]))
    readings = read(robot, walked, response, np.random.default_rng([recipe.seed, 7, place, attempt]))
    floor = noise_floor(robot, walked, response, recipe.seed, place)
    y = c.beside(response, readings) + sum(s * own[e] for e, s in robot.present.items())
    white = c.whitened(readings.t)
    measured, nuisances = white([y])[:, 0], white(c.nuisances(response))
    laws = {"own": {e: white([own[e]]) for e in EFFECTS}, "others": {e: white(f) for e, f in families.items()}}
    outside = {o: white([own[o]]) for o in OUTSIDE}
    free = free_errors(white, readings, floor, own)
    area = c.column(response, "area", STEPS["area"])
    plain = {"own": {e: [own[e]] for e in EFFECTS}, "others": families}
    answers = {
        name: answer(
            robot, floor, measured, nuisances, laws[which], {e: calibrated(x, area) for e, x in plain[which].items()},
            outside if listed else free, listed, np.random.default_rng([recipe.seed, 9, place]),
        )
        for name, (which, listed) in ANALYSES.items()
    }  # fmt: skip
    cause = next(iter(robot.outside), None)
    leaves = 0.0
    if cause is not None:
        leaves = nearest(robot, walked, response, cause, [e for e in EFFECTS if e != THRUST])[1]
    return Case(stratum, frozenset(made.effects), made.weight.calibrated, floor, leaves, answers)


def free_errors(white: Whitening, readings: Readings, floor: float, own: Mapping[str, Array]) -> dict[str, Array]:
    """Errors of no known law: smooth functions of the state, one noise floor large in every channel, or as large as what the
    effects of a stage do (`diagnosis.criticism.stage_errors`)."""
    table = table_of(BASE, readings)
    functions = smooth_functions(
        np.array([r.spine_length for r in table.rows]), np.array([max(r.pressures) for r in table.rows]),
        np.array([-1.0 if r.branch == "unload" else 1.0 for r in table.rows]), readings.t.reshape(-1), LENGTH,
    )  # fmt: skip
    scale = np.array([floor * 1e-3 / np.sqrt(3)] * 3 + [floor * 1e-3 / np.sqrt(3) / ARM] * 3)
    responses = {"every channel": [scale * channel for channel in np.eye(6)]}
    for stage in dict.fromkeys(e.stage for e in CATALOGUE.values()):
        responses[stage] = [own[e] for e in EFFECTS if CATALOGUE[e].stage == stage]
    return {
        f"{what}, {dependence}": white([a * f.reshape(*readings.t.shape, 1) for a in each for f in functions_of.T])
        for what, each in responses.items()
        for dependence, functions_of in functions.items()
    }


def calibrated(columns: Sequence[Array], area: Array) -> Array:
    """(k, k) mm^2, mean products over all readings of what columns move the tip by beyond an area factor."""
    x = np.stack([c[..., :3].reshape(-1) for c in columns], axis=-1) * 1e3
    a = area[..., :3].reshape(-1)
    x = x - np.outer(a, a @ x) / (a @ a)
    return np.asarray(3 * x.T @ x / len(x))


def answer(
    robot: Robot, floor: float, y: Array, nuisances: Array, laws: Mapping[str, Array], products: Mapping[str, Array],
    outside: Mapping[str, Array], listed: bool, rng: np.random.Generator,
) -> Judged:  # fmt: skip
    """The evidence of a robot's readings weighed."""
    world = robot.world
    blocks = [*laws.items(), *outside.items()]
    evidence = Evidence(y, nuisances, np.hstack([x for _, x in blocks]))
    owner = np.repeat([name for name, _ in blocks], [x.shape[1] for _, x in blocks])
    forms = np.repeat([x.shape[1] if name in laws else 1 for name, x in blocks], [x.shape[1] for _, x in blocks])

    def variance(named: Hypothesis, extra: Mapping[str, float], level: float) -> Array:
        of = {
            e: (level * world.clutter * LESS_CLUTTER.get(e, 1.0)) ** 2 + (world.tolerance * TOLERANCES.get(e, 0.0)) ** 2
            for e in laws if e != THRUST
        } | dict.fromkeys(named, 1.0) | dict(extra)  # fmt: skip
        return np.array([of.get(e, 0.0) for e in owner]) / forms

    hypotheses = [(h, level) for h in ((), *((e,) for e in laws), *combinations(laws, 2)) for level in LEVELS]
    variances = [variance(h, {}, level) for h, level in hypotheses]
    score = np.array([evidence.log(v) for v in variances])
    score += [np.log(hypothesis_prior(h, len(laws)) / len(LEVELS)) for h, _ in hypotheses]
    within = float(logsumexp(score))
    share_of = np.exp(score - within)
    counts = rng.multinomial(DRAWS, share_of / share_of.sum())
    sizes = [evidence.draws(variances[i], rng.normal(size=(counts[i], len(owner)))) for i in np.flatnonzero(counts)]
    sampled = np.concatenate(sizes)
    carry = {}
    for e, product in products.items():
        own = sampled[:, owner == e]
        carry[e] = np.sqrt(np.maximum(np.einsum("di,ij,dj->d", own, product, own), 0.0))
    most = np.max(list(carry.values()), axis=0)
    right: dict[Hypothesis, float] = {(): float(np.mean(most < FLOORS * floor))}
    right |= {(e,): float(np.mean(mm >= np.maximum(HALF * most, floor))) for e, mm in carry.items()}
    best = max(right, key=lambda h: right[h])
    ways = [{o: 1.0} for o in outside] if listed else [{o: s**2} for o in outside for s in FREE]
    beyond = [evidence.log(variance((), way, level)) for way in ways for level in LEVELS]
    without = logsumexp(beyond) - np.log(len(beyond)) + np.log(1 - sum(PRIOR_OF_NUMBER.values()))
    carriers = tuple(e for e in carry if right[(e,)] > 0.5)
    return Judged(best, right[best], float(without - within), carriers)


def figures(cases: Sequence[Case]) -> dict[str, dict[str, str]]:
    """By analysis: shares with their 95 % intervals."""
    out = {}
    for name in ANALYSES:
        known = [(c, c.answers[name]) for c in cases if not c.stratum.endswith(("outside", "pairs"))]
        pairs = [(c, c.answers[name]) for c in cases if c.stratum.endswith("pairs")]
        outer = [(c, c.answers[name].outside) for c in cases if c.stratum.endswith("outside")]
        right = [
            (c.stratum.startswith("cluttered"), a.probability, carries_enough(a.named, c.carries, c.floor)) for c, a in known
        ]
        both = [(c.stratum.startswith("cluttered"), c.causes, set(a.carriers)) for c, a in pairs]
        limit = float(np.quantile([a.outside for _, a in known], 0.9)) if known else 0.0
        big = [odds for c, odds in outer if c.leaves >= APART * c.floor]
        out[name] = {
            "right by mm, clean": counted([r for cluttered, _, r in right if not cluttered]),
            "right by mm, cluttered": counted([r for cluttered, _, r in right if cluttered]),
            "stated with p > 0.9: right": counted([r for _, p, r in right if p > CAUSE_PROBABILITY]),
            "pairs of comparable mm, clean: both named": counted([c <= found for cluttered, c, found in both if not cluttered]),
            "pairs of comparable mm, cluttered: both named": counted([c <= found for cluttered, c, found in both if cluttered]),
            "pairs of comparable mm: exactly both": counted([c == found for _, c, found in both]),
            "known cause: outside more probable": counted([a.outside > 0 for _, a in known]),
            "outside: more probable": counted([odds > 0 for _, odds in outer]),
            "outside of 1.5 floors: more probable": counted([odds > 0 for odds in big]),
            "outside of 1.5 floors: flagged at 10 % false flags": counted([odds > limit for odds in big]),
        }
    return out


def main() -> int:
    """Print the figures by what is known, and write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("worlds", nargs="+", help="WORLD=SEED of the --world and --seed of a set of `benchmarks.blind make`")
    parser.add_argument("--n", type=int, default=40, help="cases of each set; walls are left out")
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=[], help="as of the set")
    parser.add_argument("--json", type=Path, default=Path("out/own_laws.json"))
    a = parser.parse_args()
    orders = []
    for word in a.worlds:
        world, _, seed = word.rpartition("=")
        recipe = Recipe(world, a.n, int(seed), tuple(a.kind))
        orders += [(recipe, place, *chosen) for place, chosen in enumerate(draw(recipe))]
    cases = []
    console = Console(width=150)
    for recipe, place, stratum, causes in track(orders, console=Console(stderr=True)):
        if stratum != "walls":
            try:
                cases.append(case(recipe, place, stratum, causes))
            except NoEquilibrium:
                console.print(f"{recipe.world}, case {place + 1}: no equilibrium, left out", markup=False)
    found = figures(cases)
    for name, own in found.items():
        console.print(name, markup=False)
        for figure, value in own.items():
            console.print(f"  {figure}: {value}", markup=False)
    write(a.json, "cases", [{**asdict(c), "causes": sorted(c.causes)} for c in cases], figures=found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
