"""Open the seal, compare, and write the figures as JSON."""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lab.files.config import ConfigError
from recordings.own_files import replaced

from .answers import Answer, read_answer, read_foreign
from .folder import SetFolder, open_seal
from .metrics import JudgedAnswer, Metric, judged, metrics, mm_metrics


@dataclass(frozen=True)
class Target:
    """At least `low`, at most `high`."""

    low: float | None = None
    high: float | None = None

    def met(self, value: float) -> bool:
        """Whether the value lies within."""
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    def __str__(self) -> str:
        if self.low is not None and self.high is not None:
            return f"{self.low:g}..{self.high:g}"
        return f">= {self.low:g}" if self.low is not None else f"<= {self.high:g}"


def targets(about: dict[str, Any], after: int) -> dict[str, Target]:
    """By metric, for a set as its commitment describes it, with `after` experiments chosen by the diagnosis."""
    design, cluttered = str(about.get("design", "full")), float(about.get("clutter", 0)) > 0
    found = {
        "coverage": Target(0.93, 0.98),
        "ece": Target(high=0.04),
        "failed": Target(high=0.0),
        "false_alarm": Target(high=0.05 if cluttered else 0.01),
        "closed": Target(low=0.85 if cluttered else 0.95),
        "outside_named": Target(high=0.10),
        "flagged_at_10": Target(low=0.75 if cluttered else 0.90),
        "detected": Target(low=0.95),
    }
    if design == "tip":
        found["coverage"] = Target(low=0.95) if cluttered else Target(0.93, 0.98)
        found["top1"] = Target(low=0.65 if cluttered else 0.88)
        del found["detected"]
        return found
    found |= {"set_size": Target(high=2.5)}
    if cluttered:
        found |= {
            "top1": Target(low=0.93 if after else 0.90),
            "p_truth": Target(low=0.85),
            "sure_right": Target(low=0.97),
            "sure_share": Target(low=0.60),
        }
    else:
        found |= {
            "top1": Target(low=0.98),
            "pair_both": Target(low=0.95),
            "pair_exact": Target(low=0.80),
            "pair_spurious": Target(high=0.15),
        }
    return found


@dataclass(frozen=True)
class Score:
    """A set's figures."""

    name: str
    about: dict[str, Any]
    after: int
    """Experiments that the diagnosis had chosen and was given, at most."""
    cases: tuple[JudgedAnswer, ...]
    figures: tuple[Metric, ...]
    aims: dict[str, Target]

    @property
    def shortfalls(self) -> list[tuple[Metric, Target]]:
        """Figures that miss their target."""
        return [
            (m, self.aims[m.key])
            for m in self.figures
            if m.key in self.aims and m.found.n and not self.aims[m.key].met(m.found.value)
        ]

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "schema": "blind-score/1",
            "set": self.name,
            "about": self.about,
            "after_chosen_experiments": self.after,
            "figures": [
                {"key": m.key, "label": m.label, **_finite(asdict(m.found)),
                 "target": str(self.aims[m.key]) if m.key in self.aims else None,
                 "met": self.aims[m.key].met(m.found.value) if m.key in self.aims and m.found.n else None}
                for m in self.figures
            ],
            "cases": [_case(c) for c in self.cases],
        }  # fmt: skip


def score(root: Path, others: Path | None = None) -> Score:
    """Open the seal of a set and score its answers, the last of each case; with `others` those of another method, a file
    CASE.json in that folder for each case.

    Raises ConfigError when a case has no answer, or the seal is not the one that was committed to.
    """
    folder = SetFolder(root)
    about = folder.public()
    at = {n: folder.answers(n) / "rounds.json" if others is None else others / f"{n}.json" for n in folder.names()}
    missing = [name for name, path in at.items() if not path.exists()]
    if missing:
        remedy = "run `python -m benchmarks.blind run` first" if others is None else f"write {others}/CASE.json for each"
        raise ConfigError(
            f"{root}: {len(missing)} of {len(at)} cases have no answer ({', '.join(missing[:5])} ..); "
            f"the seal stays closed, {remedy}"
        )
    read = read_answer if others is None else read_foreign
    answers: dict[str, Answer] = {name: read(path, name) for name, path in at.items()}
    truth = open_seal(folder)
    cases = tuple(judged(truth[name], answers[name]) for name in sorted(answers))
    chosen = max((len(a.asked) for a in answers.values()), default=0)
    name = root.name if others is None else f"{root.name}, {others.name}"
    return Score(name, about, chosen, cases, tuple(metrics(cases) + mm_metrics(cases)), targets(about, chosen))


def write(result: Score, root: Path, others: Path | None = None) -> Path:
    """score.json in the set's folder, or that of other answers; the set's own also marks the seal as opened."""
    own = SetFolder(root).score
    place = own if others is None else others / own.name
    data = json.dumps({**result.as_dict(), "opened": time.strftime("%Y-%m-%d %H:%M:%S")}, indent=1) + "\n"
    for path in {place, place if own.exists() else own}:
        replaced(path, data)
    return place


def _case(c: JudgedAnswer) -> dict[str, Any]:
    a = c.answer
    return {
        "case": a.case, "kind": c.kind, "truth": sorted(c.causes), "verdict": a.verdict, "named": sorted(a.effects),
        "probability": a.probability, "probability_on_truth": c.probability_on_truth, "right": c.exact,
        "top1": c.first, "covered": c.covered, "asked": list(a.asked), "error": a.error,
        **_finite({"seconds": a.seconds, "share_closed": a.share_closed}),
    }  # fmt: skip


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
