"""Is the Laplace evidence right? `python -m benchmarks.evidence [--cases N] [--live N] [--json FILE]`.

Robots of the world `bench`, small campaigns (tip alone, loading alone), three hypotheses each: none, the true effect and a
rival. The diagnosis' log evidence of each stands next to that of a nested sampler (dynesty, J. S. Speagle, MNRAS 493, 2020).

Both have the same prior: normals cut at their bounds, and of a named effect at least one size of `least_named`. The sampler takes
the named effect's parameters and the calibration through the model in full. The tolerances, what each trial has of its own, and
the smooth discrepancy are integrated out by algebra, linear around the most probable point. Needs the extra `check`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import norm

from benchmarks.blind.make import described, table_of, walk_of
from benchmarks.blind.sweeps import Sweep, design
from benchmarks.blind.truth import Recipe, draw_robot
from benchmarks.blind.worlds.campaign import read, respond
from benchmarks.figures import Figure, show
from diagnosis.data.case import states
from diagnosis.inference.evidence import NONE, Grid, Hypothesis, weigh
from diagnosis.inference.fit import Fit, fit
from diagnosis.inference.prepare import Prepared, prepare
from diagnosis.inference.problem import Problem
from lab.files.inputs import Case

Array = NDArray[np.float64]

START_SIZE = 0.25
ROUNDS = 12
SWEEP = Sweep("small", (0.0, 0.15, 0.30), (50e3, 150e3, 250e3), repeats=2)
SEED = 90210
SIZE = 0.1
"""Of the discrepancy, in units of the noise floor."""
TARGET = 0.7
"""Log evidence that may be missed by: a factor of two."""


@dataclass(frozen=True)
class Question:
    """A robot with one effect, and a rival that is weighed beside it."""

    true: Hypothesis
    rival: str


QUESTIONS = (
    Question(("chamber_azimuth",), "precurvature"),
    Question(("chamber_ballooning",), "hyperelastic"),
    Question(("area_moment",), "spine_shear"),
    Question(NONE, "body_modulus"),
    Question(("spine_length_offset",), "vacuum_leak"),
    Question(("tether_load",), "base_tilt"),
)


def one_cell(size: float) -> Grid:
    """A grid of one point: every other effect absent, laws exact, a discrepancy of one size."""
    one = np.ones(1)
    return Grid(np.zeros(1), one, np.array([size]), one, np.zeros(1), one)


@dataclass(frozen=True)
class Hypothetical:
    """One hypothesis of a problem around its most probable point, every other effect absent."""

    problem: Problem
    named: Hypothesis
    size: float
    """Of the discrepancy."""
    around: Fit

    @cached_property
    def sampled(self) -> NDArray[np.intp]:
        """Indices of the parameters that are sampled: the named effect's, then the calibration."""
        p = self.problem.parameters
        own = [i for i, e in enumerate(p.effects) if e in self.named]
        return np.array([*own, *np.flatnonzero(p.calibration)], np.intp)

    @property
    def laplace(self) -> float:
        """Log evidence as the diagnosis has it."""
        grid_point = one_cell(self.size)
        return (
            weigh(self.around.linear(self.problem), grid_point, self.problem.parameters, [self.named])[0].log_evidence
            - self.around.predicted_decrease
        )

    def prior(self, unit: Array) -> Array:
        """Values of the sampled parameters (d,) from a point (d,) of the unit cube."""
        p, own = self.problem.parameters, self.sampled
        low, high = (norm.cdf((bound - p.mean)[own] / p.sd[own]) for bound in (p.lower, p.upper))
        shares = self._off_small(unit, low, high)
        # Off the ends, where a normal has no finite value.
        held = np.clip(low + shares * (high - low), 1e-15, 1 - 1e-15)
        out: Array = np.clip(p.mean[own] + p.sd[own] * norm.ppf(held), p.lower[own], p.upper[own])
        return out

    def _off_small(self, unit: Array, low: Array, high: Array) -> Array:
        """Shares (d,) of each parameter's range, spread evenly but for the box in which all sizes of the effect are small.

        One size after the other: inside its small interval there is only what the sizes that follow leave of it.
        """
        p = self.problem.parameters
        out = unit.copy()
        places = [j for j, i in enumerate(self.sampled) if p.effects[i] and p.infos[i].role == "size"]
        least = np.zeros(len(p.names))
        least[p.of_effect] = p.least_named
        edges = np.clip((norm.cdf([-least[self.sampled], least[self.sampled]]) - low) / (high - low), 0.0, 1.0)
        for k, j in enumerate(places):
            a, b = edges[0, j], edges[1, j]
            later = float(np.prod([edges[1, i] - edges[0, i] for i in places[k + 1 :]]))
            inside = (b - a) * (1 - later)
            at = unit[j] * (a + inside + 1 - b)
            if at < a:
                out[j] = at
            elif at < a + inside:
                out[j] = a + (at - a) / (1 - later)
                continue
            else:
                out[j] = b + (at - a - inside)
            break
        return out

    def log_likelihood(self, values: Array) -> float:
        """Log of the probability of the data at the sampled parameters (d,), all else integrated out."""
        theta = self.around.theta.copy()
        theta[self.sampled] = values
        predicted = self.problem.forward.predict(theta)
        if not np.isfinite(predicted).all():
            return -1e100
        left = self.problem.noise.whiten(self.problem.observed - predicted) + self._shift
        pulled = self._columns.T @ left
        squared = float(left @ left) - float(pulled @ cho_solve(self._factor, pulled))
        half = float(np.log(np.diag(self._factor[0])).sum()) + self.problem.noise.log_sd
        return -0.5 * (squared + len(left) * np.log(2 * np.pi)) - half

    @cached_property
    def _rest(self) -> NDArray[np.intp]:
        """Indices of the tolerances."""
        return np.setdiff1d(np.flatnonzero(~self.problem.parameters.of_effect), self.sampled)

    @cached_property
    def _columns(self) -> Array:
        """(n, k + m) what is integrated out, whitened."""
        p = self.problem.parameters
        rest = self.problem.noise.whiten(self.around.derivatives(self.problem).whole[:, self._rest] * p.sd[self._rest])
        return np.hstack([rest, self.size * self.problem.whitened_discrepancy])

    @cached_property
    def _shift(self) -> Array:
        """(n,) what the tolerances do at the point they are linear around."""
        p = self.problem.parameters
        at = (self.around.theta - p.mean)[self._rest] / p.sd[self._rest]
        out: Array = self._columns[:, : len(self._rest)] @ at
        return out

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        x = self._columns
        factor: tuple[Array, bool] = cho_factor(np.eye(x.shape[1]) + x.T @ x, lower=True)
        return factor


def hypothetical(problem: Problem, named: Hypothesis, size: float) -> Hypothetical:
    """A hypothesis at the best of the most probable points found from all the starts its effect has."""
    p = problem.parameters
    prior = p.prior(p.mask(named), 0.0)
    begun = fit(problem, p.no_effects(), START_SIZE, p.mean, 4).theta
    starts = [begun.copy()]
    own = [i for i, e in enumerate(p.effects) if e in named]
    for share in (-0.8, 0.8):
        point = begun.copy()
        point[own] = np.clip(share * p.sd[own], p.lower[own], p.upper[own])
        starts.append(point)
    return max(
        (Hypothetical(problem, named, size, fit(problem, prior, size, s, ROUNDS)) for s in starts), key=lambda h: -h.around.cost
    )


def case(place: int, true: Hypothesis) -> Prepared:
    """A blind case of the small sweep, tip alone."""
    built, _ = draw_robot(Recipe("bench", len(QUESTIONS), SEED, settled=True), place, "clean" if true else "none", true)
    walked = walk_of(SWEEP)
    readings = read(built, walked, respond(built, walked), np.random.default_rng([SEED, 7, place]))
    robot = described()
    return prepare(robot, states(Case(robot, design("tip").show(table_of(SWEEP, readings))))[0])


def nested(h: Hypothetical, live: int, seed: int) -> tuple[float, float, int]:
    """Log evidence by nested sampling, its standard error, and how often the model was asked."""
    from dynesty import NestedSampler

    sampler = NestedSampler(
        h.log_likelihood, h.prior, len(h.sampled), nlive=live, bound="multi", sample="unif",
        rstate=np.random.default_rng(seed),
    )  # fmt: skip
    sampler.run_nested(dlogz=0.05, print_progress=False)
    found = sampler.results
    return float(found.logz[-1]), float(found.logzerr[-1]), int(np.sum(found.ncall))


def main() -> int:
    """Print the table; 1 when an evidence is off by more than the target."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=4, help=f"at most {len(QUESTIONS)}")
    parser.add_argument("--live", type=int, default=150, help="live points of the sampler")
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    figures = []
    for place, question in enumerate(QUESTIONS[: a.cases]):
        p = case(place, question.true)
        for named in dict.fromkeys((NONE, question.true, (question.rival,))):
            h = hypothetical(p.problem, named, SIZE)
            began = time.perf_counter()
            sampled, error, calls = nested(h, a.live, SEED + place)
            figures.append(_figure(question, named, h, (sampled, error, calls), time.perf_counter() - began))
            print(figures[-1].name, figures[-1].measured, flush=True)
    return show("Log evidence: Laplace against nested sampling", figures, a.json)


def _figure(q: Question, named: Hypothesis, h: Hypothetical, found: tuple[float, float, int], seconds: float) -> Figure:
    sampled, error, calls = found
    off = h.laplace - sampled
    truth, asked = " + ".join(q.true) or "none", " + ".join(named) or "none"
    return Figure(
        f"truth {truth}: {asked}",
        f"within {TARGET} + 2 sd",
        f"Laplace {h.laplace:.2f}, sampled {sampled:.2f} +- {error:.2f}: {off:+.2f} ({calls} calls, {seconds:.0f} s)",
        abs(off) <= TARGET + 2 * error,
        {"laplace": h.laplace, "sampled": sampled, "sd": error, "off": off, "calls": calls, "parameters": len(h.sampled)},
    )


if __name__ == "__main__":
    raise SystemExit(main())
