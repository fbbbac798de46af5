"""What may be wrong with a model, as a person or a part of `model` states it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Cause:
    """Something that may be wrong: parameters of the model that are nominal unless this is the cause."""

    name: str
    parameters: Mapping[str, Sequence[Any]]
    """Name -> (nominal, plausible size, unit), perhaps with two bounds (.., low, high)."""
    stage: str = "structure"
    """Where it enters: actuation, measurement, or another word."""
    says: str = ""
    """The cause in a sentence."""
    exact: bool = False
    """Whether its law is geometry."""
    relatives: Sequence[Cause] = ()
    """Other forms of it, and what looks like it: weighed in its place, never named."""
