"""Start the controller in a process of its own and talk to its back door.

A process, because the constructors of the real client library hold the interpreter's lock while they wait.
"""

from __future__ import annotations

import contextlib
import json
import random
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import timing
from timing import RigClock

from ..plant import Plant
from ..punctual import punctual
from . import dashboard, rtde, server
from .kinematics import TrueArm

START_TIMEOUT = 20.0
"""s of host time."""


def free_host(attempts: int = 50) -> str:
    """A loopback address on which all ports of a controller are free."""
    for _ in range(attempts):
        host = f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(2, 254)}"
        if all(_is_free(host, port) for port in (rtde.PORT, dashboard.PORT, *server.UPLOAD_PORTS)):
            return host
    raise RuntimeError("no loopback address with free ports 29999 and 30001 to 30004")


def _is_free(host: str, port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind((host, port))
        except OSError:
            return False
        return True


class UrProcess:
    """A running controller on an address of its own; ends with the process that started it."""

    def __init__(
        self,
        host: str | None = None,
        *,
        speed: float = 1.0,
        version: str = "3.15.8.106339",
        pose_to: tuple[str, int] | None = None,
        clock_start: float | None = None,
        dashboard: bool = True,
        seed: int = 0,
    ) -> None:
        """Start and wait until it accepts clients. Raises RuntimeError when it does not within START_TIMEOUT."""
        self.host = host or free_host()
        self._folder = tempfile.TemporaryDirectory(prefix="softlab-")  # of mode 0700
        self.door = Path(self._folder.name) / "arm.sock"
        command = [sys.executable, "-P", "-m", "sim_fakes.ur", "--host", self.host, "--version", version]
        command += ["--speed", str(speed), "--seed", str(seed), "--die-with-parent"]
        command += ["--backdoor", str(self.door)]
        if pose_to is not None:
            command += ["--pose-to", f"{pose_to[0]}:{pose_to[1]}"]
        if not dashboard:
            command.append("--no-dashboard")
        if clock_start is not None:
            command += ["--clock-start", repr(clock_start)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        punctual(self.process.pid)  # before it imports anything
        self._line: socket.socket | None = None
        self._wait_until_ready()

    def _wait_until_ready(self) -> None:
        output = self.process.stdout
        if output is None:
            raise RuntimeError("the controller's output is not connected")
        ready = timing.readable([output], START_TIMEOUT)
        if not ready or output.readline().strip() != b"ready":
            self.kill()
            raise RuntimeError(f"the controller at {self.host} did not start within {START_TIMEOUT:g} s")

    def backdoor(self, do: str = "state", **values: object) -> dict[str, Any]:
        """Ask the back door (see `sim_fakes.ur.backdoor`) and return its answer; ValueError for a bad request."""
        if self._line is None:
            line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            line.settimeout(5.0)
            line.connect(str(self.door))
            self._line = line
        self._line.sendall(json.dumps({"do": do, **values}).encode() + b"\n")
        answer = b""
        while not answer.endswith(b"\n"):
            piece = self._line.recv(65536)
            if not piece:
                raise ConnectionError(f"the controller at {self.host} has gone")
            answer += piece
        reply: dict[str, Any] = json.loads(answer)
        if "error" in reply:
            raise ValueError(reply["error"])
        return reply

    def wait_for(self, what: str, value: object, timeout: float = 5.0) -> dict[str, Any]:
        """Poll the back door until an entry has a value; TimeoutError after `timeout` (s of host time)."""
        deadline = timing.now() + timeout
        while (state := self.backdoor())[what] != value:
            if timing.now() > deadline:
                raise TimeoutError(f"{what} is {state[what]!r} and not {value!r} after {timeout:g} s")
            timing.sleep(0.01)
        return state

    def kill(self) -> None:
        """End it like a power failure."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        """End it and free what it held; may be called twice."""
        if self._line is not None:
            self._line.close()
            self._line = None
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        self.process.terminate()
        try:
            self.process.wait(2.0)
        except subprocess.TimeoutExpired:
            self.kill()
        self._folder.cleanup()


class UrFake:
    """Made without a process; `start` starts it and returns when it answers."""

    def __init__(self, plant: Plant, clock: RigClock, host: str, seed: int = 0) -> None:
        self.plant, self.clock, self.host, self.seed = plant, clock, host, seed
        self.process: UrProcess | None = None
        self._poses = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._poses.bind((host, 0))
        self._running = True
        self._thread = timing.Thread(target=self._receive, name="fake-arm", daemon=True)

    def start(self) -> None:
        """Raises RuntimeError when the controller does not start."""
        self.process = timing.made(
            UrProcess, self.host, speed=self.clock.speed, pose_to=self._poses.getsockname(), seed=self.seed
        )
        self._thread.start()

    def stop(self) -> None:
        """End the process; may be called twice and before `start`."""
        self._running = False
        if self.process is not None:
            self.process.stop()
        self._poses.close()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def _receive(self) -> None:
        """Put each new place of the arm into the plant, by its true kinematics, until stopped."""
        punctual()
        arm, newest = TrueArm(self.seed, self.plant.arm_errors), b""  # without the time
        while self._running:
            try:
                if not timing.readable([self._poses], 0.2):
                    continue
                data, sender = self._poses.recvfrom(256)
            except (OSError, ValueError):
                return
            if sender[0] != self.host or data[8:] == newest or len(data) != server.POSE_DATAGRAM.size:
                continue
            newest, numbers = data[8:], np.array(server.POSE_DATAGRAM.unpack(data)[1:])
            flange = arm.flange(numbers[:6])
            tcp = flange @ np.vstack([numbers[6:].reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
            with self.plant.lock:
                self.plant.flange, self.plant.probe_position, self.plant.probe_rotation = flange, tcp[:3, 3], tcp[:3, :3]
