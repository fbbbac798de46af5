"""Other methods name a clear cause of a clean toy problem, and nothing where nothing is; their answers can be scored."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.blind.answers import Answer, read_foreign
from benchmarks.blind.metrics import JudgedAnswer
from benchmarks.rivals.methods import alone, learned, predicted, sparse
from benchmarks.rivals.table import draw, row, table
from diagnosis.data.case import states
from diagnosis.inference.prepare import prepare
from tests.diagnosis.small_campaigns import SOME, measured
from tests.diagnosis.toy import toy_problem
from tests.docs.blocks import ROOT, blocks

METHODS = {"alone": alone, "sparse": sparse}


def published(found: dict[str, Any], place: Path) -> Answer:
    """An answer as the score reads it."""
    path = place / "0001.json"
    path.write_text(json.dumps(found))
    return read_foreign(path, "0001")


def test_the_form_that_the_page_shows_is_read(tmp_path: Path) -> None:
    (shown,) = (b.text for b in blocks(ROOT / "docs/howto/blind.md") if b.text.startswith("{"))
    answer = published(json.loads(shown), tmp_path)
    assert answer.effects == {"contact"} and answer.probability_of(answer.effects) == 0.8 and answer.none_probability == 0.2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("truth", [{"turned": 1.5}, {"stiffer": 1.5}, {}])
def test_a_clear_cause_is_named_and_none_where_there_is_none(method: str, truth: dict[str, float], tmp_path: Path) -> None:
    found = METHODS[method](toy_problem(3, truth))
    assert found["attribute"]["effects"] == list(truth)
    assert sum(r["probability"] for r in found["attribute"]["ranking"]) == pytest.approx(1.0, abs=1e-6)
    answer = published(found, tmp_path)
    assert answer.verdict == ("effect" if truth else "none") and 0.4 < answer.probability <= 1
    assert frozenset(truth) in answer.credible


def test_a_learned_residual_names_nothing_and_closes_a_gap_on_lengths_that_it_has_not_seen(tmp_path: Path) -> None:
    case = measured(2, 1, chamber_azimuth__angle=np.radians(8))
    answer = published(learned(prepare(case.robot, states(case)[0], catalogue=SOME)), tmp_path)
    assert answer.verdict == "none" and answer.probability == 0 and not answer.effects
    assert 0.5 < answer.share_closed <= 1.1


def test_a_process_learns_a_smooth_function_of_the_inputs_that_vary() -> None:
    x = np.column_stack([np.linspace(0, 1, 60), np.zeros(60)])
    missed = 1e-3 * np.column_stack([np.sin(3 * x[:, 0]), x[:, 0], 0 * x[:, 0]])
    seen = np.arange(60) % 3 > 0
    assert np.abs(predicted(x, missed, seen) - missed)[~seen].max() < 1e-4


def test_the_figures_count_what_they_say(tmp_path: Path) -> None:
    def judged(stratum: str, named: str, probability: float) -> JudgedAnswer:
        verdict = "effect" if named else "none"
        answer = Answer("1", verdict, frozenset([named] if named else []), probability, share_closed=0.5)
        return JudgedAnswer(stratum, frozenset(["contact"]), answer, {"contact": 5.0}, 1.0)

    cases = [judged("clean", "contact", 0.95), judged("cluttered", "", 0.6), judged("outside", "base_tilt", 0.99)]
    found = row("alone", cases, [1.0, 2.0, 9.0])
    counts = {column: (sum(own), len(own)) for column, own in found.cases.items()}
    assert counts == {"clean": (1, 1), "clutter": (0, 1), "all": (1, 2), "sure": (1, 2), "sure_right": (1, 1), "outside": (1, 1)}
    assert (found.seconds, found.closed, found.gaps) == (2.0, 0.5, 3)
    assert table([found]).row_count == 1
    assert draw([found], tmp_path / "figures.svg").read_text().startswith("<?xml")
