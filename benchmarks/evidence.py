"""Is the Laplace evidence right? `python -m benchmarks.evidence [--cases N] [--live N] [--json FILE]`.

Robots of the world `bench`, small campaigns (tip alone, loading alone), three hypotheses each: none, the true effect and a
rival. The diagnosis' log evidence of each beside that of a nested sampler (dynesty, J. S. Speagle, MNRAS 493, 2020), with
the same prior; what both share, and what only the sampler does in full, is told in `benchmarks.sampled`. Needs the extra
`check`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from dynesty import NestedSampler

from benchmarks.blind.make import described, table_of, walk_of
from benchmarks.blind.sweeps import Sweep, design
from benchmarks.blind.truth import Recipe, draw_robot
from benchmarks.blind.worlds.campaign import read, respond
from benchmarks.figures import Figure, show
from benchmarks.sampled import Hypothetical, hypothetical
from diagnosis.data.case import states
from diagnosis.inference.evidence import NONE, Hypothesis
from diagnosis.inference.prepare import Prepared, prepare
from lab.files.inputs import Case

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


def case(place: int, true: Hypothesis) -> Prepared:
    """A blind case of the small sweep, tip alone."""
    built, _ = draw_robot(Recipe("bench", len(QUESTIONS), SEED, settled=True), place, "clean" if true else "none", true)
    walked = walk_of(SWEEP)
    readings = read(built, walked, respond(built, walked), np.random.default_rng([SEED, 7, place]))
    robot = described()
    return prepare(robot, states(Case(robot, design("tip").show(table_of(SWEEP, readings))))[0])


def nested(h: Hypothetical, live: int, seed: int) -> tuple[float, float, int]:
    """Log evidence by nested sampling, its standard error, and how often the model was asked."""
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
        {
            "laplace": h.laplace,
            "sampled": sampled,
            "sd": error,
            "off": off,
            "calls": calls,
            "parameters": len(h.sampled),
        },
    )


if __name__ == "__main__":
    raise SystemExit(main())
