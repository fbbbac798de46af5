"""A fake range finder, which looks at the tip from below."""

from __future__ import annotations

from sim_fakes.instrument import Fake, Site
from sim_fakes.pty_fake import PtyFake

from . import BAUD


class RangeFake(PtyFake):
    """The range finder on one pty."""

    def __init__(self, site: Site) -> None:
        super().__init__("range", site.clock, BAUD, site.seed)
        self.plant = site.plant

    def feed(self) -> bool:
        """Take one line and answer it."""
        line, found, rest = self.buffer.partition(b"\r")
        if not found:
            return False
        self.buffer = rest
        if line == b"?I":
            self.send(b"LRF9;4711\r")
        elif line == b"?D":
            with self.plant.lock:
                height = float(self.plant.tip_position[2])
            self.send(b"D;%07.2f;mm\r" % (1e3 * (0.5 - height) + self.random.gauss(0.0, 0.05)))
        return True


FAKE = Fake("sensor", lambda site: [RangeFake(site)], lambda site, lines: {"port": lines[0].port})
