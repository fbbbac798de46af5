"""JSON from outside, which this room reads here alone: values of bounded depth, or a ValueError; numbers that JSON lacks."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from typing import Any

DEEPEST = 50
"""Lists and tables within each other; what this software writes has ten at most."""
_BRACKETS = re.compile(r'"(?:[^"\\]|\\.)*"?|[\[{]|[\]}]', re.DOTALL)
_HALF = re.compile(r"\\u[dD][89a-fA-F]")


def read_json(text: str | bytes) -> Any:
    """The values of a text; ValueError when it is no JSON, too deep, or holds halves of characters."""
    if isinstance(text, bytes):
        text = text.decode("utf-8")
    if text.count("[") + text.count("{") > DEEPEST:
        depth = 0
        for match in _BRACKETS.finditer(text):
            depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(match[0], 0)
            if depth > DEEPEST:
                raise ValueError(f"more than {DEEPEST} levels of nested lists and tables")
    values = json.loads(text)
    if _HALF.search(text):
        # Two halves that belong together are one character by now; one alone can be neither printed nor written.
        json.dumps(values, ensure_ascii=False).encode("utf-8")
    return values


class Plain:
    """A dataclass that becomes plain values."""

    def to_dict(self) -> dict[str, Any]:
        """Fields and properties as plain values for JSON."""
        itself: Any = self
        properties = [name for name, value in vars(type(self)).items() if isinstance(value, property)]
        return asdict(itself) | {name: getattr(self, name) for name in properties}


def plain_numbers(value: Any) -> Any:
    """The value with None for every number that is none (NaN, infinite): JSON knows none such."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [plain_numbers(item) for item in value]
    if isinstance(value, dict):
        return {key: plain_numbers(item) for key, item in value.items()}
    return value
