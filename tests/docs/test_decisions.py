"""Every decision that is referred to stands in docs/decisions.md, and each there is short."""

import re

import pytest

from tests.docs.blocks import ROOT, anchors
from tests.test_house import own_files

PAGE = ROOT / "docs/decisions.md"
MOST_WORDS = 60
"""Of the paragraph of one decision."""
HEADING = re.compile(r"^## (\d{3}) (.+)$", re.M)
REFERENCE = re.compile(r"\bdecisions?[\s#]+(\d{3}\b(?:(?:,|\s+and|,\s+and)[\s#]+\d{3}\b)*)", re.IGNORECASE)
"""One number or several, also across the end of a line or of a comment's line."""
ANCHOR = re.compile(r"decisions\.md#([\w-]*)")


def referred(text: str) -> list[str]:
    """The numbers of all decisions that a text refers to."""
    return [number for found in REFERENCE.findall(text) for number in re.findall(r"\d{3}", found)]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("see decision 072.", ["072"]),
        ("(decisions 003, 010 and 012)", ["003", "010", "012"]),
        ("    # as decided (decision\n    # 034)", ["034"]),
        ("Decision 1000 and a decision of 300 words", []),
    ],
)
def test_references_are_found_however_they_are_written(text: str, numbers: list[str]) -> None:
    assert referred(text) == numbers


def test_every_decision_that_is_referred_to_exists() -> None:
    known = dict(HEADING.findall(PAGE.read_text(encoding="utf-8")))
    found = [f"{name}: decision {n}" for name, text in own_files(__file__).items() for n in referred(text) if n not in known]
    assert found == []


def test_every_link_to_a_decision_meets_its_heading() -> None:
    known = anchors(PAGE)
    found = [f"{name}#{a}" for name, text in own_files(__file__).items() for a in ANCHOR.findall(text) if a not in known]
    assert found == []


def test_decisions_are_in_order_and_short() -> None:
    _, *parts = HEADING.split(PAGE.read_text(encoding="utf-8"))
    numbers, paragraphs = parts[::3], parts[2::3]
    assert numbers == sorted(set(numbers))
    long = {n: len(p.split()) for n, p in zip(numbers, paragraphs, strict=True) if len(p.split()) > MOST_WORDS}
    assert long == {}
    assert [n for n, p in zip(numbers, paragraphs, strict=True) if "\n\n" in p.strip()] == []
