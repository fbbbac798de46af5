"""All ports of one controller and the loop that runs its cycles."""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
import struct
from collections.abc import Callable

import timing

from . import backdoor, dashboard, rtde
from .controller import FakeController
from .wire import Connection, Hub

UPLOAD_PORTS = (30001, 30002, 30003)
"""Script upload: text goes in; the state these ports stream is left out, as nobody reads it."""
_PROGRAM = re.compile(rb"(?m)^def \w+\(\):\n(?:.*\n)*?end\n")


class UploadConnection(Connection):
    """One client that sends programs; a program ends with `end` in the first column."""

    def take(self) -> bool:
        program = _PROGRAM.search(self.buffer)
        if program is None:
            if len(self.buffer) > 1 << 20:
                self.hub.violation(f"script: {len(self.buffer)} bytes without a program")
                self.transport.abort()
            return False
        if self.buffer[: program.start()].strip():
            self.hub.violation("script: text outside a program")
        self.buffer = self.buffer[program.end() :]
        self.hub.controller.load(program[0].decode("utf-8", "replace"))
        return True


Address = tuple[str, int]
POSE_DATAGRAM = struct.Struct("<19d")
"""Rig time (s), angles of the joints (rad), and the first three rows of the TCP's pose (4, 4) in the flange's frame."""
LONGEST_BACKLOG = 0.25
"""s; a host that sleeps longer than this has stopped the controller's time."""


class UrServer:
    """One controller on one loopback address."""

    def __init__(self, controller: FakeController, host: str, clock_start: float, dashboard: bool = True) -> None:
        """`dashboard` False: that server is switched off; PolyScope X has none."""
        self.controller, self.host = controller, host
        self.dashboard = dashboard and controller.version[0] < 10
        self.hub = Hub(controller)
        self.clock_start = clock_start
        """Host monotonic time (s) at which the rig's time was 0."""

    async def run(self, door: str | None, pose_to: Address | None, ready: Callable[[], None]) -> None:
        """Listen on all ports and at the back door (a Unix socket), call `ready`, and run cycles for ever."""
        hub = self.hub
        await self._listen(rtde.PORT, lambda: rtde.RtdeConnection(hub))
        if self.dashboard:
            await self._listen(dashboard.PORT, lambda: dashboard.DashboardConnection(hub))
        for port in UPLOAD_PORTS:
            await self._listen(port, lambda: UploadConnection(hub))
        door_hub = Hub(self.controller)
        if door is not None:
            await asyncio.get_running_loop().create_unix_server(lambda: backdoor.UrBackDoor(door_hub, hub), door)
        ready()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plant:
            plant.setblocking(False)
            plant.bind((self.host, 0))
            await self._cycles(plant, pose_to)

    async def _listen(self, port: int, make: Callable[[], Connection]) -> None:
        await asyncio.get_running_loop().create_server(make, self.host, port)

    async def _cycles(self, plant: socket.socket, pose_to: Address | None) -> None:
        """Run the controller's cycles; after each send where the arm is to `pose_to`, and the RTDE packages."""
        controller, period = self.controller, self.controller.period
        due = began = timing.now()
        while True:
            now = timing.now()
            # A real controller is never late; a host is. What was missed is made up at twice the rate, because a client
            # keeps only the newest of several packages that arrive together.
            due = max(due + period, now - LONGEST_BACKLOG)
            await asyncio.sleep(due - now if due > now else period / 2)
            previous, began = began, timing.now()
            controller.advance(began - previous)
            if pose_to is not None:
                rig_time = (due - self.clock_start) * controller.speed
                with contextlib.suppress(OSError):
                    plant.sendto(POSE_DATAGRAM.pack(rig_time, *controller.arm.q, *controller.arm.tool[:3].flat), pose_to)
            if not self.hub.frozen:
                rtde.publish(self.hub)
