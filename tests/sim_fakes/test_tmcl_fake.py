"""The fake TMCM-1260 on its wire, without any driver."""

import struct

import pytest
import serial

import timing
from sim_fakes.plant import Plant
from sim_fakes.tmcl import TmclFake
from tests.simulated.bench import Bench, wait_until

OK = 100
MST, MVP, SAP, GAP, RFS = 3, 4, 5, 6, 13


class Wire:
    """A host that speaks TMCL byte by byte."""

    def __init__(self, fake: TmclFake) -> None:
        self.fake = fake
        self.port = serial.serial_for_url(fake.port, 115200, timeout=20.0)

    def ask(self, command: int, kind: int, value: int = 0, damage: int = 0) -> tuple[int, int]:
        """Status and value."""
        frame = struct.pack(">BBBBi", 1, command, kind, 0, value)
        self.port.write(frame + bytes([sum(frame) + damage & 0xFF]))
        answer = self.port.read(9)
        host, module, status, echo, result, check = struct.unpack(">BBBBiB", answer)
        assert (host, module, echo) == (2, 1, command)
        assert sum(answer[:8]) & 0xFF == check
        return status, result


@pytest.fixture
def wire(bench: Bench) -> Wire:
    wire = Wire(bench.started(TmclFake(bench.plant, bench.clock)))
    bench.closing(wire.port)
    return wire


@pytest.mark.parametrize(
    ("command", "kind", "value", "status"),
    [(GAP, 99, 0, 3), (SAP, 3, 0, 3), (SAP, 4, -1, 4), (MVP, 7, 0, 3), (77, 0, 0, 2), (RFS, 3, 0, 3)],
)
def test_what_the_module_does_not_know_is_refused(wire: Wire, command: int, kind: int, value: int, status: int) -> None:
    assert wire.ask(command, kind, value)[0] == status


def test_a_wrong_checksum_is_refused(wire: Wire) -> None:
    assert wire.ask(GAP, 1, damage=1)[0] == 1


def test_relative_motions_and_rotations(wire: Wire) -> None:
    assert wire.ask(SAP, 1, 0) == (OK, 0) and wire.ask(SAP, 0, 0) == (OK, 0)
    assert wire.ask(MVP, 1, 500) == (OK, 500) and wire.ask(MVP, 1, 250) == (OK, 250)
    assert wire.ask(GAP, 0) == (OK, 750)
    for command, sign in ((1, 1), (2, -1)):
        assert wire.ask(command, 0, 5120) == (OK, 5120)
        wait_until(lambda sign=sign: wire.fake.drum.speed * sign >= 5000)  # type: ignore[misc]
        assert wire.ask(MST, 0) == (OK, 0)
        assert wire.ask(GAP, 3) == (OK, 0)
    assert wire.ask(GAP, 4) == (OK, 51200)


@pytest.mark.parametrize(
    ("number", "good", "bad"), [(6, 200, 256), (7, 20, 256), (12, 1, 2), (13, 1, 2), (153, 9, 14), (154, 2, 14), (204, 1, 9)]
)
def test_its_parameters_are_held_in_their_range(wire: Wire, number: int, good: int, bad: int) -> None:
    assert wire.ask(SAP, number, bad) == (4, bad)
    assert wire.ask(SAP, number, good) == (OK, good)
    assert wire.ask(GAP, number) == (OK, good)


def test_half_a_frame_is_forgotten(wire: Wire) -> None:
    wire.port.write(b"\x01\x06\x01")
    timing.sleep(0.15)
    assert wire.ask(GAP, 0) == (OK, 0)


def test_the_switch_stops_a_motion_towards_it(wire: Wire, plant: Plant) -> None:
    wire.ask(MVP, 0, -51200)
    wait_until(lambda: wire.ask(GAP, 11) == (OK, 1))
    assert wire.ask(GAP, 3) == (OK, 0)
    assert plant.spine_drive == 0.0
