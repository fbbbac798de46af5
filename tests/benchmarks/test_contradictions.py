"""The rules that answers are held against: each finds its contradiction, and nothing in a sound answer."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.contradictions import RULES, main

SOUND: dict[str, Any] = {
    "statement": "Cause: contact (p = 0.97). With it, 1.00 mm remain on unseen states: 80 % of the reducible gap is closed. "
    "Also present: weight of the body [self_weight] 0.70 mm.",
    "attribute": {
        "verdict": "effect",
        "effects": ["contact"],
        "probability": 0.97,
        "credible_set": [["contact"]],
        "conclusion": "cause",
    },
    "budget": [
        {"effect": "contact", "role": "named"},
        {"effect": "self_weight", "role": "present"},
        {"effect": "time_offset", "role": "unseen"},
    ],
    "shrink": {"before_mm": 4.0, "after_mm": 1.0, "share_closed": 0.8},
    "waterfall": {"given_mm": 9.0, "steps": [{"mm": 5.0}, {"mm": 3.0}, {"mm": 1.0}]},
}
BROKEN: dict[str, list[tuple[str, Any]]] = {
    "named_and_doubted": [("statement", "Behaves most like contact; the data do not exclude self_weight.")],
    "conclusion_and_verdict": [("attribute.verdict", "unknown"), ("attribute.probability", 0.6)],
    "named_without_millimetres": [("budget", [{"effect": "self_weight", "role": "named"}])],
    "unseen_and_told": [("statement", "Cause: contact. Also present: delay [time_offset] 0.10 mm.")],
    "closed_and_worse": [("shrink.after_mm", 4.5)],
    "unexplained_and_closed": [("statement", "Closest: contact, which does not explain the gap.")],
    "steps_that_do_not_add_up": [("waterfall.given_mm", 9.5)],
    "credible_set_without_the_named": [("attribute.credible_set", [["self_weight"]])],
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_a_rule_finds_its_contradiction_and_passes_a_sound_answer(rule: Any) -> None:
    assert not rule(SOUND)
    answer = copy.deepcopy(SOUND)
    for path, value in BROKEN[rule.__name__]:
        *way, last = path.split(".")
        place = answer
        for key in way:
            place = place[key]
        place[last] = value
    assert rule(answer)


def test_answers_of_a_set_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "set" / "answers" / "0001"
    folder.mkdir(parents=True)
    (folder / "rounds.json").write_text(json.dumps([{"diagnosis": SOUND}, {"diagnosis": SOUND | {"waterfall": None}}]))
    assert main([tmp_path / "set"]) == 0
    assert "2 answers, 1 of them quick; 0 contradictions" in capsys.readouterr().out
