"""The fake controller's process: its ports, its strictness, the pose it sends to the plant, its end."""

import argparse
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing

import pytest

import timing
from sim_fakes.instrument import loopback
from sim_fakes.ur.__main__ import factor
from sim_fakes.ur.process import UrProcess, free_host
from tests.simulated.bench import raises


@pytest.fixture(scope="module")
def process() -> Iterator[UrProcess]:
    process = UrProcess()
    yield process
    process.stop()


class Client:
    """A plain RTDE client."""

    def __init__(self, host: str, negotiate: bool = True) -> None:
        self.line = socket.create_connection((host, 30004), timeout=3.0)
        self.data = self.line.makefile("rb")
        if negotiate:
            assert self.ask("V", struct.pack(">H", 2)) == b"\x01"

    def send(self, kind: str, body: bytes = b"") -> None:
        self.line.sendall(struct.pack(">HB", len(body) + 3, ord(kind)) + body)

    def receive(self) -> tuple[str, bytes]:
        header = self.data.read(3)
        if len(header) < 3:
            raise ConnectionError("hung up")
        size, kind = struct.unpack(">HB", header)
        return chr(kind), self.data.read(size - 3)

    def ask(self, kind: str, body: bytes = b"") -> bytes:
        self.send(kind, body)
        got, answer = self.receive()
        assert got == kind
        return answer

    def close(self) -> None:
        self.data.close()
        self.line.close()


@pytest.fixture
def client(process: UrProcess) -> Iterator[Client]:
    process.backdoor("forget")
    with closing(Client(process.host)) as client:
        yield client


def test_the_stream_begins_after_start_steps_by_one_cycle_and_ends_with_pause(client: Client) -> None:
    assert client.ask("O", struct.pack(">d", 125.0) + b"timestamp,actual_q,") == b"\x01DOUBLE,VECTOR6D"
    assert client.ask("S") == b"\x01"
    packages = [client.receive() for _ in range(20)]
    stamps = [struct.unpack(">B7d", body)[1] for kind, body in packages if kind == "U"]
    assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == pytest.approx([0.008] * 19)
    client.send("P")
    assert any(kind == "P" for kind, _ in iter(client.receive, None))
    client.line.settimeout(0.1)
    raises(TimeoutError, None, client.receive)


def test_an_unknown_variable_and_a_rate_above_the_cycle_are_not_accepted(process: UrProcess, client: Client) -> None:
    assert client.ask("O", struct.pack(">d", 125.0) + b"timestamp,nonsense") == b"\x00DOUBLE,NOT_FOUND"
    assert client.ask("O", struct.pack(">d", 500.0) + b"timestamp")[0] == 0
    assert client.ask("S") == b"\x00"
    assert "frequency 500 Hz" in process.backdoor()["violations"][0]


def test_the_rate_is_the_top_rate_over_a_whole_number(process: UrProcess, client: Client) -> None:
    for asked, cycles in ((80.0, 1), (125.0 / 3, 3), (60.0, 2)):
        assert client.ask("O", struct.pack(">d", asked) + b"timestamp")[0] == 1
        assert client.ask("S") == b"\x01"
        stamps = [struct.unpack(">Bd", client.receive()[1])[1] for _ in range(5)]
        assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == pytest.approx([0.008 * cycles] * 4)
        client.send("P")
        assert any(kind == "P" for kind, _ in iter(client.receive, None))
    assert client.ask("O", struct.pack(">d", 0.5) + b"timestamp")[0] == 0


def test_a_list_of_names_beyond_its_longest_is_refused(process: UrProcess, client: Client) -> None:
    names = ",".join(f"output_double_register_{i}" for i in range(48)) + "," + ",".join(["timestamp"] * 90)
    assert len(names) > 2048
    assert client.ask("O", struct.pack(">d", 10.0) + names.encode()) == b"\x00"
    assert client.ask("I", names.encode()) == b"\x00"
    assert any("at most 2048" in violation for violation in process.backdoor()["violations"])


def test_protocol_version_1_streams_at_the_full_rate_without_recipe_numbers(process: UrProcess) -> None:
    with closing(Client(process.host, negotiate=False)) as client:
        assert client.ask("V", struct.pack(">H", 1)) == b"\x01"
        assert client.ask("O", b"timestamp,actual_q") == b"DOUBLE,VECTOR6D"
        assert client.ask("S") == b"\x01"
        first, second = (struct.unpack(">7d", client.receive()[1])[0] for _ in range(2))
    assert second - first == pytest.approx(0.008)


RECORDED = (
    "timestamp target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
    "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed "
    "actual_digital_input_bits joint_temperatures actual_execution_time robot_mode joint_mode safety_mode "
    "actual_tool_accelerometer speed_scaling target_speed_fraction actual_momentum actual_main_voltage actual_robot_voltage "
    "actual_robot_current actual_joint_voltage actual_digital_output_bits runtime_state"
)
"""What the maker's example of a recording asks for,"""
MORE = (
    "robot_status_bits safety_status_bits analog_io_types standard_analog_input0 standard_analog_input1 "
    "standard_analog_output0 standard_analog_output1 io_current euromap67_input_bits euromap67_output_bits "
    "euromap67_24V_voltage euromap67_24V_current tool_mode tool_analog_input_types tool_analog_input0 tool_analog_input1 "
    "tool_output_voltage tool_output_current tool_temperature tcp_force_scalar output_bit_registers0_to_31 "
    "output_bit_registers32_to_63 output_int_register_0 output_double_register_0 input_int_register_0 elbow_position"
)
"""and the rest of the guide's list."""


@pytest.mark.parametrize("names", [RECORDED, MORE], ids=["example", "guide"])
def test_every_documented_output_is_sent(client: Client, names: str) -> None:
    answer = client.ask("O", struct.pack(">d", 125.0) + names.replace(" ", ",").encode())
    assert answer[0] == 1 and b"NOT_FOUND" not in answer
    assert client.ask("S") == b"\x01"
    assert client.receive()[0] == "U"


@pytest.mark.parametrize(
    ("kind", "body", "what"),
    [("U", b"\x07" + bytes(4), "data for recipe 7 of 1"), ("U", b"\x01" + bytes(6), "recipe 1 with 6 bytes")],
)
def test_a_data_package_that_fits_no_recipe_is_noted(
    process: UrProcess, client: Client, kind: str, body: bytes, what: str
) -> None:
    client.ask("I", b"input_int_register_21")
    client.send(kind, body)
    client.ask("v")
    assert any(what in violation for violation in process.backdoor()["violations"])


@pytest.mark.parametrize("raw", [b"\x00\x01S", b"\xff\xffS", b"\x00\x03Z", b"\x00\x04S\x01"])
def test_a_malformed_packet_ends_the_connection(process: UrProcess, client: Client, raw: bytes) -> None:
    client.line.sendall(raw)
    raises(ConnectionError, None, client.receive)
    assert process.backdoor()["violations"]


def test_nothing_goes_before_the_protocol_version_and_an_unknown_one_is_refused(process: UrProcess) -> None:
    with closing(Client(process.host, negotiate=False)) as client:
        assert client.ask("V", struct.pack(">H", 9)) == b"\x00"
    with closing(Client(process.host, negotiate=False)) as client:
        raises(ConnectionError, None, client.ask, "v")


def test_a_stuck_value_stays_while_the_stamps_go_on(process: UrProcess, client: Client) -> None:
    process.backdoor("stuck", variables=["actual_TCP_pose"])
    try:
        client.ask("O", struct.pack(">d", 125.0) + b"timestamp,actual_TCP_pose")
        client.ask("S")
        packages = [struct.unpack(">B7d", client.receive()[1]) for _ in range(5)]
    finally:
        process.backdoor("stuck", variables=[])
    assert len({package[1] for package in packages}) == 5
    assert len({package[2:] for package in packages}) == 1


def test_a_bad_request_at_the_back_door_is_explained(process: UrProcess) -> None:
    raises(ValueError, "unknown request 'dance'", process.backdoor, "dance")
    raises(ValueError, "out of reach", process.backdoor, "set", pose=[2.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_it_ends_with_the_process_that_started_it() -> None:
    host = free_host()
    parent = f"import os; from sim_fakes.ur.process import UrProcess; UrProcess({host!r}); os._exit(0)"
    subprocess.run([sys.executable, "-c", parent], check=True, timeout=600)
    deadline = timing.now() + 60.0
    while True:
        try:
            socket.create_connection((host, 30004), timeout=1.0).close()
        except ConnectionError:
            return
        assert timing.now() < deadline
        timing.sleep(0.05)


def test_only_loopback_addresses_and_speeds_above_0_are_taken() -> None:
    for convert, wrong in ((loopback, "10.0.0.1"), (factor, "0")):
        raises((ValueError, argparse.ArgumentTypeError), None, convert, wrong)
