"""The one grammar of numbers in texts from outside: ASCII digits and a decimal point, no underscores."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

NUMBER = r"[-+]?(?:[0-9]++\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_TEXT = re.compile(rf"{NUMBER}|[-+]?(?:inf(?:inity)?|nan)", re.IGNORECASE)
_DIGITS = b"0123456789+-.eE"
_WHOLE = re.compile(r"[-+]?[0-9]{1,18}")


def number(text: str) -> float:
    """The number that a text is, inf and nan among them; raises ValueError.

    >>> number("-1.5e3")
    -1500.0
    """
    if not _TEXT.fullmatch(text := text.strip(" \t\r\n")):
        raise ValueError(f"{text[:80]!r} is not a number")
    return float(text)


def numbers(texts: Sequence[str]) -> list[float]:
    """The numbers of texts without blanks around them, NaN where one is empty; raises ValueError where any is none."""
    if "".join(texts).encode("ascii").translate(None, _DIGITS):  # of these alone `float` reads what `NUMBER` is
        raise ValueError("not a column of numbers")
    return [float(text) if text else math.nan for text in texts]


def whole_number(text: str) -> int:
    """The whole number that a text is; raises ValueError."""
    if not _WHOLE.fullmatch(text := text.strip(" \t\r\n")):
        raise ValueError(f"{text[:80]!r} is not a whole number")
    return int(text)
