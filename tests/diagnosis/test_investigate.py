"""The loop of diagnosis and experiment: what is chosen, predicted, done and judged."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from diagnosis.answer.experiments import columns
from diagnosis.answer.result import Proposal
from diagnosis.diagnose import Options
from diagnosis.investigate import NotDone, Predicted, Round, bits_gained, investigate, settled
from diagnosis.judgement import CERTAIN, DOUBTED_PROBABILITY
from model.effects import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.scales import scales
from recordings.trials import TrialRow
from tests.diagnosis.small_campaigns import FEW, examined_once, measured
from tests.diagnosis.test_case import ROBOT, Measured, case

CAUSE_PROBABILITY = "chamber_ballooning"
SIZE = 0.3
TIED = ("chamber_ballooning", "pressure_offset", "body_modulus", "base_tilt")
OPTIONS = Options(quantify=False, catalogue={e: CATALOGUE[e] for e in TIED})


def loading(seed: int) -> Measured:
    """A short campaign on the way up, one noisy repeat of two pressures: too little to name the cause."""
    whole = measured(2, seed, FEW, chamber_ballooning__growth=SIZE)
    top = max(max(r.pressures) for r in whole.table)
    rows = [r for r in whole.table if r.branch == "load" and (max(r.pressures) > 0.9 * top or max(r.pressures) < 1e3)]
    return case(rows)


@dataclass
class Made:
    """A laboratory whose robot is the model's, with the cause in it."""

    start: Measured
    refuse: Callable[[Proposal], str] = lambda _: ""
    shifted: float = 0.0
    """m, of all that is read from now on."""
    asked: list[Predicted] = field(default_factory=list)
    rows: list[TrialRow] = field(default_factory=list)

    def refusal(self, proposal: Proposal) -> str:
        return self.refuse(proposal)

    def perform(self, predicted: Predicted) -> Measured:
        self.asked.append(predicted)
        self.rows += self._read(predicted.proposal)
        return case([*self.start.table.rows, *self.rows])

    def _read(self, proposal: Proposal) -> Sequence[TrialRow]:
        table = columns(proposal.protocol, 9, ("x", "y", "z"))
        pressures = np.array([r.pressures for r in self.start.table])  # the cause is that of the start, whatever is asked next
        design, sized = design_from_columns(ROBOT, table), scales(ROBOT, pressures)
        forward = ForwardModel(ROBOT, design, "one", OPTIONS.catalogue, sized=sized)
        theta = np.zeros(len(forward.parameters))
        theta[forward.index(CAUSE_PROBABILITY)[0]] = SIZE
        values = forward.predict(theta)
        rng = np.random.default_rng(len(self.rows))
        before = max(r.trial for r in [*self.start.table.rows, *self.rows])
        out = []
        for i in range(len(table["trial"])):
            tip = values[forward.observations.row == i] + 0.3e-3 * rng.standard_normal(3) + self.shifted
            cells = {name: column[i].item() for name, column in table.items() if name not in ("x", "y", "z")}
            cells |= dict(zip("xyz", tip.tolist(), strict=True)) | {"step": i + 1, "trial": int(cells["trial"]) + before}
            out.append(TrialRow.from_cells(cells))
        return out


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All begin with the same campaign, which is diagnosed once."""
    monkeypatch.setattr("diagnosis.investigate.examine", examined_once)


def test_the_cause_becomes_clear_and_every_prediction_was_there_before() -> None:
    start, rounds = loading(1), list[Round]()
    laboratory = Made(start)
    found = investigate(start, laboratory, OPTIONS, 120.0, 2, rounds.append)
    assert not settled(rounds[0].diagnosis) and len(laboratory.asked) >= 1
    assert found.answer.attribute.effects == (CAUSE_PROBABILITY,) and found.answer.attribute.probability >= DOUBTED_PROBABILITY
    for r, predicted in zip(found.rounds, laboratory.asked, strict=False):
        assert r.predicted is predicted and predicted.proposal in r.diagnosis.next_experiment
        states = len(columns(predicted.proposal.protocol, 9, ())["trial"])
        assert predicted.rivals and all(len(x.tip_mm) == len(x.sd_mm) == states for x in predicted.rivals)
        assert predicted.telling in range(states)
        right = [j for j in r.judged if j.effects == (CAUSE_PROBABILITY,)]
        assert not r.unforeseen and all(not j.failed and j.rms_mm < 2.0 for j in right)
        assert max(j.bits for j in r.judged) == 0.0 and r.bits >= 0.0
    assert [r.minutes for r in found.rounds] == sorted(r.minutes for r in found.rounds)
    assert [r.diagnosis for r in rounds] == [r.diagnosis for r in found.rounds]
    told = found.to_dict()
    assert told["schema"] == "investigation/1" and len(told["rounds"]) == len(laboratory.asked) + 1


def test_what_is_refused_or_too_long_is_not_done_and_told_why() -> None:
    start = loading(1)
    none = Made(start, refuse=lambda p: f"no {p.id} here")
    found = investigate(start, none, OPTIONS, 120.0, 3)
    assert not none.asked and found.ended == "no further possible experiment is expected to be informative"
    refused = found.rounds[-1].refused
    assert refused and all(why == f"no {id} here" for id, why in refused.items())
    assert set(refused) <= {p.id for p in found.answer.next_experiment}
    soon = investigate(start, Made(start), OPTIONS, 0.5, 3)
    assert all("0 are left" in why or "1 are left" in why for why in soon.rounds[-1].refused.values())


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Measured:
    """The campaign, whose answer also stands for that after an experiment, at which the test does not look."""
    start = loading(1)
    monkeypatch.setattr("diagnosis.investigate.examine", lambda case, options: examined_once(start, options))
    return start


def test_one_that_cannot_be_done_after_all_makes_room_for_the_next(start: Measured) -> None:
    laboratory = Made(start)
    perform, tried = laboratory.perform, list[str]()

    def broken(predicted: Predicted) -> Measured:
        tried.append(predicted.proposal.id)
        if len(tried) == 1:
            raise NotDone("the door is locked")
        return perform(predicted)

    laboratory.perform = broken  # type: ignore[method-assign]
    found = investigate(start, laboratory, OPTIONS, 120.0, 1)
    assert len(tried) == 2 and tried[0] != tried[1]
    assert found.rounds[0].refused == {tried[0]: "the door is locked"} and found.ended == "1 experiments were done"


def test_what_no_rival_predicted_is_told(start: Measured) -> None:
    found = investigate(start, Made(start, shifted=0.05), OPTIONS, 120.0, 1)
    assert found.rounds[0].unforeseen and all(j.failed for j in found.rounds[0].judged)


@pytest.mark.parametrize(("verdict", "p", "is_settled"), [
    ("effect", CERTAIN, True), ("none", 0.99, True), ("effect", 0.94, False), ("unknown", 0.99, False),
])  # fmt: skip
def test_settled_is_a_known_answer_of_high_probability(verdict: str, p: float, is_settled: bool) -> None:
    d = examined_once(loading(1), OPTIONS).diagnosis
    assert settled(replace(d, attribute=replace(d.attribute, verdict=verdict, probability=p))) == is_settled  # type: ignore[arg-type]


def test_bits_are_those_from_one_ranking_to_the_next() -> None:
    d = examined_once(loading(1), OPTIONS).diagnosis
    first, second = d.attribute.ranking[:2]
    even = replace(d.attribute, ranking=(replace(first, probability=0.5), replace(second, probability=0.5)))
    sure = replace(d.attribute, ranking=(replace(first, probability=1.0), replace(second, probability=0.0)))
    assert bits_gained(replace(d, attribute=even), replace(d, attribute=sure)) == pytest.approx(1.0)
    assert bits_gained(d, d) == pytest.approx(0.0, abs=1e-9)
