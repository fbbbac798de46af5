"""The slow way to read a message: by the schema in the file, with the protobuf runtime. For other layouts than ours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Schema
from numpy.typing import NDArray

from ..errors import Damaged, OtherVersion, Oversized
from ..messages import MAX_NUMBERS, Field, MessageType
from .budget import OPTION, largest_message


def message_class(schema: Schema) -> type[Any]:
    """The protobuf class that a schema record describes; raises `Damaged` when it describes none."""
    try:
        return _class(schema)
    except (DecodeError, TypeError, KeyError, ValueError, RecursionError) as error:
        raise Damaged(
            f"the schema {schema.name} in the file describes no message: {error}; run `lab verify`"
        ) from error


def _class(schema: Schema) -> type[Any]:
    files = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
    pool = DescriptorPool()

    def add(file: FileDescriptorProto) -> None:
        for dependency in file.dependency:
            if dependency in files:
                add(files.pop(dependency))
        pool.Add(file)  # type: ignore[no-untyped-call]

    while files:
        add(files.pop(next(iter(files))))
    return GetMessageClass(pool.FindMessageTypeByName(schema.name))  # type: ignore[no-untyped-call, no-any-return]


def parse(kind: type[Any], payload: bytes, topic: str) -> Any:
    """One message; raises `Damaged` when the bytes are not one, `Oversized` for one that is longer than any of ours."""
    if len(payload) > (most := largest_message()):
        raise Oversized(f"{topic}: a message of {len(payload)} bytes, limit {most}; {OPTION} lifts the limit")
    try:
        return kind.FromString(payload)
    except DecodeError as error:
        raise Damaged(f"{topic}: a message cannot be decoded: {error}; run `lab verify`") from error


def decode(message: MessageType, schema: Schema, payloads: Iterable[bytes], count: int) -> NDArray[np.void]:
    """`count` messages to an array like `MessageType.decode`; sizes of arrays are those of the first message.

    Fields that the file's schema does not have yet are NaN (numbers) or 0 (everything else). Raises `OtherVersion` when
    the schema has none of the fields beside `t`, has them of another type, or arrays change their size.
    """
    kind = message_class(schema)
    there = {field.name: field for field in kind.DESCRIPTOR.fields}
    known = [field for field in message.fields if field.name in there]
    if "t" not in there or len(known) < 2:
        raise OtherVersion(
            f"{message.topic}: the file's schema {schema.name} describes another message, with the fields {sorted(there)[:50]}"
        )
    for field in known:
        if there[field.name].type != field.type or there[field.name].is_repeated != bool(field.shape):
            raise OtherVersion(f"{message.topic}: field {field.name} has another type in the file")
    out = None
    for row, payload in enumerate(payloads):
        parsed = parse(kind, payload, message.topic)
        if out is None:
            out = _table(message, parsed, known, count)
        for field in known:
            value = getattr(parsed, field.name)
            if field.shape:
                place = out[field.name][row]
                if len(value) != place.size:
                    raise OtherVersion(f"{message.topic}: field {field.name} changes its size within the file")
                value = np.array(value).reshape(place.shape)
            out[field.name][row] = value
    return np.zeros(0, message.dtype) if out is None else out


def _table(message: MessageType, first: Any, known: Sequence[Field], count: int) -> NDArray[np.void]:
    """Room for all messages, arrays as long as those of the first; NaN where the file has no such numbers."""
    shapes = {f.name: _shape(f.shape, len(getattr(first, f.name)), message.topic) for f in known if f.shape}
    out = np.zeros(count, message.sized(**shapes).dtype)
    for field in message.fields:
        if field not in known and field.kind == "double":
            out[field.name] = np.nan
    return out


def _shape(like: tuple[int, ...], count: int, topic: str) -> tuple[int, ...]:
    """The first dimension is free."""
    width = int(np.prod(like[1:], dtype=int))
    if count > MAX_NUMBERS or count % width:
        raise OtherVersion(
            f"{topic}: an array of {count} numbers, must be a multiple of {width} and at most {MAX_NUMBERS}"
        )
    return (count // width, *like[1:])
