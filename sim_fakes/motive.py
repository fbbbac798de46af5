"""Fake OptiTrack Motive: a NatNet server (bitstream 4.1, or any from 2.6 to 4.2) that tracks the virtual robot.

Rigid bodies: Tip (1), Base (2), the arm's Flange (3), M1..Mk (11..) at the robot's markers. Frames come at `rate` of
host time at any speed of the rig; their stamps are rig time. Bodies are reported in a Y-up world, with seeded noise, as
32-bit floats. A hidden tip keeps its last pose with the tracking bit cleared.

A client may ask for an older bitstream, when it connects or by the request `Bitstream,3.1`; each is sent its own.

Strict where the device is: frames leave from the data port, only to clients that connected and keep alive, or to a
multicast group; a datagram whose length is not what its header says is dropped, but for the one zero byte that the
maker's own sample sends after requests without content, and for clients of old that count the header too; keep-alive is
not answered.

Faults used: `silent` (nothing is sent), `delay`, `truncate` (frames cut in half), `split` (a frame in two datagrams),
`garbage` (a datagram in front of each), `corrupt` (half of the datagrams are damaged: the network's checksum drops
them), `skew` (of the stamps), `freeze` (poses stand still). By name in `faults.extra`:
- "drop" (int): this many frames are counted and not sent.
- "replay" (bool): the last frame is sent again and again.
- "nan" (bool), "absurd" (bool): the tip's position is NaN, or 1000 km away, yet marked as tracked.
- "zeros" (bool): a hidden tip is reported at zero instead of its last pose.
- "no_body" (bool): the tip is missing in the frames.
- "refuse" (bool): every request is answered with "unrecognized".
- "foreign" (bool): the rigid bodies have other names.
- "restart" (bool): frame numbers start again from 1.
- "jitter" (float): each frame takes up to this longer on its way, s of host time, and others overtake it.
- "twice" (bool): each frame arrives twice.
- "deaf" (int): this many requests to connect or for the models are lost on their way.
- "forget" (bool): all clients are forgotten, as after `CLIENT_TIMEOUT`.
- "exchange" (names of two bodies): each is taken for the other.
- "behind" (float): each frame is sent this long after its cameras' data came, s.
- "changed" (bool): the next frame says that the list of bodies has changed; edit `bodies` before.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import timing
from timing import RigClock

from .instrument import loopback
from .plant import Plant
from .pty_fake import Faults
from .punctual import punctual

Array = NDArray[np.float64]
Transform = tuple[tuple[float, float, float], tuple[float, float, float, float]]


class Message(IntEnum):
    """Kinds of datagrams."""

    CONNECT = 0
    SERVERINFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODELDEF = 4
    MODELDEF = 5
    REQUEST_FRAME = 6
    FRAME = 7
    DISCONNECT = 9
    KEEPALIVE = 10
    ECHO_REQUEST = 12
    ECHO_RESPONSE = 13
    UNRECOGNIZED = 100


Version = tuple[int, int]
OLDEST: Version = (2, 6)
ASKED_VERSION = 265
"""Byte of a request to connect at which the bitstream that a client wants is stated."""
DONE, FAILED = 0, -1
"""Answers to commands."""


class Mode(IntEnum):
    """What `CurrentMode` answers."""

    LIVE = 0
    RECORDING = 1
    EDIT = 2


MODES = {"LiveMode": Mode.LIVE, "StartRecording": Mode.RECORDING, "StopRecording": Mode.LIVE, "EditMode": Mode.EDIT}
"""Command -> the mode that it sets."""

TICKS = 10_000_000
"""Clock frequency of the server's stamps, Hz."""
CLIENT_TIMEOUT = 10.0
"""A client that is silent this long is forgotten, s of host time."""
TIP, BASE, FLANGE, FIRST_MARKER = 1, 2, 3, 11
NOWHERE = np.zeros(3)
HALF = math.sqrt(0.5)
MOCAP_TO_BASE: Transform = ((-0.5, 0.4, 1.2), (HALF, -HALF, 0.0, 0.0))
"""Takes the cameras' Y-up world to the robot's base, which hangs 1.2 m high with z down: position (m), w, x, y, z."""
ARM_TO_BASE = np.array([[0.96, 0.28, 0.0, -0.5], [0.28, -0.96, 0.0, 0.15], [0.0, 0.0, -1.0, 1.1], [0.0, 0.0, 0.0, 1.0]])
"""Pose of the arm's base in the robot's base frame, which nobody has measured."""
BODY_ON_FLANGE = np.array([0.012, -0.035, 0.048, 1.0])
"""Where the body called Flange is fixed, m in the flange's frame, and 1."""


POSE = 32
"""Bytes of a body's number, position and orientation in a frame."""
BODY_MARKER = struct.pack("<i3fif", 1, 0.01, 0, 0, 0, 0.01)
"""One marker of the body itself, which follows its pose before NatNet 3.0."""


def shaken(q: Array, half: Array) -> Array:
    """Quaternion x, y, z, w (w >= 0) turned about its own axes by the small rotation vector 2 `half` (rad)."""
    x, y, z, w = q.tolist()
    a, b, c = half.tolist()
    scale = 1 / math.sqrt(1 + a * a + b * b + c * c)
    real = w - x * a - y * b - z * c
    scale = math.copysign(scale, real)
    product = (x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a, real)
    return scale * np.array(product)


@dataclass
class StreamedBody:
    """A rigid body as the cameras see it, in their world."""

    id: int
    name: str
    position: Array
    quaternion: Array
    """x, y, z, w"""
    tracked: bool = True
    number: int = 0
    """Streaming ID; may be changed, as in Motive."""

    def __post_init__(self) -> None:
        self.number = self.number or self.id


class MotiveFake(timing.Thread):
    """The server: command socket, data socket, and the cameras."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("foreign", True),
        "nak": ("refuse", True),
        "over_range": ("nan", True),
        "replay": ("replay", True),
    }

    def __init__(
        self,
        plant: Plant,
        clock: RigClock,
        host: str = "127.0.0.1",
        command_port: int = 1510,
        data_port: int = 1511,
        version: Version = (4, 1),
        rate: float = 100.0,
        mocap_to_base: Transform = MOCAP_TO_BASE,
        markers: int = 3,
        noise: float = 0.3e-3,
        angle_noise: float = math.radians(0.2),
        seed: int = 0,
        group: str = "",
    ) -> None:
        """`rate` in Hz of host time; `noise` (m) and `angle_noise` (rad) are one sigma per axis and frame; `group`: address of
        the multicast group that frames are sent to, instead of to each client."""
        super().__init__(name="fake-motive", daemon=True)
        self.plant, self.clock = plant, clock
        self.host = loopback(host)
        self.version = version
        self.rate = rate
        self.markers = markers
        self.noise, self.angle_noise = noise, angle_noise
        self.faults = Faults()
        self.frame = 0
        self.messages: list[int] = []
        """Ids of the messages received, keep-alive left out."""
        self.keep_alives = 0
        self.mocap_to_base = {"position": list(mocap_to_base[0]), "quaternion": list(mocap_to_base[1])}
        """The calibration that a person would write into rig.yaml."""
        self._origin = np.array(mocap_to_base[0])
        self._rotation = Rotation.from_quat(np.roll(mocap_to_base[1], -1)).as_matrix()
        self._random = np.random.default_rng(seed)
        self._unturned = self._xyzw(np.eye(3))
        """Of a body that stands as the base does, x, y, z, w."""
        self._tip_turn = np.eye(3), self._unturned
        """The tip's rotation in the base frame at the last reading, and its quaternion."""
        self._data_port = data_port
        self._command = self._socket(command_port)
        self._data = self._socket(data_port)
        self._group = group
        if group:
            self._data.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(self.host))
        self.other_definitions: list[tuple[int, bytes]] = []
        """Model definitions (kind, content) that are sent before those of the rigid bodies."""
        self.clients: dict[tuple[str, int], float] = {}
        """The known clients, and when each was last heard, s of host time."""
        names = [(TIP, "Tip"), (BASE, "Base"), *((FIRST_MARKER + i, f"M{i + 1}") for i in range(markers)), (FLANGE, "Flange")]
        self._bodies = [StreamedBody(i, name, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])) for i, name in names]
        self.versions: dict[tuple[str, int], Version] = {}
        """Bitstream of each client that asked for another than the server's own."""
        self.mode = Mode.LIVE
        self._last_frames: dict[Version, bytes] = {}
        self._outgoing: list[tuple[float, socket.socket, tuple[str, int], bytes]] = []
        self._running = True
        self._look()

    @property
    def bodies(self) -> list[StreamedBody]:
        """The rigid bodies; they may be renamed, numbered anew, removed, as a person does in Motive."""
        return self._bodies

    def stop(self) -> None:
        """End the thread and close the sockets."""
        self._running = False
        if self.is_alive():
            self.join(1.0)
        self._command.close()
        self._data.close()

    def run(self) -> None:
        punctual()
        due = timing.now()
        while self._running:
            ready = timing.readable([self._command], min(0.05, due - timing.now()))
            if ready:
                self._serve()
            self._deliver()
            now = timing.now()
            if now >= due:
                due = max(due + 1 / self.rate, now - 5 / self.rate)
                self._stream(now)

    # -- wire
    def _socket(self, port: int) -> socket.socket:
        s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        s.bind((self.host, port))
        return s

    def _send(self, via: socket.socket, client: tuple[str, int], message: int, payload: bytes) -> None:
        """Put a datagram on its way, through the faults."""
        f = self.faults
        if f.silent:
            return
        datagram = struct.pack("<HH", message, len(payload)) + payload
        if f.corrupt and self._random.random() < 0.5:
            return
        pieces = [datagram[: len(datagram) // 2], datagram[len(datagram) // 2 :]] if f.split else [datagram]
        due = timing.now() + f.delay
        if message == Message.FRAME:
            due += float(f.extra.get("jitter", 0.0)) * self._random.random()  # type: ignore[arg-type]
            pieces *= 2 if f.extra.get("twice") else 1
        self._outgoing += [(due, via, client, piece) for piece in ([f.garbage] if f.garbage else []) + pieces]
        self._deliver()

    def _deliver(self) -> None:
        """Send what is due."""
        now = timing.now()
        self._outgoing.sort(key=lambda waiting: waiting[0])
        while self._outgoing and self._outgoing[0][0] <= now:
            _, via, client, piece = self._outgoing.pop(0)
            with contextlib.suppress(OSError):
                via.sendto(piece, client)

    def _serve(self) -> None:
        """Take one datagram and answer it."""
        data, client = self._command.recvfrom(65536)
        if len(data) < 4:
            return
        message, size = struct.unpack("<HH", data[:4])
        payload = data[4 : 4 + size]
        if len(data) not in (4 + size, size) and not (size == 0 and data[4:] == b"\0"):
            return  # its length is not what its header says
        if message == Message.KEEPALIVE:
            self.keep_alives += 1
            if client in self.clients:
                self.clients[client] = timing.now()
            return
        self.messages.append(message)
        deaf = self.faults.extra.get("deaf", 0)
        if isinstance(deaf, int) and deaf > 0:
            self.faults.extra["deaf"] = deaf - 1
            return
        if message == Message.DISCONNECT:
            self.clients.pop(client, None)
            return
        if message == Message.CONNECT:
            self.clients[client] = timing.now()
            self._want(client, payload[ASKED_VERSION : ASKED_VERSION + 2])
        self._send(self._command, client, *self._answer(message, payload, client))

    def _want(self, client: tuple[str, int], version: bytes) -> bool:
        """Send a client this bitstream from now on, or the server's own; False where there is no such."""
        self.versions.pop(client, None)
        if len(version) == 2 and OLDEST <= (version[0], version[1]) <= self.version:
            self.versions[client] = version[0], version[1]
        return client in self.versions

    def _answer(self, message: int, payload: bytes, client: tuple[str, int]) -> tuple[int, bytes]:
        """Kind and content of the datagram that answers a request."""
        if self.faults.extra.get("refuse"):
            return Message.UNRECOGNIZED, b""
        if message == Message.CONNECT:
            return Message.SERVERINFO, self._server_info()
        if message == Message.REQUEST_MODELDEF:
            return Message.MODELDEF, self._definitions(self.versions.get(client, self.version))
        if message == Message.REQUEST_FRAME:
            self._look()
            return Message.FRAME, self._frame_payload(self.versions.get(client, self.version))
        if message == Message.ECHO_REQUEST and len(payload) >= 8:
            return Message.ECHO_RESPONSE, payload[:8] + struct.pack("<Q", self._ticks())
        if message == Message.REQUEST:
            return Message.RESPONSE, self._command_answer(payload.rstrip(b"\0").decode("ascii", "replace"), client)
        return Message.UNRECOGNIZED, b""

    def _command_answer(self, command: str, client: tuple[str, int]) -> bytes:
        """What Motive says to a remote request; commands get a number, 0 for done."""
        name, _, value = command.partition(",")
        if name == "Bitstream" and not value:
            return "Bitstream,{}.{}".format(*self.versions.get(client, self.version)).encode()
        if name == "Bitstream":
            asked = bytes(int(part) for part in value.split(".")[:2] if part.isdigit() and int(part) < 256)
            return struct.pack("<i", DONE if self._want(client, asked) else FAILED)
        if name in ("FrameRate", "UnitsToMillimeters"):
            return struct.pack("<f", self.rate if name == "FrameRate" else 1000.0)
        self.mode = MODES.get(name, self.mode)
        numbers = dict.fromkeys((*MODES, "SetRecordTakeName"), DONE)
        numbers |= {"CurrentMode": self.mode, "AnalogSamplesPerMocapFrame": 0}
        return struct.pack("<i", numbers.get(name, FAILED))

    def _server_info(self) -> bytes:
        versions = bytes((3, 1, 0, 0, *self.version, 0, 0))
        group = socket.inet_aton(self._group or "0.0.0.0")
        tail = struct.pack("<QH?4s", TICKS, self._data_port, bool(self._group), group)
        return b"Motive".ljust(256, b"\0") + versions + (tail if self.version >= (3, 0) else b"")

    def _definitions(self, version: Version) -> bytes:
        """The model definitions as NatNet `version` has them."""
        definitions = list(self.other_definitions)
        for body in self._bodies:
            name = f"Other{body.id}" if self.faults.extra.get("foreign") else body.name
            d = name.encode() + b"\0" + struct.pack("<ii3f", body.number, -1, 0, 0, 0)
            if version >= (4, 2):
                d += struct.pack("<4f", 0, 0, 0, 1)
            if version >= (3, 0):
                d += struct.pack("<i3fi", 1, 0.01, 0.0, 0.0, 0)
            if version >= (4, 0):
                d += b"Marker1\0"
            definitions.append((1, d))
        sized = version >= (4, 1)
        parts = (struct.pack("<i", kind) + (struct.pack("<i", len(d)) if sized else b"") + d for kind, d in definitions)
        return struct.pack("<i", len(definitions)) + b"".join(parts)

    # -- frames
    def _stream(self, now: float) -> None:
        """Count a frame and send it to the group, or to each client in its bitstream, at host time `now`."""
        extra = self.faults.extra
        forget = extra.pop("forget", False)
        self.clients = {c: t for c, t in self.clients.items() if now - t < CLIENT_TIMEOUT and not forget}
        if not (self.clients or self._group):
            self.frame += 1
            return
        versions = {self.versions.get(c, self.version) for c in self.clients} | {self.version}
        if not (extra.get("replay") and self._last_frames.keys() >= versions):
            self.frame = 1 if extra.pop("restart", False) else self.frame + 1
            if not self.faults.freeze:
                self._look()
            bodies_changed = bool(extra.pop("changed", False))
            self._last_frames = {version: self._frame_payload(version, bodies_changed) for version in versions}
        drop = extra.get("drop", 0)
        if isinstance(drop, int) and drop > 0:
            extra["drop"] = drop - 1
            return
        for client in [(self._group, self._data_port)] if self._group else self.clients:
            payload = self._last_frames[self.versions.get(client, self.version)]
            self._send(self._data, client, Message.FRAME, payload[: len(payload) // 2] if self.faults.truncate else payload)

    def _look(self) -> None:
        """The cameras' view of the plant, with noise."""
        with self.plant.lock:
            tip, rotation = self.plant.tip_position.copy(), self.plant.tip_rotation.copy()
            markers, visible = self.plant.markers.copy(), self.plant.tip_visible
            arm = self.plant.flange
        if not np.array_equal(rotation, self._tip_turn[0]):
            self._tip_turn = rotation, self._xyzw(rotation)
        seen = {TIP: (tip, self._tip_turn[1], visible), BASE: (NOWHERE, self._unturned, True)}
        seen |= {FIRST_MARKER + k: (place, self._unturned, True) for k, place in enumerate(markers)}
        if arm is not None:
            flange = ARM_TO_BASE @ arm
            seen[FLANGE] = flange[:3] @ BODY_ON_FLANGE, self._xyzw(flange[:3, :3]), visible
        for body in self._bodies:
            self._see(body, *seen.get(body.id, (NOWHERE, self._unturned, False)))

    def _xyzw(self, rotation: Array) -> Array:
        """Quaternion x, y, z, w (w >= 0) in the world of a rotation (3, 3) in the base frame."""
        return np.asarray(Rotation.from_matrix(self._rotation.T @ rotation).as_quat(canonical=True))

    def _see(self, body: StreamedBody, position: Array, turn: Array, visible: bool) -> None:
        """Position in the base frame, orientation in the world -> world, plus noise; an unseen body keeps its pose."""
        body.tracked = visible
        if not visible:
            return
        noise = self._random.standard_normal(6)
        body.position = self._rotation.T @ (position - self._origin) + self.noise * noise[3:]
        body.quaternion = shaken(turn, 0.5 * self.angle_noise * noise[:3])

    def _frame_payload(self, version: Version, bodies_changed: bool = False) -> bytes:
        """A frame of mocap data as NatNet `version` has it; `bodies_changed`: it says that the list of bodies has changed."""
        shown = [b for b in self._bodies if not (b.id == TIP and self.faults.extra.get("no_body"))]
        encoded = [self._body(body) for body in shown]
        if version < (3, 0):
            encoded = [body[:POSE] + BODY_MARKER + body[POSE:] for body in encoded]
        bodies = b"".join(encoded)
        sections = [(0, b""), (0, b""), (len(shown), bodies), (0, b"")]
        # marker sets, unlabelled markers, rigid bodies, skeletons; then assets, labelled markers, plates, devices
        sections += [(0, b"") for since in ((4, 1), (2, 3), (2, 9), (2, 11)) if version >= since]
        payload = struct.pack("<i", self.frame)
        for count, content in sections:
            size = struct.pack("<i", len(content)) if version >= (4, 1) else b""
            payload += struct.pack("<i", count) + size + content
        payload += b"" if version >= (3, 0) else struct.pack("<f", 0.0)  # latency
        payload += struct.pack("<IId" if version >= (2, 7) else "<IIf", 0, 0, self.clock.now() * self.faults.skew)
        if version >= (3, 0):
            ticks = self._ticks()
            behind = int(float(self.faults.extra.get("behind", 0.001)) * TICKS)  # type: ignore[arg-type]
            received = ticks + 20_000  # 2 ms after the exposure
            payload += struct.pack("<QQQ", ticks, received, received + behind)
        if version >= (4, 1):
            payload += struct.pack("<II", 0, 0)
        return payload + struct.pack("<hI", (self.mode == Mode.RECORDING) | bodies_changed << 1, 0)

    def _taken_for(self, body: StreamedBody) -> StreamedBody:
        """The body whose pose is sent under the name of this one."""
        pair = self.faults.extra.get("exchange", ())
        names = pair if isinstance(pair, (list, tuple)) and body.name in pair else ()
        return next((b for b in self._bodies if b.name in names and b is not body), body)

    def _body(self, body: StreamedBody) -> bytes:
        extra, seen = self.faults.extra, self._taken_for(body)
        position, quaternion = seen.position, seen.quaternion
        if body.id == TIP:
            if extra.get("nan"):
                position = np.full(3, np.nan)
            if extra.get("absurd"):
                position = np.full(3, 1e6)
            if extra.get("zeros") and not seen.tracked:
                position, quaternion = np.zeros(3), np.zeros(4)
        return struct.pack("<i3f4ffh", body.number, *position, *quaternion, self.noise, int(seen.tracked))

    def _ticks(self) -> int:
        return int(self.clock.now() * TICKS)
