"""Settings with which a protocol keeps the limits that its plan exceeds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from operator import getitem
from typing import Any

from pydantic import BaseModel

from protocols.errors import BadProtocol
from protocols.parameters import Parameters
from recordings.numbers import NUMBER

from ..files.config import unit_of
from ..files.units import KINDS, plain_unit, unit_text, usual
from ..plain import typed
from .limits import Excess, Excesses


def settings(parameters: Parameters, given: Mapping[str, Any], excesses: Callable[[Parameters], Excesses]) -> dict[str, str]:
    """Limit -> `--set KEY=VALUE`, for the limits that smaller numbers of one key keep; all of them together keep these limits.

    `given`: the parameters as a person wrote them, whose units are kept; `excesses`: of a plan with such parameters, by limit."""
    over, keys = excesses(parameters), dict[str, str]()
    for limit in [*over]:
        if limit not in over:
            continue
        _, excess = over[limit][0]
        nearest = sorted(_values(parameters), key=lambda one: one[2] != excess.unit)
        for key, instead in ((k, x) for k, v, u in nearest for x in _instead(v, excess, _as_given(given, k, v, u)[0])):
            *tables, name = key.split(".")
            values = parameters.model_dump()
            reduce(getitem, tables, values)[name] = instead
            try:
                changed = type(parameters).model_validate(values)
                left = excesses(changed)
            except (ValueError, BadProtocol):
                continue
            if limit not in left and left.keys() < over.keys():
                keys |= dict.fromkeys(over.keys() - left.keys(), key)
                parameters, over = changed, left
                break
    found = {key: _text(value, *_as_given(given, key, value, unit)) for key, value, unit in _values(parameters)}
    return {limit: typed("--set", f"{key}={found[key]}") for limit, key in keys.items()}


def _values(parameters: BaseModel, table: str = "") -> Iterator[tuple[str, Any, str]]:
    """Dotted key, value and unit of all parameters."""
    for name, field in type(parameters).model_fields.items():
        value = getattr(parameters, name)
        inner = isinstance(value, BaseModel)
        yield from _values(value, f"{table}{name}.") if inner else [(f"{table}{name}", value, unit_of(field) or "")]


def _instead(value: Any, excess: Excess, size: float) -> Iterator[Any]:
    """What may replace a number or a list: chambers that are there; numbers lowered to the limit, or all in proportion.

    `size`: of the unit in which it is written."""
    several = isinstance(value, list)
    numbers = value if several else [value]
    fed = [chamber for group in excess.channels for chamber in group]
    if several and fed:
        yield [x for x in value if x in fed]
        for group in excess.channels:
            yield from (list(group), [list(group)])
    elif fed and type(value) is int and value > len(fed):
        yield len(fed)
    if not excess.unit or not all(isinstance(x, float) and x >= 0 for x in numbers):
        return
    most = max(numbers, default=0.0) / excess.over
    lowered = [x if x <= most else _rounded(most, size) for x in numbers]
    changed = [[_rounded(share * x / excess.over, size) for x in numbers] for share in (1.0, 0.5, 0.25)]  # less, where what
    # is asked for is not in proportion to one key
    changed.insert(0 if 2 * len(set(lowered)) >= len(numbers) else len(changed), lowered)
    for found in changed:
        yield from (list(dict.fromkeys(found)), found) if several else found


def _rounded(x: float, size: float) -> float:
    """Down to three digits in a unit of this size, unless it has few."""
    number = x / size
    short = float(f"{number:.5g}")
    if abs(short - number) > 1e-9 * number:
        step = 10.0 ** (math.floor(math.log10(number)) - 2)
        short = float(f"{math.floor(number / step) * step:.3g}")
    return short * size


def _as_given(given: Mapping[str, Any], key: str, value: Any, unit: str) -> tuple[float, str]:
    """Size and name of the unit in which a person wrote a parameter, else of the usual one."""
    of: Any = given
    for name in key.split("."):
        of = of.get(name) if isinstance(of, Mapping) else None
    names = [plain_unit(re.sub(rf"\s*{NUMBER}\s*", "", str(one))) for one in (of if isinstance(of, list) else [of])]
    known, numbers = KINDS.get(unit, {}), [x for x in (value if isinstance(value, list) else [value]) if isinstance(x, float)]
    return next(((known[name], name) for name in names if name in known), usual(unit, max(numbers, default=0.0)))


def _text(value: Any, size: float, unit: str) -> str:
    """As a person writes it."""
    if isinstance(value, list):
        return f"[{', '.join(_text(one, size, unit) for one in value)}]"
    return f"{value / size:.10g}{unit_text(unit)}" if isinstance(value, float) else str(value)
