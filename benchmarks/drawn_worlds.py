"""Are stated probabilities honest under the design of a case? Worlds drawn under it, weighed as the case is weighed.

Linear about the calibrated robot, y = A theta + N u + g D w + sum_e f_e r_e o (B z_e) + e, as in `diagnosis.inference.linear`:
at most one cause at 0.5 to 1.5 plausible scales; every other effect in clutter, heavy-tailed; each law wrong by a smooth share
f_e of what its effect does there, r_e = A_e theta_e; the rest as the prior has it. Truth is in mm after calibration, law error
included. Each world is weighed under none and every single effect, named as a case is by what is carried, and judged right by
mm, at several temperatures. The temperature at which stated and right agree is the one that this design asks for.

Not drawn: pairs, causes outside the catalogue, and what is not linear.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from diagnosis.answer.verdict import SURE
from diagnosis.data.case import states
from diagnosis.inference.budget import Part, budget, by_what_is_carried, carried, parts
from diagnosis.inference.evidence import KNOWN, NONE, SPIKES, Hypothesis, weigh
from diagnosis.inference.linear import Linear
from diagnosis.inference.posterior import PRIOR_SHARES, posterior
from diagnosis.inference.prepare import Prepared, prepare
from diagnosis.inference.problem import Problem, leading
from diagnosis.inference.search import Candidate, Search
from lab.blind.workers import Crew, spread
from lab.blind.worlds.by_mm import right
from lab.files.inputs import read_case

Array = NDArray[np.float64]

TEMPERATURES = (1.0, 2.0, 4.0, 8.0)
CAUSE = (0.5, 1.5)
CLUTTER = (0.05, 0.1, 0.2)
FREEDOM = 3
"""Degrees of freedom of Student's t, of the clutter."""
TOLERATED = float(SPIKES[SPIKES > 0].mean())
LEAST = 1.0
"""Length of a whitened response below which an effect cannot be drawn."""


@dataclass(frozen=True)
class Weighed:
    """One world at one temperature."""

    case: str
    temperature: float
    stated: float
    right: bool


@dataclass(frozen=True)
class Design:
    """The linear problem of a case, without any effect."""

    problem: Problem
    none: Candidate
    where: tuple[Part, ...]
    effects: tuple[str, ...]
    """That can be drawn."""

    @classmethod
    def of(cls, prepared: Prepared) -> Design:
        """Of a campaign."""
        none = next(c for c in Search(prepared.problem).tried if not c.with_tolerances)
        p, columns = prepared.problem.parameters, none.fit.linear.effects
        seen = [e for e in p.ids if (columns[:, p.mask((e,)) & p.sizes] ** 2).sum() > LEAST]
        return cls(prepared.problem, none, parts(prepared), tuple(seen))

    @property
    def linear(self) -> Linear:
        """Around the calibrated robot."""
        return self.none.fit.linear

    def sizes(self, effect: str) -> NDArray[np.intp]:
        """Its parameters that are sizes."""
        p = self.problem.parameters
        return np.flatnonzero(p.mask((effect,)) & p.sizes)

    def floors(self, white: Array) -> float:
        """Noise floors that a whitened response (n,) carries after calibration."""
        done = self.problem.noise.colour(white)[:, None]
        squares = carried(self.problem, self.where, self.none.fit.slope, done)
        return max(float(np.sqrt(s[0, 0])) / part.floor for s, part in zip(squares, self.where, strict=True))

    def form_errors(self, named: Hypothesis) -> Array:
        """Columns of what may be wrong with the laws: of what is named at its plausible scale, of all else at its tolerance."""
        columns = []
        for effect in self.effects:
            own = self.sizes(effect)
            size = 1 / np.sqrt(len(own)) if effect in named else TOLERATED
            size *= self.problem.parameters.law_error[effect]
            columns += [size * self.linear.effects[:, j] for j in own]
        return leading(np.hstack([self.problem.form_error_of(self.problem.noise.colour(c)) for c in columns]))


def drawn(d: Design, rng: np.random.Generator) -> tuple[Array, dict[str, float]]:
    """Readings (n,), whitened, of one world, and the noise floors that each effect carries in it."""
    linear, p, noise = d.linear, d.problem.parameters, d.problem.noise
    y = rng.standard_normal(len(linear.observed)) + linear.nuisance @ rng.standard_normal(linear.nuisance.shape[1])
    size = rng.choice(KNOWN.sizes, p=KNOWN.size_weights)
    y += size * (linear.discrepancy @ rng.standard_normal(linear.discrepancy.shape[1]))
    cause = "" if rng.random() < PRIOR_SHARES[0] else str(rng.choice(d.effects))
    clutter, amounts = rng.choice(CLUTTER), {}
    basis = d.problem.form_error_basis
    for effect in d.effects:
        own = d.sizes(effect)
        way = rng.standard_normal(len(own))
        way /= np.linalg.norm(way)
        beside = clutter * rng.standard_t(FREEDOM) / np.sqrt(FREEDOM / (FREEDOM - 2))
        theta = way * (rng.uniform(*CAUSE) if effect == cause else beside)
        theta = np.where(p.low[own] >= 0, np.abs(theta), np.where(p.high[own] <= 0, -np.abs(theta), theta))
        done = noise.colour(linear.effects[:, own] @ theta)
        wrong = p.law_error[effect] * rng.choice(KNOWN.form_errors) * (basis @ rng.standard_normal(basis.shape[1]))
        white = noise.whiten(done * (1 + wrong))
        amounts[effect] = d.floors(white)
        y += white
    return y, amounts


def candidates(d: Design, y: Array, form_errors: dict[Hypothesis, Array]) -> Iterator[Candidate]:
    """None and every single effect, without and with tolerances, weighed for readings (n,)."""
    for named, columns in form_errors.items():
        linear = replace(d.linear, observed=y, form_error=columns)
        for with_tolerances in (False, True):
            grid = KNOWN.part(with_tolerances)
            (found,) = weigh(linear, grid, d.problem.parameters, [named])
            yield Candidate(named, found, d.none.fit, found.peak(grid), with_tolerances)


def judged_folder(worlds: int, seed: int, folder: Path) -> list[Weighed]:
    """Worlds drawn under the design of a case folder."""
    case = read_case([folder])
    return judged(Design.of(prepare(case.robot, states(case)[0])), worlds, seed, str(folder))


def judged(d: Design, worlds: int, seed: int, name: str) -> list[Weighed]:
    """Worlds drawn under a design."""
    form_errors = {named: d.form_errors(named) for named in (NONE, *((e,) for e in d.effects))}
    rng, out = np.random.default_rng(seed), []
    for _ in range(worlds):
        y, amounts = drawn(d, rng)
        tried = list(candidates(d, y, form_errors))
        for temperature in TEMPERATURES:
            whole = posterior([c for c in tried if c.with_tolerances], len(d.effects), temperature)
            found = by_what_is_carried(budget(d.problem, d.where, tried, temperature), whole)
            named, stated = found.ranking[0]
            out.append(Weighed(name, temperature, stated, right(named, amounts, 1.0)))
    return out


def table(found: Sequence[Weighed]) -> Table:
    """Stated beside right, by temperature."""
    shown = Table(title="Worlds drawn under the design of the case", title_justify="left")
    for column in ("case", "temperature", "worlds", "stated", "right", "p > 0.9: right", "log score"):
        shown.add_column(column)
    for case in dict.fromkeys(w.case for w in found):
        for temperature in TEMPERATURES:
            own = [w for w in found if (w.case, w.temperature) == (case, temperature)]
            p = np.clip([w.stated for w in own], 0.01, 0.99)
            ok = np.array([w.right for w in own])
            sure = p > SURE
            score = np.where(ok, np.log(p), np.log(1 - p)).mean()
            shown.add_row(
                case, f"{temperature:g}", str(len(own)), f"{p.mean():.2f}", f"{ok.mean():.2f}",
                f"{ok[sure].sum()} of {sure.sum()}", f"{score:.2f}",
            )  # fmt: skip
    return shown


def main() -> int:
    """Draw, weigh, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="+", type=Path, metavar="CASE", help="case folders")
    parser.add_argument("--worlds", type=int, default=60, help="of each case")
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    do = partial(judged_folder, a.worlds, a.seed)
    found = [w for each in spread(do, a.cases, Crew(a.workers), "worlds") for w in each]
    Console(highlight=False).print(table(found))
    if a.json is not None:
        a.json.write_text(json.dumps([asdict(w) for w in found], indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
