"""The page of a diagnosis of stiffness trials alone, which has no tip to show."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from diagnosed_case import ROBOT, folder

from lab.cli import main
from model.effects import ForwardModel, design_from_columns
from recordings.trials import Cell, TrialRow

pytestmark = pytest.mark.usefixtures("drawn")

LENGTHS, STEPS, REPEATS = (0.05, 0.15, 0.3), 4, 3
BIAS, NOISE = 0.15, 0.01
"""N."""
SECTIONS = [
    "The answer in full",
    "The gap, step by step", "What to do next", "Evidence: which cause", "What speaks against the answer",
    "How large the cause is", "The gap by spine length, pressure, branch and time", "Stiffness trials",
    "Stages and misfit diagnostics", "Terms",
]  # fmt: skip


def pushed() -> list[TrialRow]:
    """Deflections up to 2 % of the length of three bare spines, of which the sensor reads too much."""
    cells: list[dict[str, Cell]] = [
        {
            "trial": 1 + len(LENGTHS) * repeat + i, "step": step, "protocol": "stiffness", "repeat": repeat + 1,
            "branch": "load", "t": 100.0 * (len(LENGTHS) * repeat + i) + step, "rate": 0.0, "hold": 1.0,
            "spine_length": length, "vacuum": 80e3, "specimen": "spine", "force": 0.0,
            "deflection": 0.02 * length * step / STEPS, **{f"p{c}": 0.0 for c in range(1, 10)},
        }
        for repeat in range(REPEATS)
        for i, length in enumerate(LENGTHS)
        for step in range(1, STEPS + 1)
    ]  # fmt: skip
    forward = ForwardModel(ROBOT, design_from_columns(ROBOT, {k: np.array([c[k] for c in cells]) for k in cells[0]}))
    force = forward.predict(np.zeros(len(forward.parameters)))
    read = force + BIAS + NOISE * np.random.default_rng(1).normal(size=len(force))
    return [TrialRow.from_cells({**c, "force": float(f)}) for c, f in zip(cells, read, strict=True)]


def test_stiffness_trials_alone_make_a_page_of_what_they_can_show(tmp_path: Path) -> None:
    case, page, answer = folder(tmp_path / "case", pushed()), tmp_path / "page.html", tmp_path / "answer.json"
    assert main(["diagnose", str(case), "--report", str(page), "--json", str(answer)]) == 0
    text, told = page.read_text(), json.loads(answer.read_text())
    assert told["locate"]["of"] == "deflection" and told["attribute"]["effects"] == ["force_bias"]
    assert re.findall(r"<h2>([^<]+)</h2>", text) == SECTIONS
    assert text.count("<figure>") == 4
    assert "Error of the deflection, mm rms" in text and "Tip error" not in text
