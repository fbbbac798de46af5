"""Which rigid body of Motive is which of rig.yaml: by name, and only when name and number are there once."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from .packets import Definitions


class NotOne(ValueError):
    """A name that no body has, or a name or number that several have; the message says what to do."""


def found(names: Sequence[str], told: Definitions) -> dict[str, int]:
    """Numbers of the bodies with these names. Bodies of other names may be as they like."""
    ids: dict[str, int] = {}
    for name in names:
        numbers = [number for known, number in told.bodies if known == name]
        if not numbers:
            known = [name for name, _ in told.bodies]
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
            hint = f"the nearest name is {near[0]!r}" if near else "there are no rigid bodies at all"
            unread = f" ({'; '.join(told.unread)})" if told.unread else ""
            raise NotOne(f"no rigid body {name!r}; {hint}{unread}. Correct the name in rig.yaml or in Motive")
        if len(numbers) > 1:
            of = " and ".join(map(str, numbers))
            raise NotOne(f"several rigid bodies are named {name!r}: numbers {of}. Rename all but one in Motive")
        sharing = [known for known, number in told.bodies if number == numbers[0]]
        if len(sharing) > 1:
            of = " and ".join(map(repr, sharing))
            raise NotOne(f"rigid bodies {of} have the same streaming ID {numbers[0]}. Give each an ID of its own in Motive")
        ids[name] = numbers[0]
    return ids
