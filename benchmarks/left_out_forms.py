"""Is the temperature of the evidence fitted to the very forms of the laws on which it is judged?

    python -m benchmarks.left_out_forms SET [SET ..]

Sets of `lab blind make --world` that were answered, with their opened truth. For each form of a law, the temperature with which
the stated probabilities score best (log score) is fitted on the robots whose largest carrier has another form, and
judged on those left out; beside it the temperature that all robots together ask for, and the one that the diagnosis has. Only
probabilities among hypotheses of the catalogue are looked at; which of them leads depends on the temperature too.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.answer.verdict import SURE
from diagnosis.criticism.probability_calibration import CALIBRATED
from lab.blind.intervals import counted
from lab.blind.worlds.by_mm import right

TEMPERATURES = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0])
LEAST = 1e-3
"""Probability on right answers below which the log score does not count a robot any further."""
BINS = np.linspace(0.0, 1.0, 6)


@dataclass(frozen=True)
class Robot:
    """One robot: its hypotheses, and the form of the law of what carries most."""

    form: str
    stated: np.ndarray
    """(h,) probability with the temperature of the diagnosis, among hypotheses of the catalogue."""
    log_evidence: np.ndarray
    right: np.ndarray
    """(h,) by mm."""

    def at(self, temperature: float) -> np.ndarray:
        """(h,) probability with another temperature."""
        change = self.log_evidence * (1 / temperature - 1 / CALIBRATED.temperature)
        p = self.stated * np.exp(change - change.max())
        return np.asarray(p / p.sum())


def robots(folder: Path) -> list[Robot]:
    """The robots of a set whose cause is in the catalogue, or that have none."""
    found = []
    for truth in json.loads((folder / "sealed" / "truth.json").read_text())["truths"]:
        answer = folder / "answers" / truth["case"] / "rounds.json"
        if truth["stratum"].endswith("outside") or not answer.is_file():
            continue
        ranking = json.loads(answer.read_text())[-1]["diagnosis"]["attribute"]["ranking"]
        found.append(_robot(truth, [r for r in ranking if r["effects"] != ["unknown"]]))
    return found


def _robot(truth: Mapping[str, Any], ranking: Sequence[Mapping[str, Any]]) -> Robot:
    carries = truth["calibrated_mm"]
    most = max(carries, key=lambda e: carries[e], default="")
    form = (
        f"{most} {truth['forms'].get(most, 'as it is')}" if carries.get(most, 0) >= 2 * truth["floor_mm"] else "nothing"
    )
    stated = np.array([r["probability"] for r in ranking])
    return Robot(
        form, stated / stated.sum(), np.array([r["log_evidence"] for r in ranking]),
        np.array([right(r["effects"], carries, truth["floor_mm"]) for r in ranking]),
    )  # fmt: skip


def fitted(own: Sequence[Robot]) -> float:
    """The temperature with the best log score."""
    scores = [sum(float(np.log(max(r.at(t)[r.right].sum(), LEAST))) for r in own) for t in TEMPERATURES]
    return float(TEMPERATURES[int(np.argmax(scores))])


def figures(own: Sequence[Robot], temperature: Callable[[Robot], float]) -> list[str]:
    """Right by mm, stated with p > SURE and right, calibration error and log score."""
    each = [r.at(temperature(r)) for r in own]
    leads = [int(np.argmax(p)) for p in each]
    stated = np.array([p[i] for p, i in zip(each, leads, strict=True)])
    hit = np.array([r.right[i] for r, i in zip(own, leads, strict=True)], float)
    sure = stated > SURE
    place = np.clip(np.digitize(stated, BINS) - 1, 0, len(BINS) - 2)
    error = sum(abs((stated - hit)[place == k].sum()) for k in range(len(BINS) - 1)) / len(own)
    score = np.mean([np.log(max(p[r.right].sum(), LEAST)) for r, p in zip(own, each, strict=True)])
    return [counted(hit, "-"), f"{int(sure.sum())}; {counted(hit[sure], '-')}", f"{error:.2f}", f"{score:.2f}"]


def main(folders: Sequence[str]) -> None:
    """Print the table."""
    own = [r for folder in folders for r in robots(Path(folder))]
    forms = sorted({r.form for r in own})
    left_out = {form: fitted([r for r in own if r.form != form]) for form in forms}
    together = fitted(own)
    print(
        f"{len(own)} robots, {len(forms)} forms; temperatures fitted without a form: {sorted(set(left_out.values()))}\n"
    )
    print("| temperature | right by mm | stated with p > 0.9; right | calibration error | log score |")
    print("|---|---|---|---|---|")
    rows: list[tuple[str, Callable[[Robot], float]]] = [
        (f"the diagnosis' ({CALIBRATED.temperature:g})", lambda r: CALIBRATED.temperature),
        (f"fitted on all of them ({together:g})", lambda r: together),
        ("fitted without the form that is judged", lambda r: left_out[r.form]),
    ]
    for name, temperature in rows:
        print(f"| {name} | " + " | ".join(figures(own, temperature)) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])
