"""Terms of the reports, from glossary.yaml, which docs/glossary.md is made of too: pages link the first use to its meaning."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import yaml


@dataclass(frozen=True)
class Term:
    """A term, words with the same meaning separated by commas, its unit, and what it means."""

    text: str
    unit: str
    meaning: str

    @property
    def heading(self) -> str:
        """Term and unit."""
        return f"{self.text} [{self.unit}]" if self.unit else self.text

    @property
    def words(self) -> tuple[str, ...]:
        """What a reader may meet."""
        return tuple(self.text.split(", "))


def _terms() -> tuple[Term, ...]:
    found: dict[str, str] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    parts = ((re.fullmatch(r"(.*?)(?: \[(.*)\])?", heading), meaning) for heading, meaning in found.items())
    return tuple(Term(part[1], part[2] or "", meaning) for part, meaning in parts if part is not None)


TERMS = _terms()
"""In the order of the alphabet."""
