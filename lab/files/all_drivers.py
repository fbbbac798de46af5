"""All drivers that can be used: the project's own and those of installed packages."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from drivers.registry import GROUP, Driver, faults, own

from .packages import Registered, Unusable, installed


@functools.cache
def found_drivers() -> Registered[Driver]:
    """By name; looked up once, since a rig asks for them again and again."""
    good, missing = own()
    return installed(GROUP, good, _driver, missing)


def drivers() -> Mapping[str, Driver]:
    """Those that can be used, by name."""
    return found_drivers().usable


def _driver(name: str, thing: object) -> dict[str, Driver]:
    if wrong := faults(thing):
        raise Unusable(wrong)
    assert isinstance(thing, Driver)
    return {name: thing}
