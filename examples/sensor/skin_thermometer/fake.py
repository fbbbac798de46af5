"""A fake thermometer; the silicone warms a little with the pressure in its chambers."""

from __future__ import annotations

import timing
from sim_fakes.instrument import Fake, Site
from sim_fakes.pty_fake import PtyFake

from . import BAUD, RATE


class SkinThermometerFake(PtyFake):
    """The thermometer on one pty."""

    def __init__(self, site: Site) -> None:
        super().__init__("skin", site.clock, BAUD, site.seed)
        self.plant = site.plant
        self._due = timing.now()

    def feed(self) -> bool:
        """It listens to nobody."""
        self.buffer = b""
        return False

    def idle(self) -> float | None:
        """Send a line when one is due."""
        now = timing.now()
        if now >= self._due:
            with self.plant.lock:
                kelvin = 296.0 + 5e-6 * float(self.plant.chamber_pressure.mean()) + self.random.gauss(0.0, 0.02)
            self.send(b"T=%.2f H=0.38\n" % kelvin, line_time=False)
            self._due = max(self._due + 1 / (RATE * self.clock.speed), now)
        return max(0.0, self._due - now)


FAKE = Fake("sensor", lambda site: [SkinThermometerFake(site)], lambda site, lines: {"port": lines[0].port})
