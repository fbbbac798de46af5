"""Settings with which a protocol keeps the limits that its plan exceeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import reduce
from operator import getitem
from typing import Any

from pydantic import BaseModel

from protocols.errors import BadProtocol
from protocols.parameters import Parameters

from ..files.config import unit_of
from ..files.units import written
from ..plain import typed
from .limits import Excess, Excesses


def settings(parameters: Parameters, excesses: Callable[[Parameters], Excesses]) -> dict[str, str]:
    """Limit -> `--set KEY=VALUE`, for the limits that smaller numbers of one key keep; all of them together keep these limits.

    `excesses`: of a plan with such parameters, by limit."""
    over, keys = excesses(parameters), dict[str, str]()
    for limit, ((_, excess), *_) in list(over.items()):
        for key, value, _ in sorted(_values(parameters), key=lambda one: one[2] != excess.unit):
            for instead in _instead(value, excess) if limit in over else ():
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
    text = {key: _text(value, unit) for key, value, unit in _values(parameters) if key in keys.values()}
    return {limit: typed("--set", f"{key}={text[key]}") for limit, key in keys.items()}


def _values(parameters: BaseModel, table: str = "") -> Iterator[tuple[str, Any, str]]:
    """Dotted key, value and unit of all parameters."""
    for name, field in type(parameters).model_fields.items():
        value = getattr(parameters, name)
        inner = isinstance(value, BaseModel)
        yield from _values(value, f"{table}{name}.") if inner else [(f"{table}{name}", value, unit_of(field) or "")]


def _instead(value: Any, excess: Excess) -> Iterator[Any]:
    """What may replace a number or a list: one channel's chambers; numbers within the limit, or all in proportion."""
    several = isinstance(value, list)
    numbers = value if several else [value]
    for group in excess.channels if several else ():
        yield from (list(group), [list(group)])
    if excess.unit and numbers and all(isinstance(x, float) and x >= 0 for x in numbers):
        within = [x for x in numbers if x * excess.over <= max(numbers) * (1 + 1e-9)]
        if several and within and (len(within) > 1 or excess.over == math.inf):
            yield within
        for share in (1.0, 0.5, 0.25):  # less, where what is asked for is not in proportion to one key
            scaled = [_rounded(share * x / excess.over) for x in numbers]
            yield list(dict.fromkeys(scaled)) if several else scaled[0]


def _rounded(x: float) -> float:
    """Down to two digits."""
    step = 10.0 ** (math.floor(math.log10(x)) - 1) if x > 0 else 1.0
    return float(f"{math.floor(x / step * (1 + 1e-9)) * step:.2g}")


def _text(value: Any, unit: str) -> str:
    """As a person writes it."""
    if isinstance(value, list):
        return f"[{', '.join(_text(one, unit) for one in value)}]"
    return f"{value:g}" if unit in ("", "1") else written([value], unit)[0]
