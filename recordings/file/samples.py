"""A stream's channel: whether it is one that this software writes, how its messages are laid out in this file, and its samples,
decoded batch by batch into one array."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from .. import events
from ..errors import BadMessage, Damaged, OtherVersion, Oversized
from ..messages import MAX_NUMBERS, SCHEMA_VERSION, STREAMS, MessageType, message_name, stream_message

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
    version = version_of(channel)
    if version != SCHEMA_VERSION:
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
    message = _stream_message(channel, schema, file)
    usual = {field.name: field.shape for field in message.fields}
    for name, shape in shapes.items():
        like = usual.get(name, ())
        # Chambers and markers are the robot's; everything else has the size that it has.
        free = name in OF_ROBOT and len(shape) == len(like) and shape[1:] == like[1:]
        if not free and shape != like:
            raise OtherVersion(f"{file}: {channel.topic} has {name} of shape {shape}, this software reads {like}")
    return message.sized(**shapes)


def _stream_message(channel: Channel, schema: Schema | None, file: str) -> MessageType:
    if schema is None and channel.topic not in STREAMS:
        raise Damaged(f"{file}: {channel.topic} names the schema {channel.schema_id}, which is missing")
    units = {key.removeprefix("unit."): text for key, text in channel.metadata.items() if key.startswith("unit.")}
    try:
        return stream_message(channel.topic, b"" if schema is None else schema.data, units)
    except BadMessage as error:
        raise Damaged(f"{file}: {error}") from error


class Samples:
    """Collects messages of fixed layout."""

    def __init__(self, message: MessageType) -> None:
        self.message = message
        self._out = np.zeros(0, message.dtype)
        self._count = 0
        self._other = False

    def add(self, rows: NDArray[np.uint8] | None) -> None:
        """Messages as rows of bytes, shape (n, size); None when their sizes differ."""
        if self._other or rows is None or not self.message.fits(rows):
            self._other = True
            return
        end = self._count + len(rows)
        if end > len(self._out):
            larger = np.zeros(end + len(self._out) // 2, self.message.dtype)
            larger[: self._count] = self._out[: self._count]
            self._out = larger
        self.message.decode(rows.reshape(-1), self._out[self._count : end])
        self._count = end

    @property
    def array(self) -> NDArray[np.void] | None:
        """All samples; None when some message has another layout."""
        return None if self._other else self._out[: self._count]


# ------------------------------------------------------------------ order
def ordered(keys: Sequence[NDArray[Any]], content: Callable[[int], bytes]) -> NDArray[np.int64]:
    """Indices of n messages by keys of shape (n,), the last one first.

    Messages that are equal in all keys are told apart by `content`; which of two equal ones comes first does not matter.
    """
    order = np.lexsort(keys).astype(np.int64)
    same = np.all([np.diff(key[order]) == 0 for key in keys], axis=0)
    for first, last in _runs(same):
        order[first:last] = sorted(order[first:last].tolist(), key=content)
    return order


def _runs(same: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and one past the last of each run of equal neighbours; same[i]: item i equals item i + 1."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(np.int8)))
    for first, last in edges.reshape(-1, 2).tolist():
        yield first, last + 1
