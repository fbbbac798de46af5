"""The slow way to read a message: by the schema in the file, with the protobuf runtime. For other layouts than ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Schema
from numpy.typing import NDArray

from .errors import Damaged, OtherVersion
from .messages import MessageType


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
    """One message; raises `Damaged` when the bytes are not one."""
    try:
        return kind.FromString(payload)
    except DecodeError as error:
        raise Damaged(f"{topic}: a message cannot be decoded: {error}; run `lab verify`") from error


def decode(message: MessageType, schema: Schema, payloads: Sequence[bytes]) -> NDArray[np.void]:
    """Messages to an array like `MessageType.decode`; sizes of arrays are those of the first message.

    Fields that the file's schema does not have yet are NaN (numbers) or 0 (everything else). Raises `OtherVersion` when
    the schema has none of the fields beside `t`, or arrays change their size.
    """
    kind = message_class(schema)
    names = {field.name for field in kind.DESCRIPTOR.fields}
    there = [field for field in message.fields if field.name in names]
    if "t" not in names or len(there) < 2:
        raise OtherVersion(
            f"{message.topic}: the file's schema {schema.name} is another message: it has {sorted(names)}"
        )
    parsed = [parse(kind, payload, message.topic) for payload in payloads]
    shapes = {f.name: _shape(f.shape, len(getattr(parsed[0], f.name))) for f in there if f.shape}
    message = message.sized(**shapes)
    out = np.zeros(len(parsed), message.dtype)
    for field in message.fields:
        if field.name not in names:
            out[field.name] = np.nan if field.kind == "double" else 0
            continue
        values = [getattr(p, field.name) for p in parsed]
        if field.shape and any(len(value) != field.count for value in values):
            raise OtherVersion(f"{message.topic}: field {field.name} changes its size within the file")
        out[field.name] = (
            np.array([list(v) for v in values]).reshape(len(values), *field.shape) if field.shape else values
        )
    return out


def _shape(like: tuple[int, ...], count: int) -> tuple[int, ...]:
    """The first dimension is free."""
    width = int(np.prod(like[1:], dtype=int))
    return (count // width, *like[1:])
