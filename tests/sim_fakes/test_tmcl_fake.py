"""The fake TMCM-1260 on its wire, without any driver."""

import struct

import pytest
import serial

import timing
from sim_fakes.plant import Plant
from sim_fakes.tmcl import TmclFake
from tests.simulated.bench import Bench

OK = 100
MST, MVP, SAP, GAP, RFS = 3, 4, 5, 6, 13


class Wire:
    """A host that speaks TMCL byte by byte."""

    def __init__(self, fake: TmclFake) -> None:
        self.fake = fake
        self.port = serial.serial_for_url(fake.port, 115200)

    def ask(
        self, command: int, kind: int, value: int = 0, address: int = 1, damage: int = 0, within: float = 20.0
    ) -> tuple[int, int] | None:
        """Status and value; None on silence."""
        self.port.timeout = within
        frame = struct.pack(">BBBBi", address, command, kind, 0, value)
        self.port.write(frame + bytes([sum(frame) + damage & 0xFF]))
        answer = self.port.read(9)
        if len(answer) < 9:
            return None
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
    answer = wire.ask(command, kind, value)
    assert answer is not None
    assert answer[0] == status


def test_a_wrong_checksum_is_refused(wire: Wire) -> None:
    answer = wire.ask(GAP, 1, damage=1)
    assert answer is not None
    assert answer[0] == 1


def test_relative_motions_and_rotations(wire: Wire) -> None:
    assert wire.ask(SAP, 1, 0) == (OK, 0) and wire.ask(SAP, 0, 0) == (OK, 0)
    assert wire.ask(MVP, 1, 500) == (OK, 500) and wire.ask(MVP, 1, 250) == (OK, 250)
    assert wire.ask(GAP, 0) == (OK, 750)
    for command, sign in ((1, 1), (2, -1)):
        assert wire.ask(command, 0, 5120) == (OK, 5120)
        deadline = timing.now() + 20
        while wire.fake.drum.speed * sign < 5000:
            assert timing.now() < deadline, "does not turn"
            timing.sleep(0.01)
        assert wire.ask(MST, 0) == (OK, 0)
        assert wire.ask(GAP, 3) == (OK, 0)
    assert wire.ask(GAP, 4) == (OK, 51200)


@pytest.mark.parametrize(
    ("number", "good", "bad"),
    [(6, 200, 256), (7, 20, 256), (12, 1, 2), (13, 1, 2), (153, 9, 14), (154, 2, 14), (204, 1, 9)],
)
def test_its_parameters_are_held_in_their_range(wire: Wire, number: int, good: int, bad: int) -> None:
    assert wire.ask(SAP, number, bad) == (4, bad)
    assert wire.ask(SAP, number, good) == (OK, good)
    assert wire.ask(GAP, number) == (OK, good)


def test_libraries_of_others_ask_for_version_lines_and_variables(wire: Wire) -> None:
    assert wire.ask(136, 1) == (OK, 1260 << 16 | 1 << 8 | 16)
    frame = struct.pack(">BBBBi", 1, 136, 0, 0, 0)
    wire.port.write(frame + bytes([sum(frame) & 0xFF]))
    assert wire.port.read(9) == b"\x021260V116"
    lines = struct.Struct(">BBBBi")

    def ask(*words: int) -> tuple[int, int]:
        frame = lines.pack(1, *words)
        wire.port.write(frame + bytes([sum(frame) & 0xFF]))
        _, _, status, _, value, _ = struct.unpack(">BBBBiB", wire.port.read(9))
        return status, value

    assert ask(15, 8, 1, 0) == (OK, 240)  # supply
    assert ask(14, 0, 2, 1) == (OK, 1) and ask(15, 0, 2, 0) == (OK, 1)
    assert ask(14, 0, 0, 1)[0] == ask(15, 7, 7, 0)[0] == 3
    assert ask(9, 200, 2, -5) == (OK, -5) == ask(10, 200, 2, 0)
    assert wire.ask(GAP, 206) == (OK, 0) and wire.ask(SAP, 206, 1) == (3, 1)
    assert wire.ask(SAP, 167, 16) == (4, 16) and wire.ask(SAP, 167, 5) == (OK, 5) == wire.ask(GAP, 167)


def test_a_stored_parameter_outlasts_a_power_cut(wire: Wire) -> None:
    assert wire.ask(SAP, 7, 42) == (OK, 42) and wire.ask(7, 7) == (OK, 0)
    assert wire.ask(SAP, 6, 42) == (OK, 42)
    wire.fake.restart()
    assert (wire.ask(GAP, 7), wire.ask(GAP, 6)) == ((OK, 42), (OK, 128))


def test_half_a_frame_is_forgotten(wire: Wire) -> None:
    wire.port.write(b"\x01\x06\x01")
    timing.sleep(0.15)
    assert wire.ask(GAP, 0) == (OK, 0)


def test_the_switch_stops_a_motion_towards_it(wire: Wire, plant: Plant) -> None:
    wire.ask(MVP, 0, -51200)
    deadline = timing.now() + 60
    while wire.ask(GAP, 11) != (OK, 1):
        assert timing.now() < deadline
    assert wire.ask(GAP, 3) == (OK, 0)
    assert plant.spine_drive == 0.0
