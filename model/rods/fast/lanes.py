"""Rods side by side: LANES of them advance together, so that the compiler turns the loops over them into vectors.

What kernels know of a rod are records: classes whose annotations name its numbers. Quantity k of lane l is number k * LANES + l
of a flat array; a record is the place in it where the numbers of one lane begin, and `rod.m`, `rod.residual[2]` and
`rod.springs[0].arm` read and write there. Nothing else in the package knows how numbers lie in memory.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from llvmlite import ir
from numba.core import cgutils, errors, types
from numba.core.imputils import lower_builtin, lower_getattr_generic, lower_setattr_generic
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
from numba.extending import intrinsic, models, register_model, type_callable

from model.arrays import Array
from model.rods.fast.compiler import allocating, inline

Made = TypeVar("Made", bound=type["LaneRecord"])

LANES = 16
"""Two AVX-512 or four AVX2 vectors; with fewer the compiler unrolls the loops instead of vectorising them."""


class LaneRecord:
    """The numbers of one lane from quantity `first` of a flat array on, in the order in which a subclass annotates them: floats,
    tuples of floats, other records, or Annotated[list[one of these], how many]. Lives in compiled code only."""

    size: int
    """Quantities."""

    def __init__(self, numbers: Array, lane: int, first: int = 0) -> None: ...
    def __getitem__(self, k: int) -> float: ...  # type: ignore[empty-body]
    def __setitem__(self, k: int, value: float) -> None: ...


class _Place(types.Type):  # type: ignore[misc]
    """Where numbers of one lane lie: what compiled code has of a record, or of several fields of one kind."""

    def __init__(self, name: str, item: types.Type, each: int) -> None:
        super().__init__(name=name)
        self.item, self.each = item, each
        self.fields: dict[str, tuple[int, types.Type]] = {}


@register_model(_Place)  # type: ignore[untyped-decorator]
class _PlaceModel(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: _Place) -> None:
        super().__init__(manager, kind, [("data", types.CPointer(types.float64)), ("first", types.int64)])


_PLACES: dict[type, _Place] = {}


def record(made: Made) -> Made:
    """Make kernels understand a record."""
    kind = _PLACES[made] = _Place(f"{made.__module__}.{made.__name__}", types.float64, 1)
    made.size = 0
    for name, annotation in get_type_hints(made, include_extras=True).items():
        if name != "size":
            size, field = _field(annotation)
            kind.fields[name] = made.size, field
            made.size += size
    type_callable(made)(lambda context: lambda numbers, lane, first=types.int64: kind)
    for given in ((types.Array, types.Integer), (types.Array, types.Integer, types.Integer)):
        lower_builtin(made, *given)(_begin)
    return made


def _field(annotation: Any) -> tuple[int, types.Type]:
    """Quantities of a field, and its type."""
    if annotation is float:
        return 1, types.float64
    if get_origin(annotation) is tuple:
        return len(get_args(annotation)), types.UniTuple(types.float64, len(get_args(annotation)))
    if annotation in _PLACES:
        return annotation.size, _PLACES[annotation]
    (each,), (count,) = get_args(annotation.__origin__), annotation.__metadata__
    size, item = _field(each)
    return count * size, _Place(f"several {item.name}", item, size)


class _Numbers:
    """The numbers at a place, while code is written that reads or writes them."""

    def __init__(self, context: Any, builder: Any, data: Any, first: Any) -> None:
        self.context, self.builder, self.data, self.first = context, builder, data, first

    def further(self, quantities: Any) -> _Numbers:
        """So many quantities further on."""
        if isinstance(quantities, int):
            quantities = ir.Constant(ir.IntType(64), quantities)
        step = self.builder.mul(quantities, ir.Constant(ir.IntType(64), LANES), flags=["nsw"])
        return _Numbers(self.context, self.builder, self.data, self.builder.add(self.first, step, flags=["nsw"]))

    @property
    def address(self) -> Any:
        return self.builder.gep(self.data, [self.first], inbounds=True)

    def read(self, kind: Any) -> Any:
        """What lies here: a number, a tuple of numbers, or a place."""
        if isinstance(kind, _Place):
            made = cgutils.create_struct_proxy(kind)(self.context, self.builder)
            made.data, made.first = self.data, self.first
            return made._getvalue()
        if kind is types.float64:
            return self.builder.load(self.address)
        numbers = [self.builder.load(self.further(k).address) for k in range(kind.count)]
        return cgutils.pack_array(self.builder, numbers)

    def write(self, kind: Any, value: Any) -> None:
        """Put a number or a tuple of numbers here."""
        if isinstance(kind, _Place):
            raise errors.TypingError("a record is not assigned but copied")
        numbers = [value] if kind is types.float64 else cgutils.unpack_tuple(self.builder, value, kind.count)
        for k, number in enumerate(numbers):
            self.builder.store(number, self.further(k).address)


def _numbers(context: Any, builder: Any, kind: _Place, value: Any) -> _Numbers:
    place = cgutils.create_struct_proxy(kind)(context, builder, value=value)
    return _Numbers(context, builder, place.data, place.first)


def _begin(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Record(numbers, lane, first)."""
    data = context.make_array(signature.args[0])(context, builder, values[0]).data
    place = _Numbers(context, builder, data, values[1])
    return (place.further(values[2]) if len(values) > 2 else place).read(signature.return_type)


@infer_getattr
class _Attributes(AttributeTemplate):  # type: ignore[misc]
    key = _Place

    def generic_resolve(self, kind: Any, name: str) -> Any:  # type: ignore[override]
        return kind.fields[name][1] if name in kind.fields else None


@lower_getattr_generic(_Place)  # type: ignore[untyped-decorator]
def _read(context: Any, builder: Any, kind: _Place, value: Any, name: str) -> Any:
    """record.name"""
    first, field = kind.fields[name]
    return _numbers(context, builder, kind, value).further(first).read(field)


@lower_setattr_generic(_Place)  # type: ignore[untyped-decorator]
def _write(context: Any, builder: Any, signature: Any, values: Any, name: str) -> None:
    """record.name = value"""
    kind, field = signature.args
    _numbers(context, builder, kind, values[0]).further(kind.fields[name][0]).write(field, values[1])


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        fits = isinstance(args[0], _Place) and isinstance(args[1], types.Integer)
        return signature(args[0].item, args[0], types.int64) if fits else None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        fits = isinstance(args[0], _Place) and isinstance(args[1], types.Integer)
        return signature(types.void, args[0], types.int64, args[0].item) if fits else None


@lower_builtin(operator.getitem, _Place, types.Integer)  # type: ignore[untyped-decorator]
def _read_item(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """record[k]: number k, or field k of several of one kind."""
    kind = signature.args[0]
    return _item(context, builder, kind, values).read(kind.item)


@lower_builtin(operator.setitem, _Place, types.Integer, types.Any)  # type: ignore[untyped-decorator]
def _write_item(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """record[k] = value"""
    kind = signature.args[0]
    _item(context, builder, kind, values).write(kind.item, values[2])
    return context.get_dummy_value()


def _item(context: Any, builder: Any, kind: _Place, values: Any) -> _Numbers:
    each = ir.Constant(ir.IntType(64), kind.each)
    return _numbers(context, builder, kind, values[0]).further(builder.mul(values[1], each, flags=["nsw"]))


@allocating
def new_numbers(count: int) -> Array:
    """Zeros that begin where a vector of 64 bytes does: one that lies across two such places takes twice as long to fetch."""
    room = np.zeros(count + 7)
    begin = -(room.ctypes.data // 8) % 8
    return room[begin : begin + count]


@inline
def copy(source: LaneRecord, into: LaneRecord, count: int) -> None:
    """The first numbers of a record into another."""
    for k in range(count):
        into[k] = source[k]


def _copy_lanes(typing: Any, source: Any, into: Any, count: Any) -> Any:
    def written(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        read, write = (_numbers(context, builder, signature.args[k], values[k]).address for k in (0, 1))
        size = builder.mul(values[2], ir.Constant(ir.IntType(64), LANES))
        cgutils.raw_memcpy(builder, write, read, size, np.dtype(float).itemsize)
        return context.get_dummy_value()

    return types.void(source, into, types.int64), written


copy_lanes = cast(Callable[[LaneRecord, LaneRecord, int], None], intrinsic(_copy_lanes))
"""The first numbers of a record into another, of all lanes; the records are those of lane 0."""
