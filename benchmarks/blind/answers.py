"""What a diagnosis answered, read from its diagnosis.json without trusting it to be complete."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from diagnosis.judgement import CERTAIN
from lab.files.config import ConfigError

from .folder import read_table
from .truth import THRUST

HINT = "remove it and run `python -m benchmarks.blind run` again"

Effects = frozenset[str]


@dataclass(frozen=True)
class Answer:
    """One case's answer. Probabilities are those stated."""

    case: str
    verdict: str
    """effect, none, unknown, or failed."""
    effects: Effects
    probability: float
    ranking: tuple[tuple[Effects, float], ...] = ()
    """Hypotheses that name an effect, most probable first."""
    credible: tuple[Effects, ...] = ()
    """The 95 % set; the empty set stands for "none"."""
    none_probability: float = 0.0
    unknown_probability: float = 0.0
    share_closed: float = math.nan
    seconds: float = math.nan
    asked: tuple[str, ...] = ()
    error: str = ""
    budget: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """mm (low, high) that an effect is said to carry, by effect."""
    stage: str = ""
    """The stage of the chain that asks most for an error of its own; empty where none does."""
    settled_first: Effects = frozenset()
    """Conventions on which textbooks differ that were settled before a cause was looked for, and said in a note."""

    @property
    def settled(self) -> bool:
        """Whether `lab investigate` would ask for nothing more."""
        return self.verdict in ("effect", "none") and self.probability >= CERTAIN

    @property
    def best(self) -> Effects:
        """The most probable set of effects, whatever the verdict."""
        return self.ranking[0][0] if self.ranking else self.effects

    def probability_of(self, effects: Effects) -> float:
        """Stated probability that exactly these effects are on."""
        if not effects:
            return self.none_probability
        return sum(p for names, p in self.ranking if names == effects)


def read_answer(path: Path, case: str) -> Answer:
    """The last answer of a case. Raises ConfigError for a file that holds no rounds."""
    rounds = read_table(path, HINT)
    try:
        last = rounds[-1]
        return answer_from(case, last["diagnosis"], float(last["seconds"]), tuple(map(str, last["asked"])))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as e:
        raise ConfigError(f"{path}: holds no rounds of a diagnosis ({repr(e)[:200]}); {HINT}") from e


def read_foreign(path: Path, case: str) -> Answer:
    """The answer of another method: `attribute` with verdict, effects, probability and ranking, as in diagnosis.json.

    Raises ConfigError for a file that holds none.
    """
    hint = 'write {"attribute": {"verdict": .., "effects": [..], "probability": .., "ranking": [..]}}'
    found = read_table(path, hint)
    if not isinstance(found, Mapping) or not isinstance(found.get("attribute"), Mapping):
        raise ConfigError(f"{path}: holds no answer; {hint}")
    try:
        return answer_from(case, found)
    except (TypeError, ValueError, AttributeError) as e:
        raise ConfigError(f"{path}: holds no answer ({repr(e)[:200]}); {hint}") from e


def answer_from(case: str, d: Mapping[str, Any], seconds: float = math.nan, asked: tuple[str, ...] = ()) -> Answer:
    """The answer in a diagnosis.json; what it lacks counts as not known."""
    attribute = d.get("attribute")
    if not isinstance(attribute, dict):
        error = str(d.get("error", "no attribute section"))
        return Answer(case, "failed", frozenset(), 0.0, seconds=seconds, asked=asked, error=error)
    ranking, none, unknown = [], 0.0, 0.0
    for entry in attribute.get("ranking") or ():
        names, p = frozenset(entry.get("effects") or ()), _number(entry.get("probability"), 0.0)
        if names == {"unknown"}:
            unknown += p
        elif names in (frozenset(), {"none"}):
            none += p
        else:
            ranking.append((names, p))
    ranking.sort(key=lambda item: -item[1])
    verdict, p = str(attribute.get("verdict", "failed")), _number(attribute.get("probability"), 0.0)
    effects = frozenset(attribute.get("effects") or ()) if verdict == "effect" else frozenset()
    none = _number(attribute.get("none_probability"), none or (p if verdict == "none" else 0.0))
    unknown = _number(attribute.get("unknown_probability"), unknown or (p if verdict == "unknown" else 0.0))
    shrink = d.get("shrink") or {}
    return Answer(
        case, verdict, effects, p, tuple(ranking),
        tuple(frozenset(x) - {"none"} for x in attribute.get("credible_set") or ()),
        none, unknown, _number(shrink.get("share_closed")), seconds, asked,
        budget={str(x["effect"]): (_number(x.get("low95_mm")), _number(x.get("high95_mm")))
                for x in d.get("budget") or () if isinstance(x, Mapping) and "effect" in x},
        stage=next((str(x["stage"]) for x in attribute.get("stage_errors") or () if isinstance(x, Mapping)), ""),
        settled_first=frozenset({THRUST} if any(
            isinstance(f, Mapping) and f.get("code") == "thrust_settled" for f in d.get("findings") or ()) else ()),
    )  # fmt: skip


def _number(value: object, default: float = math.nan) -> float:
    return float(value) if isinstance(value, (int, float)) and abs(value) < 1e300 else default
