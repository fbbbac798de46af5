"""Settings with which a protocol keeps the limits that its plan exceeds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from operator import getitem
from typing import Any, NamedTuple

from pydantic import BaseModel

from model.errors import unit_text
from protocols.errors import BadProtocol
from protocols.parameters import Parameters
from recordings.numbers import NUMBER

from ..files.config import unit_of
from ..files.units import KINDS, plain_unit, usual
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
        nearest = sorted(_values(parameters, given), key=lambda one: one.unit != excess.unit)
        for key, instead in ((one.key, x) for one in nearest for x in _instead(one, excess)):
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
    found = {one.key: one for one in _values(parameters, given)}
    return {limit: typed("--set", f"{key}={_text(found[key].value, *found[key].written)}") for limit, key in keys.items()}


class Value(NamedTuple):
    """A parameter under its dotted key, its SI unit, and size and name of the unit in which a person writes it."""

    key: str
    value: Any
    unit: str
    written: tuple[float, str]


def _values(parameters: BaseModel, given: Any, table: str = "") -> Iterator[Value]:
    """All parameters."""
    for name, field in type(parameters).model_fields.items():
        value, raw = getattr(parameters, name), given.get(name) if isinstance(given, Mapping) else None
        if isinstance(value, BaseModel):
            yield from _values(value, raw, f"{table}{name}.")
        else:
            unit = unit_of(field) or ""
            units = [plain_unit(re.sub(rf"\s*{NUMBER}\s*", "", str(one))) for one in (raw if isinstance(raw, list) else [raw])]
            known = KINDS.get(unit, {})
            numbers = [x for x in (value if isinstance(value, list) else [value]) if isinstance(x, float)]
            written = next(((known[own], own) for own in units if own in known), usual(unit, max(numbers, default=0.0)))
            yield Value(f"{table}{name}", value, unit, written)


def _instead(one: Value, excess: Excess) -> Iterator[Any]:
    """What may replace a number or a list: chambers that are there; numbers lowered to the limit, or all in proportion."""
    several, size = isinstance(one.value, list), one.written[0]
    numbers = one.value if several else [one.value]
    fed = [chamber for group in excess.channels for chamber in group]
    if several and fed:
        yield [x for x in numbers if x in fed]
        for group in excess.channels:
            yield from (list(group), [list(group)])
    elif fed and type(one.value) is int:
        yield len(fed)
    if not excess.unit or not all(isinstance(x, float) and x >= 0 for x in numbers):
        return
    most = max(numbers, default=0.0) / excess.over
    # less than in proportion where what is asked for is not in proportion to one key
    changed = [[_rounded(share * x / excess.over, size) for x in numbers] for share in (1.0, 0.5, 0.25)]
    lowered = [x if x <= most else _rounded(most, size) for x in numbers]
    changed.insert(0 if 2 * len(set(lowered)) >= len(numbers) else len(changed), lowered)
    for found in changed:
        yield from (list(dict.fromkeys(found)), found) if several else found


def _rounded(x: float, size: float) -> float:
    """Down to four digits in a unit of this size."""
    step = size * 10.0 ** (math.floor(math.log10(x / size)) - 3) if x > 0 else 1.0
    return math.floor(x / step * (1 + 1e-9)) * step


def _text(value: Any, size: float, unit: str) -> str:
    """As a person writes it."""
    if isinstance(value, list):
        return f"[{', '.join(_text(one, size, unit) for one in value)}]"
    return f"{value / size:.10g}{unit_text(unit)}" if isinstance(value, float) else str(value)
