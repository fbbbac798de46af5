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
from diagnosis.inference.budget import budget, by_what_is_carried
from diagnosis.inference.candidate import Candidate
from diagnosis.inference.evidence import KNOWN, NONE, Hypothesis, weigh
from diagnosis.inference.posterior import posterior
from diagnosis.inference.prepare import prepare
from diagnosis.power.worlds import Planned, drawn
from lab.blind.workers import Crew, spread
from lab.blind.worlds.by_mm import right
from lab.files.inputs import read_case

Array = NDArray[np.float64]

TEMPERATURES = (1.0, 2.0, 4.0, 8.0)
CLUTTER = (0.05, 0.1, 0.2)


@dataclass(frozen=True)
class Weighed:
    """One world at one temperature."""

    case: str
    temperature: float
    stated: float
    right: bool


def candidates(d: Planned, y: Array, form_errors: dict[Hypothesis, Array]) -> Iterator[Candidate]:
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
    return judged(Planned.of(prepare(case.robot, states(case)[0])), worlds, seed, str(folder))


def judged(d: Planned, worlds: int, seed: int, name: str) -> list[Weighed]:
    """Worlds drawn under a design."""
    form_errors = {named: d.form_errors(named) for named in (NONE, *((e,) for e in d.effects))}
    rng, out = np.random.default_rng(seed), []
    for _ in range(worlds):
        world, done = drawn(d, rng, clutter=CLUTTER)
        amounts = {effect: d.floors(white) for effect, white in done.items()}
        tried = list(candidates(d, world.readings, form_errors))
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
