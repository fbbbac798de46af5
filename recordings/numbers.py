"""The one grammar of numbers in texts from outside: ASCII digits and a decimal point, no underscores."""

from __future__ import annotations

import re

NUMBER = r"[-+]?(?:[0-9]++\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_TEXT = re.compile(rf"{NUMBER}|[-+]?(?:inf(?:inity)?|nan)", re.IGNORECASE)
_WHOLE = re.compile(r"[-+]?[0-9]{1,18}")


def number(text: str) -> float:
    """The number that a text is, inf and nan among them; raises ValueError.

    >>> number("-1.5e3")
    -1500.0
    """
    if not _TEXT.fullmatch(text := text.strip(" \t\r\n")):
        raise ValueError(f"{text[:80]!r} is not a number")
    return float(text)


def whole_number(text: str) -> int:
    """The whole number that a text is; raises ValueError."""
    if not _WHOLE.fullmatch(text := text.strip(" \t\r\n")):
        raise ValueError(f"{text[:80]!r} is not a whole number")
    return int(text)
