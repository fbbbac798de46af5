"""Do answers contradict themselves? `python -m benchmarks.contradictions SET|FILE.json [..]`

Takes the answers of blind sets (folders that `lab blind run` has filled) and files of `lab diagnose --json`, and holds each
against rules: its sentences against its typed fields, and its fields against each other. Prints how many answers were seen,
how many of them were quick (without steps of the gap), and each contradiction. Exit code 1 if there is one.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from diagnosis.answer.sentences import EXPLAINS
from diagnosis.answer.verdict import SURE

Answer = dict[str, Any]
SAME = 1e-6
"""mm by which numbers that must add up may differ."""


def named_and_doubted(a: Answer) -> bool:
    """Named with p of at least .9, and yet others are not excluded, or no cause is named."""
    own = a["attribute"]
    sure = own["verdict"] == "effect" and own["probability"] >= SURE
    return sure and (own["conclusion"] != "cause" or "do not exclude" in a["statement"])


def conclusion_and_verdict(a: Answer) -> bool:
    """The conclusion names a cause where the verdict does not, or says that none is known where it does."""
    own = a["attribute"]
    return (own["conclusion"] in ("cause", "one of several")) != (own["verdict"] == "effect")


def named_without_millimetres(a: Answer) -> bool:
    """A named effect that the budget does not name, or one there that is not named."""
    if not a["budget"] or a["attribute"]["verdict"] != "effect":
        return False
    return {c["effect"] for c in a["budget"] if c["role"] == "named"} != set(a["attribute"]["effects"])


def unseen_and_told(a: Answer) -> bool:
    """An effect that cannot be seen in the data is said to be present."""
    _, _, told = a["statement"].partition("Also present: ")
    return any(c["role"] == "unseen" and f"[{c['effect']}]" in told for c in a["budget"] or ())


def closed_and_worse(a: Answer) -> bool:
    """A share of the gap is said to be closed where the prediction got worse."""
    s = a["shrink"]
    return bool(s) and "reducible gap is closed" in a["statement"] and not s["after_mm"] < s["before_mm"]


def unexplained_and_closed(a: Answer) -> bool:
    """Said not to explain the gap, and half of it is closed."""
    s = a["shrink"]
    return bool(s) and "does not explain" in a["statement"] and (s["share_closed"] or 0.0) >= EXPLAINS


def steps_that_do_not_add_up(a: Answer) -> bool:
    """The steps of the gap do not sum to the uncalibrated gap."""
    w = a["waterfall"]
    return bool(w) and abs(sum(s["mm"] for s in w["steps"]) - w["given_mm"]) > SAME


def credible_set_without_the_named(a: Answer) -> bool:
    """The 95 % set leaves out what is named."""
    own = a["attribute"]
    sets = [tuple(s) for s in own["credible_set"]]
    return own["verdict"] == "effect" and own["probability"] >= SURE and tuple(own["effects"]) not in sets


RULES: tuple[Callable[[Answer], bool], ...] = (
    named_and_doubted,
    conclusion_and_verdict,
    named_without_millimetres,
    unseen_and_told,
    closed_and_worse,
    unexplained_and_closed,
    steps_that_do_not_add_up,
    credible_set_without_the_named,
)


def answers(places: list[Path]) -> Iterator[tuple[str, Answer]]:
    """Name and answer."""
    for place in places:
        if place.is_file():
            yield str(place), json.loads(place.read_text(encoding="utf-8"))
        for file in sorted(place.glob("answers/*/rounds.json")):
            for k, made in enumerate(json.loads(file.read_text(encoding="utf-8"))):
                yield f"{place.name} {file.parent.name} after {k}", made["diagnosis"]


def main(places: list[Path]) -> int:
    """Print the contradictions."""
    seen = quick = broken = 0
    for name, answer in answers(places):
        seen, quick = seen + 1, quick + (answer["waterfall"] is None)
        for rule in RULES:
            if rule(answer):
                broken += 1
                print(f"{name}: {rule.__doc__}\n  {answer['statement']}")
    print(f"{seen} answers, {quick} of them quick; {broken} contradictions")
    return 1 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main([Path(word) for word in sys.argv[1:]]))
