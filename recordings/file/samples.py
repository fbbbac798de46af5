"""A channel: whether it is one that this software writes, how its messages are laid out in this file, and what they hold.

Samples of our own layout are decoded batch by batch into one array; any other layout, and events, by the protobuf runtime and
the schema in the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass, GetMessages
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from .. import events
from ..errors import BadMessage, Damaged, OtherVersion, Oversized
from ..messages import MAX_NUMBERS, SCHEMA_VERSION, STREAMS, Field, MessageType, message_name, stream_message
from .budget import OPTION, largest_message
from .chunks import Messages

OF_ROBOT = ("setpoint", "measured", "markers")
"""Arrays whose size is that of the robot."""


def written_name(topic: str) -> str | None:
    """Full name of a topic's message; None for a topic that this software does not write."""
    return events.EVENTS[topic].full_name if topic in events.EVENTS else message_name(topic)


def ours(channel: Channel, schema: Schema | None) -> bool:
    """Whether a channel is as this software writes it; one whose schema was lost may be, and is damaged."""
    name = written_name(channel.topic)
    return channel.message_encoding == "protobuf" and name is not None and (schema is None or schema.name == name)


def version_of(channel: Channel) -> str:
    """Schema version of a channel's messages."""
    return channel.metadata.get("schema_version", SCHEMA_VERSION)


def check_version(channel: Channel, file: str) -> None:
    """Raises `OtherVersion` for a channel of a version that this software does not read."""
    if (version := version_of(channel)) != SCHEMA_VERSION:
        raise OtherVersion(
            f"{file}: {channel.topic} has schema version {version}, this software reads {SCHEMA_VERSION}; "
            "use the version of the software named in the file's metadata"
        )


def message_of(channel: Channel, schema: Schema | None, file: str) -> MessageType:
    """The message of a stream's channel with the array sizes of this file; raises `Damaged`, `Oversized`, `OtherVersion`."""
    try:
        shapes = {
            key.removeprefix("shape."): tuple(int(n) for n in text.split("x"))
            for key, text in channel.metadata.items()
            if key.startswith("shape.")
        }
    except ValueError as error:
        raise Damaged(f"{file}: {channel.topic} has an invalid array shape: {error}") from error
    if any(min(shape) < 0 or math.prod(shape) > MAX_NUMBERS for shape in shapes.values()):
        raise Oversized(f"{file}: {channel.topic} has arrays of shape {shapes}, limit {MAX_NUMBERS} numbers")
    if schema is None and channel.topic not in STREAMS:
        raise Damaged(f"{file}: {channel.topic} names the schema {channel.schema_id}, which is missing")
    units = {key.removeprefix("unit."): text for key, text in channel.metadata.items() if key.startswith("unit.")}
    try:
        message = stream_message(channel.topic, b"" if schema is None else schema.data, units)
    except BadMessage as error:
        raise Damaged(f"{file}: {error}") from error
    usual_shapes = {field.name: field.shape for field in message.fields}
    for name, shape in shapes.items():
        usual = usual_shapes.get(name, ())
        # How many chambers and markers there are is the robot's; every other size is fixed.
        free = name in OF_ROBOT and len(shape) == len(usual) and shape[1:] == usual[1:]
        if not free and shape != usual:
            raise OtherVersion(f"{file}: {channel.topic} has {name} of shape {shape}, this software reads {usual}")
    return message.sized(**shapes)


# -- by the protobuf runtime
def message_class(schema: Schema) -> type[Any]:
    """The protobuf class that a schema record describes; raises `Damaged` when it describes none."""
    pool = DescriptorPool()
    try:
        GetMessages(FileDescriptorSet.FromString(schema.data).file, pool)
        return GetMessageClass(pool.FindMessageTypeByName(schema.name))  # type: ignore[no-untyped-call, no-any-return]
    except (DecodeError, TypeError, KeyError, ValueError, RecursionError) as error:
        raise Damaged(f"the schema {schema.name} in the file describes no message: {error}; run `lab verify`") from error


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
    the schema has none of the fields except `t`, has them of another type, or arrays change their size.
    """
    kind = message_class(schema)
    in_file = {field.name: field for field in kind.DESCRIPTOR.fields}
    shared = [field for field in message.fields if field.name in in_file]
    if "t" not in in_file or len(shared) < 2:
        raise OtherVersion(
            f"{message.topic}: the file's schema {schema.name} describes another message, with the fields {sorted(in_file)[:50]}"
        )
    for field in shared:
        if in_file[field.name].type != field.type or in_file[field.name].is_repeated != bool(field.shape):
            raise OtherVersion(f"{message.topic}: field {field.name} has another type in the file")
    out = None
    for row, payload in enumerate(payloads):
        parsed = parse(kind, payload, message.topic)
        if out is None:
            out = _table(message, parsed, shared, count)
        for field in shared:
            value = getattr(parsed, field.name)
            if field.shape:
                place = out[field.name][row]
                if len(value) != place.size:
                    raise OtherVersion(f"{message.topic}: field {field.name} changes its size within the file")
                value = np.array(value).reshape(place.shape)
            out[field.name][row] = value
    return np.zeros(0, message.dtype) if out is None else out


def samples_of(layout: MessageType, schema: Schema | None, messages: Messages, file: str) -> NDArray[np.void]:
    """Messages of a stream as samples; raises `Damaged`, `OtherVersion`, `Oversized`."""
    rows = messages.rows()
    if rows is not None and layout.fits(rows):
        return layout.decode(rows.reshape(-1))
    if schema is None:
        raise Damaged(f"{file}: {layout.topic} names a schema that is missing")
    return decode(layout, schema, messages.payloads(), len(messages))


def _table(message: MessageType, first: Any, known: Sequence[Field], count: int) -> NDArray[np.void]:
    """An empty array for `count` messages, its arrays as long as those of the first; NaN in fields that are not `known`."""
    shapes = {}
    for field in known:
        if field.shape:  # its first dimension is free
            length, width = len(getattr(first, field.name)), math.prod(field.shape[1:])
            if length > MAX_NUMBERS or length % width:
                limits = f"must be a multiple of {width} and at most {MAX_NUMBERS}"
                raise OtherVersion(f"{message.topic}: an array of {length} numbers, {limits}")
            shapes[field.name] = (length // width, *field.shape[1:])
    out = np.zeros(count, message.sized(**shapes).dtype)
    for field in message.fields:
        if field not in known and field.kind == "double":
            out[field.name] = np.nan
    return out
