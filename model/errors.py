"""The error tree of the model. Each message names the field, the value with its unit, the limit and what to do next."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class ModelError(Exception):
    """Anything the model refuses or cannot do."""


class BadRobot(ModelError, ValueError):
    """The robot description is out of limits or contradicts itself."""


class BadArm(ModelError, ValueError):
    """The description of an arm is out of limits or contradicts itself."""


class BadCondition(ModelError, ValueError):
    """Conditions or measurements of the wrong shape, not finite, or out of the robot's limits."""


class SolveFailed(ModelError, RuntimeError):
    """No trustworthy equilibrium was found for some states."""


class BadEffect(ModelError, ValueError):
    """An effect is declared wrongly, asked for by a name that does not exist, or cannot be loaded."""


class NotIdentified(ModelError, ValueError):
    """The data do not determine what is to be fitted."""


def unit_text(unit: str, before: str = " ") -> str:
    """A unit, perhaps of somebody else's file, as it stands behind a number or, after a comma, behind a name; nothing for 1."""
    return "" if unit in ("", "1") else f"{before}{unit[:30]}"


def alike(name: str, known: Iterable[str]) -> str:
    """The known name that was probably meant, capitals and the dashes of options aside; empty if none resembles it."""
    names = {other.casefold().lstrip("-"): other for other in known}
    return next((names[near] for near in difflib.get_close_matches(name.casefold().lstrip("-"), names)), "")


def nearest(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """What a message adds about a name that is not known: the one that was probably meant, else `otherwise` or all there are.

    >>> nearest("Robt", ["robot", "files"]), nearest("foo", ["robot", "files"])
    ('did you mean robot?', 'there are robot, files')
    """
    names = list(known)
    near = alike(name, names)
    return f"did you mean {near}?" if near else otherwise or f"there are {', '.join(names)}"
