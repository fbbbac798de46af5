"""Motion capture: one rigid body (the tip) streamed by OptiTrack Motive over NatNet unicast, by the natnet package.

Poses are turned into the robot's base frame here. A body that the cameras have lost keeps coming with its last pose and
a cleared tracking bit: such a sample is delivered with `valid` False and its position as received, which must not be
used. NaN and impossible values are treated alike. `latest` returns valid samples only.

Markers along the robot's body are further rigid bodies, called by name; one that is not tracked has NaN coordinates.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import threading
import time
from collections import deque
from collections.abc import Callable

from natnet.data_descriptions import DataDescriptions
from natnet.data_frame import DataFrame, RigidBody
from natnet.exceptions import NatNetError
from pydantic import BaseModel, Field, field_validator, model_validator

from ..configs import MocapConfig
from ..errors import DeviceFault, NotReady, StaleReading, Unreachable, WrongDevice
from ..frames import apply, compose, matrix_from_quaternion
from ..interfaces import BodySample, Clock, Identity, Quaternion, Sink, Vector3
from ..spec import Driver
from .wire import ServerClient

OLDEST_VERSION = (3, 0)
"""First NatNet version whose frames have the layout relied on here."""
LONGEST_WAIT = 0.02
"""s until the sockets are looked at again though nothing has come: to keep alive, and to end."""
PAUSE = 0.001
"""s, after what could not be read."""
ASK_AGAIN = 0.3
"""Pause before a request is repeated, s: datagrams get lost."""
FARTHEST = 20.0
"""No camera volume is larger, m."""
LATE_FRAMES = 10
"""A frame number this little behind the newest is a late datagram; one further behind means a restarted server."""
NOWHERE: Vector3 = (math.nan, math.nan, math.nan)


class Pose(BaseModel):
    """A rigid transform: p_base = R(quaternion) p_mocap + position."""

    position: Vector3 = Field(json_schema_extra={"unit": "m"})
    quaternion: Quaternion = Field(json_schema_extra={"unit": ""})
    """w, x, y, z"""

    @field_validator("quaternion")
    @classmethod
    def _unit_length(cls, q: Quaternion) -> Quaternion:
        length = math.hypot(*q)
        if abs(length - 1) > 1e-3:
            raise ValueError(f"a quaternion w, x, y, z must have length 1; this one has {length:.4g}")
        return (q[0] / length, q[1] / length, q[2] / length, q[3] / length)


class Config(MocapConfig):
    """Motion capture by NatNet."""

    server: str
    """Address of the computer that runs Motive; nobody else is heard."""
    local: str = ""
    """Address of this computer in Motive's network, on which alone it listens; empty: the one that leads there."""
    command_port: int = Field(default=1510, ge=1, le=65535, json_schema_extra={"unit": ""})
    data_port: int = Field(default=1511, ge=1, le=65535, json_schema_extra={"unit": ""})
    body: str
    """Name of the tip's rigid body in Motive."""
    mocap_to_base: Pose
    """Takes Motive's world (Y up or Z up, as set there) to the robot's base frame; from the calibration of the rig."""
    rate: float = Field(default=100.0, ge=1, le=1000, json_schema_extra={"unit": "Hz"})
    """Frame rate set in Motive."""
    timeout: float = Field(default=2.0, gt=0, le=30, json_schema_extra={"unit": "s"})

    @model_validator(mode="after")
    def _age_spans_frames(self) -> Config:
        if self.max_age < 2 / self.rate:
            raise ValueError(f"max_age {self.max_age} s is less than two frames at {self.rate} Hz; raise one of them")
        return self


class NatNetMocap:
    """Motion capture; see the module's text."""

    def __init__(
        self,
        name: str,
        config: Config,
        clock: Clock,
        sink: Sink[BodySample],
        notice: Callable[[str], None] = lambda text: None,
    ) -> None:
        """`notice` is called once after each `open` when anything but the server sends datagrams here, with a sentence."""
        self.name = name
        self.lost = 0
        """Frames missing in the server's count."""
        self._config = config
        self._clock = clock
        self._sink = sink
        self._notice = notice
        self._elsewhere = ""
        """The first address that was not the server's."""
        self._rotation = matrix_from_quaternion(config.mocap_to_base.quaternion)
        self._client: ServerClient | None = None
        self._frames: deque[DataFrame] = deque()
        self._descriptions: deque[DataDescriptions] = deque()
        self._ids: dict[str, int] = {}
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._started = threading.Event()
        self._lock = threading.Lock()
        self._newest: BodySample | None = None
        self._newest_at = -math.inf
        self._valid: BodySample | None = None
        self._valid_at = -math.inf

    def open(self) -> Identity:
        """Connect, find the bodies by name, wait for the first frame, start the stream.

        Raises `Unreachable` (no server, no frames) or `WrongDevice` (not NatNet, too old, body unknown), within three
        times the time-out.
        """
        self.close()
        self._elsewhere = ""
        client = self._client_of_server()
        client.on_data_frame_received_event.handlers.append(self._frames.append)
        client.on_data_description_received_event.handlers.append(self._descriptions.append)
        try:
            identity = self._meet(client)
        except BaseException:
            client.shutdown()
            raise
        self._client = client
        self._stopping.clear()
        self._started.clear()
        self._thread = threading.Thread(target=self._run, args=(client,), name=f"natnet-{self.name}", daemon=True)
        self._thread.start()
        self._started.wait(self._config.timeout)  # the first frame is here; `latest` is to find it
        return identity

    def close(self) -> None:
        """End the stream and disconnect."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(1.0)
        self._thread = None
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(OSError, NatNetError):
                client.send_request(client.NAT_DISCONNECT)
            with contextlib.suppress(OSError):
                client.shutdown()
        self._frames.clear()
        self._descriptions.clear()
        self._newest = self._valid = None

    def latest(self) -> BodySample:
        """The newest valid sample.

        Older than `max_age`, it raises `DeviceFault` when frames arrive without the body being tracked, `StaleReading`
        when none arrive.
        """
        if self._client is None:
            raise NotReady(self.name, "not open; call open() first")
        with self._lock:
            valid, valid_at, newest_at = self._valid, self._valid_at, self._newest_at
        now = time.monotonic()
        if valid is not None and now - valid_at <= self._config.max_age:
            return valid
        if now - newest_at <= self._config.max_age:
            since = "since the start" if valid is None else f"for {now - valid_at:.2f} s"
            raise DeviceFault(
                self.name,
                f"{self._config.body!r} has not been tracked {since} (limit {self._config.max_age} s); clear the "
                "cameras' view of it",
            )
        raise StaleReading(
            self.name,
            f"no frame for {now - newest_at:.2f} s (limit {self._config.max_age} s); check that Motive is live and the "
            f"network to {self._config.server}",
        )

    # -- connecting
    def _client_of_server(self) -> ServerClient:
        config = self._config
        try:
            return ServerClient(
                config.server, config.local, (config.command_port, config.data_port), self._heard_elsewhere
            )
        except (OSError, UnicodeError) as e:
            raise Unreachable(
                self.name,
                f"{config.server} cannot be reached from here ({e}); check server in rig.yaml and the network",
            ) from e

    def _heard_elsewhere(self, address: str) -> None:
        """Somebody who is not the server has sent a datagram; it was thrown away."""
        if self._elsewhere:
            return
        self._elsewhere = address
        self._notice(
            f"{self.name}: datagrams from {address} are ignored, only those of {self._config.server} are accepted; find "
            "out who sends them, or correct server in rig.yaml"
        )

    def _meet(self, client: ServerClient) -> Identity:
        config = self._config
        where = f"{config.server}:{config.command_port}"
        try:
            client.connect(timeout=config.timeout)
        except TimeoutError as e:
            other = f" (datagrams from {self._elsewhere} were ignored)" if self._elsewhere else ""
            raise Unreachable(
                self.name,
                f"no NatNet server answers at {where} within {config.timeout} s{other}; check that Motive streams (Data "
                "Streaming on), the addresses in rig.yaml and the firewall",
            ) from e
        except (OSError, NatNetError) as e:
            raise Unreachable(
                self.name,
                f"cannot communicate from {config.local or 'here'} to {where} ({e}); check both addresses in rig.yaml",
            ) from e
        except Exception as e:  # whatever the client makes of a datagram that is not NatNet
            raise WrongDevice(self.name, f"the device at {where} is not a NatNet server ({e!r})") from e
        info = client.server_info
        version = info.nat_net_protocol_version.components[:2]
        speaks = f"NatNet {version[0]}.{version[1]}"
        if version < OLDEST_VERSION:
            raise WrongDevice(self.name, f"{where} speaks {speaks}; 3.0 is the oldest supported version: update Motive")
        self._ids = self._find_bodies(client, where)
        self._wait(client, lambda: bool(self._frames), "frames; set Motive to live, and its transmission to unicast")
        return Identity("OptiTrack", f"{info.application_name}, {speaks}", firmware=str(info.server_version))

    def _find_bodies(self, client: ServerClient, where: str) -> dict[str, int]:
        """Ids of the tip's and the markers' bodies."""
        self._wait(client, lambda: bool(self._descriptions), "model definitions", client.request_modeldef)
        ids = {body.name: body.id_num for body in self._descriptions[-1].rigid_bodies}
        for name in (self._config.body, *self._config.markers):
            if name not in ids:
                near = difflib.get_close_matches(name, ids, n=1, cutoff=0.0)
                hint = f"the nearest name is {near[0]!r}" if near else "there are no rigid bodies at all"
                raise WrongDevice(
                    self.name, f"{where} has no rigid body {name!r}; {hint}. Correct the name in rig.yaml or in Motive"
                )
        return ids

    def _wait(
        self, client: ServerClient, done: Callable[[], bool], what: str, ask: Callable[[], None] | None = None
    ) -> None:
        """Serve the sockets until `done`, asking again and again; raises `Unreachable` after the time-out."""
        deadline = time.monotonic() + self._config.timeout
        ask_at = -math.inf
        while not done():
            now = time.monotonic()
            if now > deadline:
                raise Unreachable(
                    self.name, f"{self._config.server} answers, but within {self._config.timeout} s sent no {what}"
                )
            if ask is not None and now >= ask_at:
                ask_at = now + ASK_AGAIN
                ask()
            self._serve(client)

    def _serve(self, client: ServerClient) -> None:
        """Take what has arrived. A damaged datagram is dropped; the count of frames will show it."""
        try:
            client.wait(LONGEST_WAIT)
            client.update_sync()
        except Exception:  # the client raises whatever unpacking raises, and the network whatever it likes
            time.sleep(PAUSE)

    # -- streaming
    def _run(self, client: ServerClient) -> None:
        while not self._stopping.is_set():
            self._serve(client)
            while self._frames:
                self._take(self._frames.popleft())

    def _take(self, frame: DataFrame) -> None:
        number = frame.prefix.frame_number
        last = self._newest.frame if self._newest is not None else number - 1
        if last - LATE_FRAMES < number <= last:
            return  # sent twice, or overtaken and already counted as lost
        self.lost += max(0, number - last - 1) if number > last else 0
        bodies = {body.id_num: body for body in frame.rigid_bodies}
        body = bodies.get(self._ids[self._config.body])
        sample = BodySample(
            t=self._clock.now(),
            device_time=frame.suffix.timestamp,
            frame=number,
            position=NOWHERE if body is None else self._in_base(body.pos),
            orientation=self._turned(body),
            marker_error=math.nan if body is None else body.marker_error,
            valid=_usable(body),
            markers=tuple(self._marker(bodies.get(self._ids[name])) for name in self._config.markers),
        )
        now = time.monotonic()
        with self._lock:
            self._newest, self._newest_at = sample, now
            if sample.valid:
                self._valid, self._valid_at = sample, now
        self._started.set()
        self._sink(sample)

    def _in_base(self, position: Vector3) -> Vector3:
        return apply(self._config.mocap_to_base.position, self._rotation, position)

    def _turned(self, body: RigidBody | None) -> Quaternion:
        """Orientation in the base frame; NatNet sends x, y, z, w. Identity where there is none."""
        if body is None or not _unit(body.rot):
            return (1.0, 0.0, 0.0, 0.0)
        x, y, z, w = (part / math.hypot(*body.rot) for part in body.rot)
        q = compose(self._config.mocap_to_base.quaternion, (w, x, y, z))
        return q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])

    def _marker(self, body: RigidBody | None) -> Vector3:
        return self._in_base(body.pos) if body is not None and _usable(body) else NOWHERE


def _unit(rotation: tuple[float, ...]) -> bool:
    """Whether this is a rotation: NaN and zeros are not."""
    return abs(math.hypot(*rotation) - 1) < 0.05


def _usable(body: RigidBody | None) -> bool:
    """Tracked, and with values that can be true."""
    if body is None or not body.tracking_valid:
        return False
    return all(abs(part) < FARTHEST for part in body.pos) and _unit(body.rot)


DRIVER = Driver("mocap", Config, NatNetMocap)
