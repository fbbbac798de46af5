"""Labels of a run that a person gives: who ran it, which piece was mounted, and tags of the lab's own.

A metadata record `labels` of texts by name; `operator` and `specimen` are names like any other.
"""

from __future__ import annotations

from collections.abc import Sequence

from .. import events
from ..errors import BadMessage
from ..messages import NAME

RECORD = "labels"
LONGEST, MOST = 200, 50
"""Characters of a text, and texts of a run."""


def split(text: str) -> tuple[str, str]:
    """Name and text of KEY=VALUE; raises `BadMessage`."""
    name, found, value = text.partition("=")
    if not found or not NAME.fullmatch(name):
        raise BadMessage(
            f"{text[:80]!r}: write KEY=VALUE; the key has lower-case letters, digits and _, at most 30, and begins with a letter"
        )
    return name, value


def labels(pairs: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Checked texts by name; raises `BadMessage` for one that is empty, too long, or given twice."""
    texts: dict[str, str] = {}
    for name, text in pairs:
        if not text.strip() or len(text) > LONGEST:
            raise BadMessage(f"{name} = {text[:80]!r}: must have 1 to {LONGEST} characters, has {len(text)}")
        if events.writable(text) != text:
            raise BadMessage(f"{name} = {text[:80]!r}: is not UTF-8; set the terminal to UTF-8 and write it again")
        if name in texts:
            raise BadMessage(f"{name}: is given twice, as {texts[name]!r} and {text!r}")
        texts[name] = text
    if len(texts) > MOST:
        raise BadMessage(f"{len(texts)} labels are given, at most {MOST}")
    return texts
