"""The streams of a recording to Foxglove and Lichtblick, beside the page: every message as it stands in the file.

Topics, schemas, bytes and log times are those of the recording. One topic is not in it: `EXPECTED`, a foxglove.SceneUpdate
with the tip that the model expects, in the base frame, and the box of its 95 % interval. The library (extra `live`) serves all
viewers from threads of its own, each from a queue of its own: a slow viewer loses the oldest messages without
affecting others. Viewers cannot send anything.
"""

from __future__ import annotations

import threading
import time
from contextlib import AbstractContextManager
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.records import Schema

from recordings.events import BASE_FRAME
from recordings.file.contents import Contents
from recordings.file.tail import Piece

from ..files.config import ConfigError

if TYPE_CHECKING:
    from foxglove import Channel

EXPECTED = "/model/tip"
LAYOUT = Path(str(files(__package__) / "page" / "foxglove.json"))
"""Panels for Foxglove and Lichtblick; their paths are those of our recordings."""
WAITING = 2**16
"""Messages that may wait for one viewer: two minutes of a rig."""
ENDS_WITHIN = 1.0
"""Host seconds allowed for disconnecting viewers."""
NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")
SPHERE = 0.008
"""Diameter that stands for the expected tip, m."""


class Foxglove(AbstractContextManager["Foxglove"]):
    """Serves at a port of `host`; raises ConfigError when that cannot be. Use with `with`."""

    def __init__(self, host: str, port: int) -> None:
        if not 0 <= port < 2**16:
            raise ConfigError(f"--foxglove {port}: must be 0 (any that is free) to 65535")
        try:
            import foxglove
            from foxglove.channels import SceneUpdateChannel
            from foxglove.websocket import Capability, ServerListener
        except ImportError as e:
            raise ConfigError(f"--foxglove needs {e.name}, which is not installed; pip install 'softlab[live]'") from e

        subscribed_at: list[float] = []

        class Subscriptions(ServerListener):
            def on_subscribe(self, client: Any, channel: Any) -> None:
                subscribed_at[:] = [time.monotonic()]

        self._subscribed_at = subscribed_at  # host time (s) of the newest subscription, if any
        self._library = foxglove
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="softlab", host=host, port=port, context=self._context, capabilities=[Capability.Time],
                server_listener=Subscriptions(), message_backlog_size=WAITING,
            )  # fmt: skip
        except RuntimeError as e:
            raise ConfigError(
                f"--foxglove {port}: cannot listen there ({e}); choose another port, or 0 for any that is free"
            ) from e
        self._expected = SceneUpdateChannel(EXPECTED, context=self._context)
        self._channels: dict[int, Channel] = {}
        self._until = 0
        name = f"[{host}]" if ":" in host else host
        self.address = f"ws://{name}:{self._server.port}"
        """What to open in Foxglove."""

    @property
    def wanted(self) -> bool:
        """Whether somebody has subscribed, and no further subscription has come for a moment."""
        # host seconds after the newest subscription, a viewer has all that its panels want
        return bool(self._subscribed_at) and time.monotonic() - self._subscribed_at[0] > 0.5

    def anew(self) -> None:
        """Another recording follows, whose topics are its own."""
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()

    def offer(self, contents: Contents) -> None:
        """Announce the topics of a recording that have come up to here and were not announced yet."""
        for number, channel in contents.channels.items():
            if number in self._channels:
                continue
            schema = contents.schemas.get(channel.schema_id, NO_SCHEMA)
            self._channels[number] = self._library.Channel(
                channel.topic,
                schema=self._library.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                message_encoding=channel.message_encoding,
                metadata=dict(channel.metadata),
                context=self._context,
            )

    def take(self, contents: Contents, pieces: list[Piece]) -> None:
        """Pass on new messages; the viewers' clock is that of the file."""
        self.offer(contents)
        for piece in pieces:
            self._until = max(self._until, piece.until)
            self._server.broadcast_time(self._until)
            for number, log_time, payload in piece.messages:
                self._channels[number].log(payload, log_time=log_time)

    def expected(self, log_time: int, answer: dict[str, Any]) -> None:
        """Send where the tip should be (`answer`: m, base frame) at a log time (ns); without a tip the drawing is deleted."""
        from foxglove import messages as m

        def place(x: float, y: float, z: float) -> m.Pose:
            return m.Pose(position=m.Vector3(x=x, y=y, z=z), orientation=m.Quaternion(x=0, y=0, z=0, w=1))

        tip, low, high = answer.get("tip"), answer.get("low"), answer.get("high")
        entities: list[m.SceneEntity] = []
        stamp = m.Timestamp(sec=log_time // 10**9, nsec=log_time % 10**9)
        if tip is not None and None not in tip:
            size = m.Vector3(x=SPHERE, y=SPHERE, z=SPHERE)
            sphere = m.SpherePrimitive(pose=place(*tip), size=size, color=m.Color(r=0.84, g=0.37, b=0.0, a=1.0))
            cubes: list[m.CubePrimitive] = []
            if low is not None and high is not None and None not in (*low, *high):
                middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
                x, y, z = (b - a for a, b in zip(low, high, strict=True))
                color = m.Color(r=0.84, g=0.37, b=0.0, a=0.25)
                cubes.append(m.CubePrimitive(pose=place(*middle), size=m.Vector3(x=x, y=y, z=z), color=color))
            entities.append(m.SceneEntity(timestamp=stamp, frame_id=BASE_FRAME, id="expected tip", spheres=[sphere], cubes=cubes))
        deletions = [] if entities else [m.SceneEntityDeletion(timestamp=stamp, type=m.SceneEntityDeletionType.All)]
        self._expected.log(m.SceneUpdate(entities=entities, deletions=deletions), log_time=log_time)

    def __exit__(self, *_: object) -> None:
        # the library waits forever for a connection that has requested nothing
        ending = threading.Thread(target=self._server.stop, name="foxglove-end", daemon=True)
        ending.start()
        ending.join(ENDS_WITHIN)
