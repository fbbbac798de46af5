"""Fake range finders, which look at the tip from below, and a fake vacuum gauge."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from sim_fakes.instrument import Fake, Site
from sim_fakes.pty_fake import PtyFake

from . import BAUD, total


class RangeFake(PtyFake):
    """The range finder on one pty."""

    def __init__(self, site: Site) -> None:
        super().__init__("range", site.clock, BAUD, site.seed)
        self.plant = site.plant

    def feed(self) -> bool:
        line, found, rest = self.buffer.partition(b"\r")
        if not found:
            return False
        self.buffer = rest
        if line == b"?I":
            self.send(self.ended(self.faults.extra.get("model", b"LRF9") + b";4711"))
        elif line == b"?D":
            with self.plant.lock:
                height = float(self.plant.tip_position[2])
            self.send(self.ended(b"D;%07.2f;mm" % (1e3 * (0.5 - height) + self.random.gauss(0.0, 0.05))))
        return True

    def ended(self, text: bytes) -> bytes:
        return text + b"\r"


class CheckedRangeFake(RangeFake):
    """A newer one."""

    checked: ClassVar[slice | None] = slice(0, -3)
    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {"wrong_id": ("model", b"XYZ1")}

    def ended(self, text: bytes) -> bytes:
        return text + b"%02X\r" % total(text)


class GaugeFake(PtyFake):
    """The vacuum gauge on one pty."""

    checked: ClassVar[slice | None] = slice(0, -1)
    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {"wrong_id": ("model", b"XYZ1")}

    def __init__(self, site: Site) -> None:
        super().__init__("gauge", site.clock, BAUD, site.seed)
        self.plant = site.plant

    def feed(self) -> bool:
        if len(self.buffer) < 2:
            return False
        letter = self.buffer[:1]
        self.requests.append(bytes(self.buffer[:2]))
        self.buffer = self.buffer[2:]
        if letter == b"I":
            answer = self.faults.extra.get("model", b"IVG1") + b"\0"
            self.send(answer + bytes([total(answer)]))
        elif letter == b"P":
            tenths = round(10 * self.plant.vacuum_absolute + self.random.gauss(0.0, 5.0))
            answer = letter + tenths.to_bytes(4, "big")
            self.send(answer + bytes([total(answer)]))
        return True


def _port(site: Site, lines: Sequence[PtyFake]) -> dict[str, Any]:
    return {"port": lines[0].port}


FAKE = Fake("sensor", lambda site: [RangeFake(site)], _port)
CHECKED = Fake("sensor", lambda site: [CheckedRangeFake(site)], _port)
GAUGE = Fake("gauge", lambda site: [GaugeFake(site)], _port)
