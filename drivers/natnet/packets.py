"""NatNet datagrams, versions 2.6 to 4.x: who the server is, which rigid bodies it has, and where they are in a frame.

Reading a datagram costs at most its own size: every count and size is checked against the bytes that are left. Only
rigid bodies are read. From version 4.1 on everything else is skipped by its stated size, before that by its layout. What
cannot be read is named with its byte, counted from the beginning of the datagram.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace

CONNECT, SERVERINFO, REQUEST, RESPONSE, REQUEST_MODELDEF, MODELDEF, FRAME, DISCONNECT, KEEPALIVE = 0, 1, 2, 3, 4, 5, 7, 9, 10
CURRENT_MODE, LIVE, EDIT = b"CurrentMode\0", 0, 2
"""A command, and two of its answers; Motive has no other sign of Edit mode of which SDK and examples say the same."""
Version = tuple[int, int]
OLDEST: Version = (2, 6)
"""First version in which a body says whether it is tracked."""
HEADER = struct.Struct("<HH")
NUMBER = struct.Struct("<i")
PAIR = struct.Struct("<ii")
POSE = struct.Struct("<i3f4f")
QUALITY = struct.Struct("<fh")
KINDS = ("marker set", "rigid body", "skeleton", "force plate", "device", "camera", "asset")
"""What a model definition may be of, by its number on the wire."""


class Unreadable(ValueError):
    """A datagram, or a part of it, that is not as NatNet has it; the message names the part and its byte."""


class Short(Exception):
    """Fewer bytes are left than are needed."""


@dataclass(frozen=True)
class ServerInfo:
    """Who answered; `group` is the address of its multicast group, empty where frames come to each client."""

    application: str
    application_version: str
    version: Version
    data_port: int = 0
    group: str = ""
    frequency: float = 0.0
    """Of the ticks in which the server's computer counts, Hz; 0 where it is not stated."""


@dataclass(frozen=True)
class RigidBody:
    """A rigid body in a frame, in Motive's world: m, quaternion x, y, z, w."""

    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    error: float
    tracked: bool


@dataclass(frozen=True)
class MocapFrame:
    """One frame; `stamp` (s) is the server's. A number that two bodies share stands for None."""

    number: int
    stamp: float
    bodies: dict[int, RigidBody | None]
    models_changed: bool
    taken: int = 0
    """Ticks of the server's computer from the cameras' data to the sending; 0 where they are not stated."""


@dataclass(frozen=True)
class Definitions:
    """Rigid bodies (name, number) in the order of the datagram, and what of it cannot be read."""

    bodies: tuple[tuple[str, int], ...]
    unread: tuple[str, ...]


class Cursor:
    """A place in a datagram that advances; raises Short rather than pass the end."""

    def __init__(self, data: bytes, at: int, end: int) -> None:
        self.data, self.at, self.end = data, at, end

    @property
    def left(self) -> int:
        return self.end - self.at

    def skip(self, size: int) -> int:
        """Pass over `size` bytes; returns where they begin."""
        start = self.at
        if not 0 <= size <= self.end - start:
            raise Short
        self.at = start + size
        return start

    def unpack(self, layout: struct.Struct) -> tuple[float, ...]:
        return layout.unpack_from(self.data, self.skip(layout.size))

    def count(self, least: int) -> int:
        """A count of things of which each takes at least `least` bytes."""
        (count,) = NUMBER.unpack_from(self.data, self.skip(NUMBER.size))
        if not 0 <= count * least <= self.left:
            raise Short
        return int(count)

    def text(self) -> str:
        """A text that ends with NUL; what is not UTF-8 is read as Latin-1, as older Windows programs write it."""
        end = self.data.find(b"\0", self.at, self.end)
        if end < 0:
            raise Short
        return _decoded(self.data[self.skip(end + 1 - self.at) : end])

    def texts(self) -> None:
        """Pass over a counted list of texts."""
        for _ in range(self.count(1)):
            self.text()


def message(data: bytes) -> tuple[int, Cursor]:
    """Kind of a datagram, and its content; raises Unreadable for one without a header or shorter than that says."""
    if len(data) < HEADER.size:
        raise Unreadable(f"a datagram of {len(data)} bytes has no NatNet header")
    kind, size = HEADER.unpack_from(data)
    if HEADER.size + size > len(data):
        raise Unreadable(f"a datagram states {size} bytes at byte 2 and has {len(data) - HEADER.size}")
    return kind, Cursor(data, HEADER.size, HEADER.size + size)


def server_info(c: Cursor) -> ServerInfo:
    """Read who answered; raises Unreadable."""
    try:
        name = c.data[c.skip(256) : c.at]
        application, version = (c.data[c.skip(4) : c.at] for _ in range(2))
    except Short:
        raise Unreadable(f"the server's description ends at byte {c.end}, it must have {HEADER.size + 264}") from None
    info = ServerInfo(_decoded(name.split(b"\0")[0]), ".".join(map(str, application)), (version[0], version[1]))
    if c.left < 15:
        return info
    frequency, port, multicast = struct.unpack_from("<QH?", c.data, c.at)
    group = ".".join(map(str, c.data[c.at + 11 : c.at + 15])) if multicast else ""
    return replace(info, data_port=port, group=group, frequency=float(frequency))


def mode(c: Cursor) -> int:
    """What `CURRENT_MODE` is answered with; raises Unreadable."""
    if c.left != 4:
        raise Unreadable(f"the answer to CurrentMode has {c.left} bytes, it must have 4")
    return int(c.unpack(struct.Struct("<i"))[0])


# -- model definitions
def definitions(c: Cursor, version: Version) -> Definitions:
    """The rigid bodies that can be read, and a sentence for each definition that cannot."""
    bodies: list[tuple[str, int]] = []
    unread: list[str] = []
    start, part_name = c.at, "the count of model definitions"
    try:
        for _ in range(int(c.unpack(NUMBER)[0])):
            start, part_name = c.at, "model definition"
            kind = int(c.unpack(NUMBER)[0])
            part_name = f"{KINDS[kind]} definition" if 0 <= kind < len(KINDS) else f"definition of the unknown kind {kind}"
            if version >= (4, 1):
                size = int(c.unpack(NUMBER)[0])
                part = Cursor(c.data, c.skip(size), c.at)
            else:
                part = c
            try:
                if kind == 1:
                    bodies.append((part.text(), int(part.unpack(NUMBER)[0])))
                if part is c:
                    _pass_definition(c, kind, version)
            except Short:
                if part is c:
                    raise
                unread.append(f"{part_name} at byte {start} cannot be read")
    except Short:
        unread.append(f"{part_name} at byte {start} cannot be read, nor what follows it")
    return Definitions(tuple(bodies), tuple(unread))


def _pass_definition(c: Cursor, kind: int, version: Version) -> None:
    """Pass over a definition that does not state its size; of a rigid body, name and number have been read."""
    if kind == 0:  # name, names of markers
        c.text()
        c.texts()
    elif kind == 1:
        _pass_body_definition(c, version)
    elif kind == 2:  # name, number, bones: each name, number, body
        c.text()
        c.skip(4)
        for _ in range(c.count(1)):
            c.text()
            c.skip(4)
            _pass_body_definition(c, version)
    elif kind == 3:  # number, serial number, size, origin, calibration, four corners, two types, channels
        c.skip(4)
        c.text()
        c.skip(4 * (2 + 3 + 144 + 12 + 2))
        c.texts()
    elif kind == 4:  # number, name, serial number, two types, channels
        c.skip(4)
        c.text()
        c.text()
        c.skip(8)
        c.texts()
    elif kind == 5:  # name, position, orientation
        c.text()
        c.skip(28)
    else:
        raise Short


def _pass_body_definition(c: Cursor, version: Version) -> None:
    """Parent and offset, then from 3.0 on the markers, with names from 4.0 on."""
    c.skip(16)
    if version >= (3, 0):
        count = c.count(16)
        c.skip(16 * count)
        for _ in range(count if version >= (4, 0) else 0):
            c.text()


# -- frames
Skip = Callable[[Cursor, Version], object]


def _pass_skeleton(c: Cursor, version: Version) -> None:
    c.skip(4)
    for _ in range(c.count(1)):
        _body(c, version)


def _pass_channels(c: Cursor, version: Version) -> None:
    """A force plate or another device."""
    c.skip(4)
    for _ in range(c.count(4)):
        c.skip(4 * c.count(4))


def _body(c: Cursor, version: Version) -> tuple[int, RigidBody]:
    number, x, y, z, qx, qy, qz, qw = c.unpack(POSE)
    if version < (3, 0):
        c.skip(20 * c.count(20))
    error, bits = c.unpack(QUALITY)
    return int(number), RigidBody((x, y, z), (qx, qy, qz, qw), error, bool(int(bits) & 1))


SECTIONS: tuple[tuple[str, Version, Skip], ...] = (
    ("marker sets", (0, 0), lambda c, _: (c.text(), c.skip(12 * c.count(12)))),
    ("unlabelled markers", (0, 0), lambda c, _: c.skip(12)),
    ("rigid bodies", (0, 0), _body),
    ("skeletons", (2, 1), _pass_skeleton),
    ("assets", (4, 1), lambda c, _: None),
    ("labelled markers", (2, 3), lambda c, version: c.skip(26 if version >= (3, 0) else 22)),
    ("force plates", (2, 9), _pass_channels),
    ("devices", (2, 11), _pass_channels),
)
"""Parts of a frame in their order, the first version that has each, and how to pass over one of its things."""


def frame(c: Cursor, version: Version) -> MocapFrame:
    """Read a frame; raises Unreadable where a part of it cannot be read."""
    start, section = c.at, "the frame's number"
    bodies: dict[int, RigidBody | None] = {}
    try:
        number = int(c.unpack(NUMBER)[0])
        for section, since, skip_one in SECTIONS:
            if version < since:
                continue
            start, part = c.at, c
            if version >= (4, 1):
                count, size = (int(n) for n in c.unpack(PAIR))
                part = Cursor(c.data, c.skip(size), c.at)
                if section != "rigid bodies":
                    continue
                if not 0 <= count <= size:
                    raise Short
            else:
                count = c.count(4)
            for _ in range(count):
                if section == "rigid bodies":
                    body_number, body = _body(part, version)
                    bodies[body_number] = None if body_number in bodies else body
                else:
                    skip_one(c, version)
        start, section = c.at, "the frame's end"
        stamp, bits, ticks = _suffix(c, version)
    except Short:
        raise Unreadable(f"{section} at byte {start} cannot be read") from None
    return MocapFrame(number, stamp, bodies, models_changed=bool(bits & 2), taken=ticks)


def _suffix(c: Cursor, version: Version) -> tuple[float, int, int]:
    """Server's stamp (s), the frame's parameters, ticks from cameras to sending; the length shows what is there."""
    if version < (3, 0):  # latency, time code, stamp, parameters, end tag
        stamp = struct.Struct("<d" if version >= (2, 7) else "<f")
        c.skip(12 if c.left >= 12 + stamp.size + 2 + 4 else 8)
        return c.unpack(stamp)[0], int(c.unpack(struct.Struct("<h"))[0]), 0
    c.skip(8)
    stamp_at = c.unpack(struct.Struct("<d"))[0]
    _, received, sent = (int(ticks) for ticks in c.unpack(struct.Struct("<3Q")))
    c.skip(8 if c.left >= 8 + 2 else 0)  # perhaps the precision time
    return stamp_at, int(c.unpack(struct.Struct("<h"))[0]), max(0, sent - received) if received else 0


def _decoded(text: bytes) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")
