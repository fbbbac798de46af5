"""Naming a cause against learning the rest: on one robot, with few states."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks import residual
from benchmarks.residual import BEYOND, INSIDE, MODELS, learn, summary
from lab.blind.truth import Recipe, draw_one


def test_a_named_cause_reaches_farther_than_what_is_learnt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(residual, "LENGTHS_BY_PRESSURES", {30: (3, 4)})
    truth = draw_one(Recipe(1, 5, settled=True, only=("single",)), 0, "single", ("spine_shear",), "direct")
    found = learn(truth, 6)
    inside, beyond = (found.rms[30][where] for where in (INSIDE, BEYOND))
    assert set(inside) == set(MODELS)
    assert beyond["cause"] < 0.7 * beyond["residual"] and inside["residual"] < inside["calibrated"]
    other = replace(found, rms={30: {where: {**found.rms[30][where], "cause": 1.0} for where in (INSIDE, BEYOND)}})
    figures = summary([found, other])
    assert figures["robots"] == 2 and figures["30 beyond"]["cause_better"] == 0.5  # type: ignore[index]
