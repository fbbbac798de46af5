"""Motion capture: rigid bodies (the tip, markers along the robot) streamed by OptiTrack Motive over NatNet.

Poses are turned into the robot's base frame here. A body that the cameras have lost keeps coming with its last pose and
a cleared tracking bit: such a sample is delivered with `valid` False and its position as received, which must not be
used. NaN and impossible values are treated alike. `latest` returns valid samples only.

Bodies are found by name. When Motive says that its list of bodies has changed, or has been silent, the driver asks for
the list again; until it has come, no body counts as tracked. Markers along the robot are further rigid bodies, called by
name; one that is not tracked has NaN coordinates.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import timing
from timing import Clock

from ..errors import DeviceFault, NotReady, StaleReading, Unreachable, WrongDevice
from ..interfaces import BodySample, Identity, Sink
from ..registry import Driver
from . import packets
from .config import Config, NotOne, body_numbers, remedy, usable
from .packets import Cursor, Definitions, MocapFrame, ServerInfo, Unreadable
from .wire import NatNetServer

WINDOW = 0.3
"""Host seconds for which a frame that has overtaken others waits for them: several times the jitter of a network. What
comes later than that is lost to the recording, and is counted so."""
AHEAD, FASTEST = 1000, 1000.0
"""Frames that may be missing at once, and frames a second of silence that may be missing beyond them: more is no gap, the
count has changed."""
LATE_FRAMES, RESTART_FRAMES = 300, 3
"""Frames by which one may come late; and frames in a row that are neither late nor next, by which a new count shows."""


@dataclass
class _Held:
    sample: BodySample
    came: float  # host time, s


class Order:
    """Frames in the order in which they were sent, each once; what never came is counted as lost."""

    def __init__(self) -> None:
        self.lost = 0
        """Frames that never came, or too late."""
        self.newest: BodySample | None = None
        """Of those that came, the one with the highest number."""
        self._next: int | None = None  # number of the frame that is handed out next
        self._held: dict[int, _Held] = {}  # by number, frames that wait for those before them
        self._strange: list[BodySample] = []  # frames in a row whose numbers do not fit
        self._out: list[BodySample] = []  # of an earlier count, to be handed out first
        self.anew = False  # the server may have been restarted: a lower number begins a new count
        self._came = 0.0  # host time of the newest frame

    def take(self, sample: BodySample, now: float) -> bool:
        """Whether this frame, which has come at the host's time `now`, is a new one. Take what is `ready` afterwards."""
        number, newest = sample.frame, self.newest
        if newest is not None and (number, sample.device_time) == (newest.frame, newest.device_time):
            return False
        if self._next is None:
            self._next = number
        ahead = number - self._next
        if 0 <= ahead <= AHEAD + FASTEST * (now - self._came if self._came else 0.0):
            return self._accept(sample, now)  # the next one, or the one behind a gap
        if newest is not None and -LATE_FRAMES <= ahead < 0 and sample.device_time <= newest.device_time and not self.anew:
            return False  # too late: its place has been handed out
        if self._strange and not 0 < number - self._strange[-1].frame <= AHEAD:
            self._strange.clear()  # not in a row with this one
        self._strange.append(sample)
        if len(self._strange) < RESTART_FRAMES and not (self.anew and ahead < 0):
            return False
        self._begin(self._strange[0].frame)  # the server counts anew
        for earlier in self._strange[:-1]:
            self._accept(earlier, now, keep=True)
        return self._accept(sample, now)

    def ready(self, now: float) -> list[BodySample]:
        """Samples in order, for which nothing is waited any more. One that was overtaken gets the time of the next."""
        out, self._out = self._out, []
        while self._held and self._next is not None:
            first = min(self._held)
            if first > self._next and now - min(h.came for h in self._held.values()) < WINDOW:
                break  # those before it may still come
            self.lost += first - self._next
            out.append(self._held.pop(first).sample)
            self._next = first + 1
        t = min((h.sample.t for h in self._held.values()), default=float("inf"))
        for k in range(len(out) - 1, -1, -1):
            t = min(t, out[k].t)
            out[k] = out[k] if out[k].t == t else replace(out[k], t=t)
        return out

    def _begin(self, number: int) -> None:
        """A new count; what still waits comes before it."""
        self._out += [self._held[k].sample for k in sorted(self._held)]
        self.newest, self._next, self._held = None, number, {}

    def _accept(self, sample: BodySample, now: float, keep: bool = False) -> bool:
        if sample.frame in self._held or (self._next is not None and sample.frame < self._next):
            return False
        self._held[sample.frame] = _Held(sample, now)
        self._came, self.anew = now, False
        if self.newest is None or sample.frame > self.newest.frame:
            self.newest = sample
        if not keep:
            self._strange.clear()
        return True


LONGEST_WAIT = 0.02
"""s between two checks of the sockets when nothing arrives: to keep alive, and to end."""
TRIES = 4
"""Times that the server is asked within the time-out: datagrams get lost."""
ASK_AGAIN = 0.5
"""s without a frame, or without an answer, after which the server is asked again: it forgets a client that stood still, and
may have been started again itself."""

NO_STAMP = 60.0
"""s; a frame that is said to have taken longer than this in Motive has no true stamps."""


class NatNetMocap:
    """Motion capture; see the module's text."""

    def __init__(
        self, name: str, config: Config, clock: Clock, sink: Sink[BodySample], notice: Callable[[str], None] = lambda text: None
    ) -> None:
        """`notice` is called once after each `open` for each of: datagrams from a stranger, datagrams that cannot be read."""
        self.name = name
        self._config = config
        self._clock = clock
        self._sink = sink
        self._notice = notice
        self._noticed: dict[str, str] = {}
        """What was noticed since `open`, by kind: the first address that was not the server's, the first unreadable part."""
        self._names = (config.body, *config.markers)
        self._where = f"{config.server}:{config.command_port}"
        self._server: NatNetServer | None = None
        self._info: ServerInfo | None = None
        self._definitions: Definitions | None = None
        self._ids: dict[str, int] = {}
        self._doubt = ""
        """Why it is not known which body is which; empty when it is known."""
        self._why = ""
        """Why the newest frame does not tell where the tip is; empty when it does."""
        self._asked_at = self._mode_asked_at = -math.inf
        self._mode = packets.LIVE
        self._changed = False
        """The newest frame said that the list of bodies has changed."""
        self._unsure = False
        """That, or it had not all bodies that are looked for."""
        self._order = Order()
        self._thread: threading.Thread | None = None
        self._stopping = timing.Event()
        self._silent = False
        """The server has been asked to send again; it may have been started anew."""
        self._lock = timing.Lock()
        self._newest_at = -math.inf
        self._valid: BodySample | None = None
        self._valid_at = -math.inf

    @property
    def lost(self) -> int:
        """Frames in the server's count that never came."""
        return self._order.lost

    def open(self) -> Identity:
        """Connect, find the bodies by name, wait for the first frame, start the stream.

        Raises `Unreachable` (no server, no frames) or `WrongDevice` (not NatNet, too old, body unknown or there twice),
        within three times the time-out.
        """
        self.close()
        self._noticed.clear()
        self._order = Order()
        config = self._config
        try:
            server = NatNetServer(config.server, config.local, (config.command_port, config.data_port), self._heard_elsewhere)
        except (OSError, UnicodeError) as e:
            raise Unreachable(
                self.name,
                f"{config.server} cannot be reached from {config.local or 'here'} ({e}); check server and local in rig.yaml, "
                "and the network",
            ) from e
        try:
            identity = self._meet(server)
        except BaseException:
            server.close()
            raise
        self._server = server
        self._stopping.clear()
        self._thread = timing.Thread(target=self._run, args=(server,), name=f"natnet-{self.name}", daemon=True)
        self._thread.start()
        return identity

    def close(self) -> None:
        """End the stream and disconnect."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(1.0)
        self._thread = None
        server, self._server = self._server, None
        if server is not None:
            server.close()
        self._info = self._definitions = self._valid = None
        self._ids, self._doubt = {}, ""
        self._silent = self._changed = self._unsure = False
        self._mode, self._mode_asked_at = packets.LIVE, -math.inf
        self._newest_at = self._valid_at = -math.inf

    def latest(self) -> BodySample:
        """The newest valid sample.

        Older than `max_age`, it raises `DeviceFault` when frames arrive without the body being tracked, `StaleReading`
        when none arrive.
        """
        if self._server is None:
            raise NotReady(self.name, "not open; call open() first")
        with self._lock:
            valid, valid_at, newest_at, why = self._valid, self._valid_at, self._newest_at, self._doubt or self._why
        now = timing.now()
        if valid is not None and now - valid_at <= self._config.max_age:
            return valid
        if now - newest_at <= self._config.max_age:
            since = "since the start" if valid is None else f"for {now - valid_at:.2f} s"
            raise DeviceFault(
                self.name, f"{self._config.body!r} has not been tracked {since} (limit {self._config.max_age} s); {why}"
            )
        raise StaleReading(
            self.name,
            f"no frame for {now - newest_at:.2f} s (limit {self._config.max_age} s); "
            + timing.busy_or(f"check that Motive is live and the network to {self._config.server}"),
        )

    # -- connecting
    def _heard_elsewhere(self, address: str) -> None:
        """Somebody who is not the server has sent a datagram; it was thrown away."""
        self._tell(
            address,
            f"datagrams from {address} are ignored, only those of {self._config.server} are accepted; find out who sends "
            "them, or correct server in rig.yaml",
            kind="elsewhere",
        )

    def _tell(self, what: str, text: str, kind: str) -> None:
        """Notice the first of its kind."""
        if kind not in self._noticed:
            self._noticed[kind] = what
            self._notice(f"{self.name}: {text}")

    def _meet(self, server: NatNetServer) -> Identity:
        """Ask who the server is and which bodies it has, and wait for a frame; raises `Unreachable`, `WrongDevice`."""
        self._wait(server, lambda: self._info is not None, packets.CONNECT, self._no_server)
        info = self._info
        assert info is not None
        speaks = f"NatNet {info.version[0]}.{info.version[1]}"
        if info.version < packets.OLDEST:
            oldest = ".".join(map(str, packets.OLDEST))
            raise WrongDevice(
                self.name, f"{self._where} speaks {speaks}; {oldest} is the oldest supported version: update Motive"
            )
        self._wait(
            server, lambda: self._definitions is not None, packets.REQUEST_MODELDEF, lambda: self._nothing("model definitions")
        )
        if self._doubt:
            raise WrongDevice(self.name, f"{self._where}: {self._doubt}")
        self._wait(
            server, lambda: self._order.newest is not None, packets.CONNECT, lambda: self._nothing("frames; set Motive to live")
        )
        return Identity("OptiTrack", f"{info.application}, {speaks}", firmware=info.application_version)

    def _no_server(self) -> Unreachable | WrongDevice:
        within = f"within {self._config.timeout} s"
        if unreadable := self._noticed.get("unreadable"):
            return WrongDevice(self.name, f"the device at {self._where} is not a NatNet server: {unreadable}")
        sender = self._noticed.get("elsewhere")
        ignored = f" (datagrams from {sender} were ignored)" if sender else ""
        return Unreachable(
            self.name,
            f"no NatNet server answers at {self._where} {within}{ignored}; check that Motive streams (Data Streaming on), "
            "the addresses in rig.yaml and the firewall",
        )

    def _nothing(self, what: str) -> Unreachable:
        odd = self._noticed.get("unreadable")
        return Unreachable(
            self.name,
            f"{self._config.server} answers, but within {self._config.timeout} s sent no {what}{f' ({odd})' if odd else ''}",
        )

    def _wait(
        self, server: NatNetServer, done: Callable[[], bool], ask: int, failure: Callable[[], Unreachable | WrongDevice]
    ) -> None:
        """Ask until `done`, at most `TRIES` times within the time-out; then raise the failure."""
        for _ in range(TRIES):
            try:
                server.ask(ask, b"Ping\0" if ask == packets.CONNECT else b"\0")
            except OSError as e:
                here = self._config.local or "here"
                raise Unreachable(
                    self.name, f"cannot send from {here} to {self._where} ({e}); check both addresses in rig.yaml"
                ) from e
            give_up, late = timing.now() + self._config.timeout / TRIES, False
            while not late:
                late = timing.now() > give_up
                self._hear(server)
                if done():
                    return
        raise failure()

    # -- streaming
    def _run(self, server: NatNetServer) -> None:
        """Hand out frames in order until `close`; ask anew when none come or it is in doubt which bodies there are."""
        patience = max(ASK_AGAIN, 3 / self._config.rate)
        began = timing.now()
        while not self._stopping.is_set():
            for sample in self._order.ready(timing.now()):
                self._sink(sample)
            self._hear(server)
            now = timing.now()
            silent = now - max(began, self._newest_at) > patience
            if (silent or self._doubt or self._unsure) and now - self._asked_at > ASK_AGAIN:
                self._asked_at, self._silent = now, silent
                server.try_asking(packets.CONNECT if silent else packets.REQUEST_MODELDEF)
            if now - self._mode_asked_at > ASK_AGAIN:
                self._mode_asked_at = now
                server.try_asking(packets.REQUEST, packets.CURRENT_MODE)

    def _hear(self, server: NatNetServer) -> None:
        """Take what has arrived. What cannot be read is noticed and thrown away; the count of frames shows a lost one."""
        for data in server.hear(LONGEST_WAIT):
            try:
                self._take(server, *packets.message(data))
            except Unreadable as e:
                self._tell(str(e), f"{e}; what cannot be read is ignored", kind="unreadable")

    def _take(self, server: NatNetServer, kind: int, content: Cursor) -> None:
        """Use one message by its kind; raises `Unreadable`."""
        if kind == packets.SERVERINFO:
            self._take_info(server, packets.server_info(content))
        elif self._info is None:  # the layout of all others depends on the server's version
            if kind not in (packets.MODELDEF, packets.FRAME):
                raise Unreadable(f"a message of kind {kind} is no answer to a request to connect")
        elif kind == packets.MODELDEF:
            self._take_definitions(packets.definitions(content, self._info.version))
        elif kind == packets.RESPONSE:
            self._mode = packets.mode(content)
        elif kind == packets.FRAME and self._definitions is not None:
            self._take_frame(server, packets.frame(content, self._info.version))

    def _take_info(self, server: NatNetServer, info: ServerInfo) -> None:
        self._info = info
        if info.group:
            try:
                server.join(info.group, info.data_port)
            except OSError as e:
                raise Unreadable(f"the multicast group {info.group} cannot be heard ({e})") from e
        if self._silent:
            self._silent = False
            self._order.anew = True
            self._ask_who(server, "Motive has been silent and has not said since which bodies there are")

    def _ask_who(self, server: NatNetServer, why: str) -> None:
        with self._lock:
            self._doubt = why
        self._asked_at = timing.now()
        server.try_asking(packets.REQUEST_MODELDEF)

    def _take_definitions(self, definitions: Definitions) -> None:
        for part in definitions.unread:
            self._tell(part, f"{part}; it is ignored", kind=part.partition(" at byte")[0])
        doubt = ""
        try:
            self._ids = body_numbers(self._names, definitions)
        except NotOne as e:
            doubt = str(e)
        with self._lock:
            self._definitions, self._doubt = definitions, doubt

    def _take_frame(self, server: NatNetServer, frame: MocapFrame) -> None:
        """Make a sample of a frame, valid or not, and keep it for `latest` and the sink."""
        if frame.models_changed and not self._changed:
            self._ask_who(server, "Motive's list of bodies has changed and it has not said yet which there are")
        self._changed = frame.models_changed
        self._unsure = self._changed or any(number not in frame.bodies for number in self._ids.values())
        bodies = {name: frame.bodies.get(self._ids.get(name, -1)) for name in self._names}
        places = [body.position for body in bodies.values() if body is not None and usable(body)]
        # two bodies at one place to the last bit: Motive takes the same markers for both
        shared = [name for name, body in bodies.items() if body is not None and places.count(body.position) > 1]
        body, to_base = bodies[self._config.body], self._config.mocap_to_base
        why = remedy(body)
        if self._config.body in shared:
            why = f"Motive has {' and '.join(map(repr, shared))} at the same place: tell their patterns of markers apart"
        if not_live := self._not_live(frame):
            why = not_live
        tracked = {name: each for name, each in bodies.items() if usable(each) and name not in shared and not not_live}
        sample = BodySample(
            t=self._clock.now(),
            device_time=frame.stamp,
            frame=frame.number,
            position=to_base.place(body),
            orientation=to_base.turn(body),
            marker_error=math.nan if body is None else body.error,
            valid=not (why or self._doubt),
            markers=tuple(to_base.place(tracked.get(name)) for name in self._config.markers),
        )
        now = timing.now()
        if not self._order.take(sample, now):
            return
        newest = self._order.newest
        with self._lock:
            self._newest_at, self._why = now, why
            if newest is not None and newest.valid:
                self._valid, self._valid_at = newest, now

    def _not_live(self, frame: MocapFrame) -> str:
        """Why a frame does not show the present; empty for one that does."""
        if self._mode == packets.EDIT:
            return "Motive plays a take that was recorded (Edit mode): set Motive to Live"
        old = frame.taken / self._info.frequency if self._info is not None and self._info.frequency else 0.0
        if self._config.max_age < old < NO_STAMP:
            return f"it was {old:.2f} s old when Motive sent it: end other programs on Motive's computer, or lower its frame rate"
        return ""


DRIVER = Driver("mocap", Config, NatNetMocap)
