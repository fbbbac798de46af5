"""The definition of every message in a recording: one place from which schema, encoder and decoder are made.

A stream's message has a fixed layout: protobuf (proto2) whose fields are always present, numbers of fixed width, arrays
packed with a fixed count. Its bytes are therefore a struct: tags and lengths are constant, values sit at constant
offsets. Any protobuf decoder reads it by the schema in the file; this module also writes it with `struct` and reads
thousands at once with numpy.
Two sizes belong to a recording rather than to the schema: the number of chambers and of body markers.

Every message begins with `t`: rig time in seconds, a whole number of nanoseconds.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from .errors import BadMessage

SCHEMA_VERSION = "1"
"""Changes when a field changes its meaning or leaves; a new field at the end of a message keeps it."""

PACKAGE = "lab"

MAX_NUMBERS = 10_000
"""Numbers in one array of a message."""

_KINDS: dict[str, tuple[FieldDescriptorProto.Type.ValueType, str, str, int, int]] = {
    # kind: (protobuf type, struct code, numpy type, wire type, bytes)
    "double": (FieldDescriptorProto.TYPE_DOUBLE, "d", "<f8", 1, 8),
    "sfixed64": (FieldDescriptorProto.TYPE_SFIXED64, "q", "<i8", 1, 8),
    "fixed32": (FieldDescriptorProto.TYPE_FIXED32, "I", "<u4", 5, 4),
    "bool": (FieldDescriptorProto.TYPE_BOOL, "?", "?", 0, 1),
}


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


@dataclass(frozen=True)
class Field:
    """One field, of a protobuf type of fixed width: `shape` () is a number, (n,) or (n, m) an array of fixed size."""

    name: str
    kind: str
    shape: tuple[int, ...] = ()
    unit: str = ""
    doc: str = ""
    parts: str = ""
    """Names of an array's components, such as "x y z"; a single word is counted: "chamber 1"."""

    @property
    def type(self) -> FieldDescriptorProto.Type.ValueType:
        """Its protobuf type."""
        return _KINDS[self.kind][0]

    @cached_property
    def count(self) -> int:
        """Numbers in the field."""
        return math.prod(self.shape)

    def head(self, number: int) -> bytes:
        """The constant bytes in front of the value: tag, and length where the field is an array."""
        wire_type, size = _KINDS[self.kind][3:]
        if not self.shape:
            return _varint(number << 3 | wire_type)
        return _varint(number << 3 | 2) + _varint(size * self.count)


@dataclass(frozen=True)
class MessageType:
    """A message of fixed layout. Encodes from values in field order, decodes to a structured numpy array."""

    name: str
    topic: str
    fields: tuple[Field, ...]
    doc: str = ""

    def sized(self, **shapes: tuple[int, ...]) -> MessageType:
        """The same message with other array shapes, by field name."""
        unknown = set(shapes) - {field.name for field in self.fields}
        if unknown:
            raise BadMessage(f"{self.topic} has no field {', '.join(sorted(unknown))}")
        return replace(self, fields=tuple(replace(f, shape=shapes.get(f.name, f.shape)) for f in self.fields))

    # -- schema
    @property
    def full_name(self) -> str:
        """Protobuf name with package."""
        return f"{PACKAGE}.{self.name}"

    @cached_property
    def schema(self) -> bytes:
        """Serialized FileDescriptorSet, as MCAP stores it."""
        file = FileDescriptorProto(name=f"{PACKAGE}/{self.name}.proto", package=PACKAGE, syntax="proto2")
        message = file.message_type.add(name=self.name)
        for number, field in enumerate(self.fields, 1):
            label = FieldDescriptorProto.LABEL_REPEATED if field.shape else FieldDescriptorProto.LABEL_OPTIONAL
            entry = message.field.add(name=field.name, number=number, label=label, type=_KINDS[field.kind][0])
            if field.shape:
                entry.options.packed = True
        return FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)

    @property
    def metadata(self) -> dict[str, str]:
        """Channel metadata: schema version, units, and the shapes of the arrays."""
        units = {f"unit.{f.name}": f.unit for f in self.fields if f.unit}
        shapes = {f"shape.{f.name}": "x".join(map(str, f.shape)) for f in self.fields if f.shape}
        return {"schema_version": SCHEMA_VERSION, **units, **shapes}

    # -- layout
    @cached_property
    def _parts(self) -> tuple[tuple[bytes, Field], ...]:
        """(constant bytes, field) in wire order; an empty packed array has no bytes at all."""
        return tuple((head, field) for head, field in zip(self._heads, self.fields, strict=True) if field.count)

    @cached_property
    def size(self) -> int:
        """Bytes of every message of this type."""
        return sum(len(head) + _KINDS[f.kind][4] * f.count for head, f in self._parts)

    @cached_property
    def constants(self) -> tuple[tuple[int, bytes], ...]:
        """(offset, bytes) of everything in the message that never changes."""
        ends = itertools.accumulate((len(head) + _KINDS[f.kind][4] * f.count for head, f in self._parts), initial=0)
        return tuple((offset, head) for offset, (head, _) in zip(ends, self._parts, strict=False))

    @cached_property
    def wire_dtype(self) -> np.dtype[np.void]:
        """The message's own bytes as a structured type: values at their offsets, tags as gaps."""
        names = [field.name for _, field in self._parts]
        formats = [(_KINDS[field.kind][2], field.shape) for _, field in self._parts]
        offsets = [offset + len(head) for offset, head in self.constants]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size})

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """What decoding gives: all fields, aligned."""
        return np.dtype([(f.name, _KINDS[f.kind][2], f.shape) for f in self.fields], align=True)

    # -- values
    @cached_property
    def _struct(self) -> struct.Struct:
        return struct.Struct("<" + "".join(f"{len(h)}s{f.count}{_KINDS[f.kind][1]}" for h, f in self._parts))

    def encode(self, t: float, values: Sequence[object]) -> bytes:
        """The message's bytes; `values` are the fields after `t`, in order, arrays as (nested) sequences.

        Raises `BadMessage` when a value does not fit its field.
        """
        first, layout, pack = self._layout
        if len(values) != len(layout):
            raise BadMessage(f"{self.topic}: {len(values)} values given for the fields {', '.join(self.value_names)}")
        arguments: list[object] = [first, t]
        for (head, length, field), value in zip(layout, values):  # noqa: B905 - as long as each other
            arguments += head
            if length is None:
                arguments.append(value)
            elif type(value) is tuple and len(value) == length:
                arguments += value
            else:
                arguments += self._flat(field, value)
        try:
            return pack(*arguments)
        except (struct.error, TypeError) as error:
            raise BadMessage(f"{self.topic}: {error} in {dict(zip(self.value_names, values, strict=True))}") from error

    @cached_property
    def _layout(self) -> tuple[bytes, list[tuple[tuple[bytes, ...], int | None, Field]], Callable[..., bytes]]:
        """All that encoding needs, in one look-up: constant bytes of `t`; of each field after it the constant bytes (none where
        an array is empty), and how long a tuple is that needs no check (None: a number, -1: rows of several); what packs."""
        parts: list[tuple[tuple[bytes, ...], int | None, Field]] = []
        for head, field in zip(self._heads[1:], self.fields[1:], strict=True):
            flat = len(field.shape) == 1 or not field.count
            parts.append(((head,) if field.count else (), (field.count if flat else -1) if field.shape else None, field))
        return self._heads[0], parts, self._struct.pack

    @cached_property
    def _heads(self) -> tuple[bytes, ...]:
        return tuple(field.head(number) for number, field in enumerate(self.fields, 1))

    def _flat(self, field: Field, value: object) -> Sequence[object]:
        """The numbers of an array field, checked against its shape."""
        try:
            rows = list(value)  # type: ignore[call-overload]
            numbers = rows if len(field.shape) == 1 else [number for row in rows for number in row]
        except TypeError:
            rows, numbers = [], None
        if numbers is None or len(rows) != field.shape[0] or len(numbers) != field.count:
            raise BadMessage(f"{self.topic} {field.name}: {value!r} is not an array of shape {field.shape}")
        return numbers

    @cached_property
    def value_names(self) -> tuple[str, ...]:
        """Names of the fields after `t`."""
        return tuple(field.name for field in self.fields[1:])

    def fits(self, raw: NDArray[np.uint8]) -> bool:
        """Whether rows of bytes, shape (n, size), all have this layout (tags and lengths where they must be)."""
        if raw.shape[1] != self.size:
            return False
        return all(bool((raw[:, at : at + len(c)] == np.frombuffer(c, np.uint8)).all()) for at, c in self.constants)

    def decode(self, raw: bytes | NDArray[np.uint8]) -> NDArray[np.void]:
        """Messages laid end to end -> structured array of `dtype`. Call `fits` first on foreign bytes."""
        wire = np.frombuffer(raw, self.wire_dtype)
        out = np.zeros(len(wire), self.dtype)
        for _, field in self._parts:
            out[field.name] = wire[field.name]
        return out


_T = Field("t", "double", (), "s", "rig time, a whole number of nanoseconds")

PRESSURE = MessageType("Pressure", "/pressure", (
    _T,
    Field("setpoint", "double", (9,), "Pa", "set-point the regulator confirmed, gauge, by chamber", "chamber"),
    Field("measured", "double", (9,), "Pa", "pressure at the regulator, gauge, by chamber", "chamber"),
), "all chambers of the robot")  # fmt: skip
SPINE = MessageType("Spine", "/spine", (
    _T,
    Field("length", "double", (), "m", "length of the spine"),
    Field("speed", "double", (), "m/s", "of the spine, outwards positive"),
    Field("goal", "double", (), "m", "length it was told to go to"),
    Field("moving", "bool", doc="the spine moves"),
    Field("homed", "bool", doc="the zero of the length is known"),
), "the length unit")  # fmt: skip
VALVE = MessageType("Valve", "/valve", (_T, Field("on", "bool", doc="vacuum applied to the spine, read back")))
VACUUM = MessageType("Vacuum", "/vacuum", (_T, Field("absolute", "double", (), "Pa", "pressure in the spine")))
_WRENCH = "fx fy fz mx my mz"
FORCE = MessageType("Force", "/force", (
    _T,
    Field("raw", "double", (6,), "N, N m", "as the sensor sends it: fx fy fz mx my mz, sensor frame", _WRENCH),
    Field("zero", "double", (6,), "N, N m", "software zero to subtract", _WRENCH),
), "force-torque sensor")  # fmt: skip
ARM = MessageType("Arm", "/arm", (
    _T,
    Field("device_time", "double", (), "s", "the controller's own stamp"),
    Field("joints", "double", (6,), "rad", "angles of the joints, from the base on", "joint"),
    Field("tcp_pose", "double", (6,), "m, rad", "position and rotation vector, arm base frame", "x y z rx ry rz"),
    Field("tcp_speed", "double", (6,), "m/s, rad/s", "of the TCP, arm base frame", "vx vy vz wx wy wz"),
    Field("safety_bits", "fixed32", doc="safety status bits of the controller"),
    Field("program_running", "bool", doc="a program runs on the controller"),
), "state of the robot arm")  # fmt: skip
TIP = MessageType("Tip", "/tip", (
    _T,
    Field("device_time", "double", (), "s", "the camera system's own stamp"),
    Field("frame", "sfixed64", doc="the camera system's frame number"),
    Field("position", "double", (3,), "m", "of the tip, base frame", "x y z"),
    Field("orientation", "double", (4,), "1", "w x y z, body in base frame", "w x y z"),
    Field("marker_error", "double", (), "m", "mean distance of the markers from the rigid body, by the camera system"),
    Field("valid", "bool", doc="False: not tracked, do not use the pose"),
    Field("markers", "double", (0, 3), "m", "body markers, base frame; NaN where one was not seen", "x y z"),
), "the tip as motion capture sees it")  # fmt: skip

STREAMS: dict[str, MessageType] = {m.topic: m for m in (PRESSURE, SPINE, VALVE, VACUUM, FORCE, ARM, TIP)}
"""The streams of a recording with nine chambers and no body markers, by topic."""


def streams(chambers: int = 9, markers: int = 0, sensors: Sequence[MessageType] = ()) -> dict[str, MessageType]:
    """Streams of a recording by topic, for this many chambers and body markers and these sensors of the lab's own (`sensor`)."""
    own = {"/pressure": PRESSURE.sized(setpoint=(chambers,), measured=(chambers,)), "/tip": TIP.sized(markers=(markers, 3))}
    return STREAMS | own | {message.topic: message for message in sensors}


SENSORS = "/sensor/"
"""The topics of sensors of the lab's own begin so; the sensor's name follows."""
_SENSOR_MESSAGE = "Sensor_"
NAME = re.compile(r"[a-z][a-z0-9_]{0,29}")
"""The name of a sensor, and of what it measures."""
MOST_QUANTITIES = 100
"""Of one sensor."""


def sensor(name: str, quantities: Mapping[str, str]) -> MessageType:
    """The stream of a sensor of the lab's own: one number a quantity (name -> unit). Raises `BadMessage`."""
    for text in (name, *quantities):
        if not NAME.fullmatch(text) or text == "t":
            raise BadMessage(
                f"sensor {name[:80]!r}: {text[:80]!r} must be lower-case letters, digits and _, at most 30, and not t"
            )
    if not 1 <= len(quantities) <= MOST_QUANTITIES:
        raise BadMessage(f"sensor {name}: measures {len(quantities)} quantities, must be 1 to {MOST_QUANTITIES}")
    fields = tuple(Field(quantity, "double", (), unit) for quantity, unit in quantities.items())
    return MessageType(_SENSOR_MESSAGE + name, SENSORS + name, (_T, *fields), "a sensor of the lab's own")


def is_stream(topic: str) -> bool:
    """Whether a topic carries samples of an instrument."""
    return topic in STREAMS or topic.startswith(SENSORS)


def stream_message(topic: str, schema: bytes, units: Mapping[str, str]) -> MessageType:
    """The message of a stream of a file: known beforehand, or, of a sensor of the lab's own, as the file's schema states.

    `units`: quantity -> unit. Raises `BadMessage` for a schema that is not of such a sensor.
    """
    if topic in STREAMS:
        return STREAMS[topic]
    name = topic.removeprefix(SENSORS)
    try:
        files = FileDescriptorSet.FromString(schema).file
        fields = [field.name for file in files for message in file.message_type for field in message.field]
    except (DecodeError, ValueError) as error:
        raise BadMessage(f"{topic}: its schema cannot be read: {error}") from error
    if fields[:1] != ["t"] or len(set(fields)) < len(fields):
        raise BadMessage(f"{topic}: its schema is not that of a sensor")
    return sensor(name, {field: units.get(field, "") for field in fields[1:]})


def message_name(topic: str) -> str | None:
    """Full name of the message on a topic of samples; None for any other topic."""
    if topic in STREAMS:
        return STREAMS[topic].full_name
    return f"{PACKAGE}.{_SENSOR_MESSAGE}{topic.removeprefix(SENSORS)}" if topic.startswith(SENSORS) else None
