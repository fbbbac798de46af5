"""The fakes: TCP servers on the rig's own loopback address."""

import contextlib
import random
import socketserver

import numpy as np
from scipy.spatial.transform import Rotation

import timing
from sim_fakes.instrument import Fake, Site
from sim_fakes.pty_fake import Faults

from . import ARM_PORT, CAMERA_PORT

START = np.array([0.3, -0.2, 0.5, 0.0, np.pi / 2, 0.0])
"""Pose with which the arm begins, m and rad."""
PERIOD = 0.02
"""Host seconds between two lines of a stream."""
NOISE = 1e-4
"""Standard deviation of a position, m: values that never change are taken for a frozen instrument."""


class LineServer:
    """A TCP server each of whose connections is handled in a thread of its own; the driver contract disturbs its lines."""

    def __init__(self, site: Site, port: int) -> None:
        self.site, server = site, self
        self.faults, self.random = Faults(), random.Random(site.seed)

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    server.serve(self)

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = allow_reuse_address = True

        self._server = Server((site.host, port), Handler)
        self._thread = timing.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self.running = True

    def serve(self, connection: socketserver.StreamRequestHandler) -> None:
        """One connection, to its end."""
        raise NotImplementedError

    def send(self, answer: bytes, connection: socketserver.StreamRequestHandler) -> None:
        """Send a whole answer, through the faults."""
        connection.wfile.write(self.faults.disturbed(answer, self.random))

    def start(self) -> None:
        """Accept connections."""
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self.running = False
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join(1.0)
        self._server.server_close()


class ArmFake(LineServer):
    """The arm: straight motions at constant speed."""

    def __init__(self, site: Site) -> None:
        super().__init__(site, ARM_PORT)
        self._lock = timing.Lock()
        self._from, self._goal, self._speed, self._began = START, START, 1.0, 0.0
        self._mover = timing.Thread(target=self._move, daemon=True)

    def start(self) -> None:
        """Accept connections, and carry the probe."""
        super().start()
        self._mover.start()

    def pose(self) -> tuple[np.ndarray, float, bool]:
        """Pose, speed (m/s), whether it moves."""
        with self._lock:
            way = self._goal - self._from
            length = float(np.linalg.norm(way[:3]))
            gone = (self.site.clock.now() - self._began) * self._speed
            if gone >= length:
                return self._goal, 0.0, False
            return self._from + way * gone / length, self._speed, True

    def serve(self, connection: socketserver.StreamRequestHandler) -> None:
        """Answer line by line."""
        for line in connection.rfile:
            words = line.decode().split()
            if words == ["STREAM"]:
                while self.running:
                    self.send(self._told(), connection)
                    timing.sleep(PERIOD)
                return
            self.send(self._answer(words), connection)

    def _answer(self, words: list[str]) -> bytes:
        if words == ["ID"]:
            return b"ID bench-arm\n"
        if words == ["POSE"]:
            return self._told()
        if words == ["STOP"]:
            here, _, _ = self.pose()
            self._go(here, here, 1.0)
        elif words[:1] == ["GO"] and len(words) == 9:
            numbers = [float(word) for word in words[1:]]
            self._go(self.pose()[0], np.array(numbers[:6]), numbers[6])
        else:
            return b"ERR\n"
        return b"OK\n"

    def _go(self, here: np.ndarray, goal: np.ndarray, speed: float) -> None:
        with self._lock:
            self._from, self._goal, self._speed, self._began = here, goal, speed, self.site.clock.now()

    def _told(self) -> bytes:
        pose, speed, moving = self.pose()
        words = " ".join(f"{x:.9g}" for x in (self.site.clock.now(), *pose, speed))
        return f"POSE {words} {int(moving)}\n".encode()

    def _move(self) -> None:
        while self.running:
            pose, _, _ = self.pose()
            with self.site.plant.lock:
                self.site.plant.probe_position = pose[:3].copy()
                self.site.plant.probe_rotation = Rotation.from_rotvec(pose[3:]).as_matrix()
            timing.sleep(0.005)


class CamerasFake(LineServer):
    """The cameras: tip and markers as they are, with noise."""

    def __init__(self, site: Site) -> None:
        super().__init__(site, CAMERA_PORT)

    def serve(self, connection: socketserver.StreamRequestHandler) -> None:
        """Send frames."""
        frame, plant, random = 0, self.site.plant, np.random.default_rng(self.site.seed)
        while self.running:
            frame += 1
            with plant.lock:
                x, y, z, w = Rotation.from_matrix(plant.tip_rotation).as_quat()
                numbers = [*random.normal(plant.tip_position, NOISE), w, x, y, z, *plant.markers.ravel()]
                head = f"{self.site.clock.now():.9g} {frame} {int(plant.tip_visible)}"
            self.send(f"{head} {' '.join(f'{n:.9g}' for n in numbers)}\n".encode(), connection)
            timing.sleep(PERIOD / 2)


ARM = Fake("arm", lambda site: [ArmFake(site)], lambda site, parts: {"host": site.host})
CAMERAS = Fake(
    "mocap",
    lambda site: [CamerasFake(site)],
    lambda site, parts: {"server": site.host, "markers": [f"M{i + 1}" for i in range(site.markers)]},
)
