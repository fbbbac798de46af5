"""Parameters of causes and calibration, as a person states them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from model.cause import Cause

from ..errors import BadCase
from ..inference.problem import FitParameter


@dataclass(frozen=True, kw_only=True)
class Parameter(FitParameter):
    """One parameter of the model, fitted as its difference from nominal; `name`: CAUSE.KEY, or the key alone for calibration."""

    key: str
    """Name under which the model knows it."""
    nominal: float
    sides: tuple[float, ...] = ()
    """Of a cause: differences from nominal, of its plausible size, at which it does something."""
    linear: bool = True
    """Whether what it does grows with its size, so that fits may begin at nominal."""


def parameters(causes: Sequence[Cause], calibration: Mapping[str, Sequence[Any]]) -> tuple[Parameter, ...]:
    """All parameters, those of causes first. Raises `BadCase` where one is not stated soundly or has two owners."""
    if isinstance(causes, Cause) or not causes or not all(isinstance(c, Cause) for c in causes):
        text = "none given" if not isinstance(causes, Cause) and not causes else "must be a list of lab.Cause"
        raise BadCase(f"causes: {text}; list at least one, lab.Cause(name, {{parameter: (nominal, plausible size, unit)}})")
    causes = [*causes, *(r for c in causes for r in c.relatives)]
    for whose, own in (*((f"cause {c.name!r}", c.parameters) for c in causes), ("calibration", calibration)):
        if not isinstance(own, Mapping):
            raise BadCase(f"{whose}: {own!r}; write {{parameter: (nominal, plausible size, unit)}}")
    stated = [(c.name, key, quantity, c.exact) for c in causes for key, quantity in c.parameters.items()]
    stated += [("", key, quantity, False) for key, quantity in calibration.items()]
    names = [c.name for c in causes]
    for what, given in (("cause", names), ("parameter", [key for _, key, *_ in stated])):
        if twice := sorted({name for name in given if given.count(name) > 1}):
            raise BadCase(f"{what} {twice[0]!r} is given {given.count(twice[0])} times; give each {what} a name of its own")
    if reserved := sorted({"unknown", "none", ""} & {*names}):
        raise BadCase(f"cause {reserved[0]!r}: the answer uses this word itself; give the cause another name")
    if empty := [c.name for c in causes if not c.parameters]:
        raise BadCase(f"cause {empty[0]!r} has no parameter; state what it changes, name: (nominal, plausible size, unit)")
    return tuple(_parameter(*one) for one in stated)


def _parameter(cause: str, key: str, quantity: Sequence[Any], exact: bool) -> Parameter:
    """One parameter from (nominal, plausible size, unit) with or without (low, high)."""
    name = f"{cause}.{key}" if cause else key
    if isinstance(quantity, str) or not isinstance(quantity, Sequence) or len(quantity) not in (3, 5):
        raise BadCase(
            f"{name}: {quantity!r}; write (nominal, plausible size, unit) or (nominal, plausible size, unit, low, high)"
        )
    nominal, size, unit, *bounds = quantity
    if not isinstance(unit, str):
        raise BadCase(f"{name}: unit {unit!r}; write it as text, such as 'm', or '1' where there is none")
    low, high = (math.inf * sign if b is None else b for sign, b in zip((-1, 1), bounds or (None, None), strict=True))
    try:
        nominal, size, low, high = (float(x) for x in (nominal, size, low, high))
    except (TypeError, ValueError):
        raise BadCase(f"{name}: {quantity!r}: nominal, plausible size and bounds must be numbers") from None
    if not (math.isfinite(nominal) and 0 < size < math.inf):
        raise BadCase(f"{name}: nominal {nominal:g}, plausible size {size:g}; both must be finite, the size above 0")
    if not (low <= nominal <= high and low < high):
        raise BadCase(f"{name}: nominal {nominal:g} must lie within its bounds {low:g} .. {high:g} (unit {unit})")
    group, low, high = "effect" if cause else "calibration", low - nominal, high - nominal
    return Parameter(
        name=name, key=key, source=cause or key, group=group, unit=unit, nominal=nominal, sd=size, low=low, high=high, exact=exact
    )
