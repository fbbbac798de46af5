"""The page that a demo ends with, and the seal on the effect that it hid."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from diagnosis.answer.headline import for_people
from diagnosis.answer.result import Diagnosis
from diagnosis.answer.sentences import with_id
from model.compare import ErrorTable

from ..calibration import Calibration
from ..comparison import Comparison
from ..files.inputs import Case
from ..rig.losses import losses
from .diagnosis_report import fill, names, opened
from .figures import apart, stiffness_curves, story, tip_curves

SIZES = "The fakes' law differs from that of the catalogue, so the sizes need not agree."
"""Why what is found is not exactly what was withheld."""


@dataclass(frozen=True)
class Seal:
    """An effect and its size, and the digest that was shown before anything was measured."""

    effect: str
    size: float
    unit: str
    physics: str
    salt: str

    @property
    def amount(self) -> str:
        """The size as a person reads it."""
        number, unit = for_people(self.size, self.unit)
        return f"{number:.4g} {unit}".rstrip()

    @property
    def text(self) -> str:
        """What the digest is of."""
        return json.dumps({"effect": self.effect, "size": self.size, "salt": self.salt})

    @property
    def digest(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def write(
    folder: Path,
    case: Case,
    files: list[Path],
    fit: Calibration,
    compared: tuple[Comparison, Comparison],
    equal: bool,
    seal: Seal,
    answer: Diagnosis,
) -> Path:
    """The page with everything that was seen; `compared` with the paper's parameters, and with an area factor for each
    spine length."""
    before, after = compared
    report = opened("A day in the lab, without hardware", answer, case, files, folder / "next")
    found = report.section("What was withheld, and what was found")
    found.text(f"Withheld: {with_id(seal.effect, names(answer))} = {seal.amount}: {seal.physics}.")
    found.text(f"Found: {answer.headline} {SIZES}")
    found.text(f"Replayed from the files alone, {'every number is the same' if equal else 'numbers DIFFER'}.")
    found.text(f"The digest printed before the first measurement, sha256 {seal.digest}, is that of {seal.text}")
    fill(report, answer, case, folder / "next")
    paper = case.robot.spine.modulus if case.robot.spine else {}
    whole = report.section("In pictures", folded=True)
    whole.figure(
        apart(story(fit.spine_modulus, paper, before, after), folder / "story.svg"),
        "Stiffness, tip and error of this run.",
    )
    stiff = report.section("Stiffness of the spine", folded=True)
    stiff.figure(
        apart(stiffness_curves(case.of("stiffness"), fit.spine_modulus, paper), folder / "stiffness.svg"),
        "Force on the spine's tip over its deflection, and Young's modulus by eq. 9.",
    )
    bend = report.section("Bending: measured against the model with the paper's parameters", folded=True)
    bend.figure(apart(tip_curves(before), folder / "paper.svg"), "Marks: measured tip, loading and unloading. Lines: model.")
    bend.table(*_errors(before.table))
    fitted = report.section("With an area factor for each spine length", folded=True)
    fitted.figure(
        apart(tip_curves(after), folder / "by_length.svg"),
        "The same marks; the model with one chamber area per spine length.",
    )
    fitted.table(*_errors(after.table))
    fitted.table(
        ["spine", "A_eff / A", "standard error", "residual, mm rms"],
        [
            [f"{k * 100:.0f} cm", f"{a.factor.value:.3f}", f"{a.factor.standard_error:.3f}", f"{a.rmse * 1e3:.2f}"]
            for k, a in fit.area_factor_by_length.items()
        ],
    )
    said, head, rows = losses(files)
    report.section("What was recorded, and what was lost", folded=True, terms=False).text(said).table(head, rows)
    return report.write(folder / "report.html")


def _errors(table: ErrorTable) -> tuple[list[str], list[list[str]]]:
    head = ["spine", "states", "x (paper: X), mm", "z (paper: Y), mm", "y, mm", "rms, mm", "worst, mm"]
    rows = [
        [f"{r.spine_length * 100:.0f} cm", str(r.n)]
        + [f"{v * 1e3:.2f}" for v in (r.mean_abs_x, r.mean_abs_z, r.mean_abs_y, r.rmse, r.worst)]
        for r in table.rows
    ]
    return head, rows
