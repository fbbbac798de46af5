"""The arm as one fake of a rig: its controller in a process of its own, and the plant's probe that follows it."""

from __future__ import annotations

import socket
import struct

import numpy as np

import timing
from timing import RigClock

from ..plant import Plant
from ..punctual import punctual
from .kinematics import rotation_matrix
from .process import UrProcess


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
        punctual()
        newest: tuple[float, ...] = ()
        while self._running:
            try:
                if not timing.readable([self._poses], 0.2):
                    continue
                data, sender = self._poses.recvfrom(256)
                pose = struct.unpack("<7d", data)[1:]
            except struct.error:
                continue
            except (OSError, ValueError):
                return
            if sender[0] != self.host or pose == newest:
                continue
            newest = pose
            with self.plant.lock:
                self.plant.probe_position = np.array(pose[:3])
                self.plant.probe_rotation = rotation_matrix(pose[3:])
