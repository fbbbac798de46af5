"""A fake PR-4: what stands on the other end of the wire in tests and demonstrations."""

from __future__ import annotations

import numpy as np

from sim_fakes.instrument import Fake, Site
from sim_fakes.pty_fake import PtyFake

from . import BAUD, COUNT

NOISE = 100.0
"""Standard deviation of a reading, Pa."""


class Pr4Fake(PtyFake):
    """The box on one pty."""

    def __init__(self, site: Site) -> None:
        super().__init__("pr4", site.clock, BAUD, site.seed)
        self.plant, self.hoses = site.plant, site.hoses
        self.highest = int(site.full_scale / COUNT)
        self.setpoints = [0] * len(site.hoses)

    def restart(self) -> None:
        """Without power it forgets its set-points."""
        self.setpoints = [0] * len(self.hoses)

    def process(self, dt: float) -> None:
        """Drive the chambers' regulators."""
        with self.plant.lock:
            for counts, chambers in zip(self.setpoints, self.hoses, strict=True):
                for chamber in chambers:
                    self.plant.regulator[chamber - 1] = counts * COUNT

    def feed(self) -> bool:
        """Take one line and answer it."""
        line, found, rest = self.buffer.partition(b"\n")
        if not found:
            return False
        self.buffer = rest
        self.requests.append(line)
        self.send(self._answer(line) + b"\n")
        return True

    def _answer(self, line: bytes) -> bytes:
        if line == b"ID?":
            return b"PR4,SN0042,FW1.3"
        if line == b"PV?":
            return b"PV " + self._text(self._measured())
        if line != b"SP?":
            parts = line.removeprefix(b"SP ").split(b",")
            if not line.startswith(b"SP ") or len(parts) != len(self.hoses) or not all(p.isdigit() for p in parts):
                return b"ERR 1"
            if max(map(int, parts)) > self.highest:
                return b"ERR 2"
            self.setpoints = [int(p) for p in parts]
        return b"SP " + self._text(self.setpoints)

    def _measured(self) -> list[int]:
        with self.plant.lock:
            mean = [np.mean([self.plant.chamber_pressure[c - 1] for c in chambers]) for chambers in self.hoses]
        return [max(0, round((p + self.random.gauss(0, NOISE)) / COUNT)) for p in mean]

    def _text(self, numbers: list[int]) -> bytes:
        return ",".join(map(str, numbers)).encode()


FAKE = Fake("pressure", lambda site: [Pr4Fake(site)], lambda site, lines: {"port": lines[0].port})
