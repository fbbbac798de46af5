"""What kernels say to the processor in a single instruction, where Python's own words would take several."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from llvmlite import binding
from numba.core import types
from numba.extending import intrinsic

_FUSES = binding.get_host_cpu_features().get("fma", True)
"""Whether this processor fuses; those that are not asked (all but x86) do."""


def _fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    def written(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        a, b, c = values
        return builder.fma(a, b, c) if _FUSES else builder.fadd(builder.fmul(a, b), c)

    return types.float64(types.float64, types.float64, types.float64), written


def _number_at(typing: Any, array: Any, i: Any) -> Any:
    def written(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(_place(context, builder, signature, values))

    array = getattr(array, "type", array)
    return array.dtype(array, types.int64), written


def _put_number(typing: Any, array: Any, i: Any, value: Any) -> Any:
    def written(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.store(values[2], _place(context, builder, signature, values))
        return context.get_dummy_value()

    return types.void(array, types.int64, array.dtype), written


def _place(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Where number i of a flat array lies."""
    array = context.make_array(signature.args[0])(context, builder, values[0])
    return builder.gep(array.data, [values[1]], inbounds=True)


fused = cast(Callable[[float, float, float], float], intrinsic(_fused))
"""a b + c, rounded once. Said here, not left to the compiler, it has the same bits in a loop with vectors and in one without."""
number_at = cast(Callable[[Any, int], float], intrinsic(_number_at))
"""array[i] of a flat array that is there, i from 0 on. (Python counts negative ones from the end; asking whether one is makes
gathers of what would be vectors.)"""
put_number = cast(Callable[[Any, int, float], None], intrinsic(_put_number))
"""array[i] = value, as `number_at`."""
