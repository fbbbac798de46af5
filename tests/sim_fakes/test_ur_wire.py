"""The fake controller's process: its ports, its strictness, the pose it sends to the plant, its end."""

from __future__ import annotations

import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from sim_fakes.ur.process import UrProcess, free_host
from sim_fakes.ur.server import POSE_DATAGRAM


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
    client = Client(process.host)
    yield client
    client.close()


def test_the_version_is_told_and_another_protocol_is_refused(process: UrProcess, client: Client) -> None:
    assert struct.unpack(">4I", client.ask("v")) == (3, 15, 8, 106339)
    other = Client(process.host, negotiate=False)
    assert other.ask("V", struct.pack(">H", 9)) == b"\x00"
    other.close()


def test_the_stream_begins_after_start_steps_by_one_cycle_and_ends_with_pause(client: Client) -> None:
    types = client.ask("O", struct.pack(">d", 125.0) + b"timestamp,actual_q,")
    assert types == b"\x01DOUBLE,VECTOR6D"
    assert client.ask("S") == b"\x01"
    packages = [client.receive() for _ in range(20)]
    stamps = [struct.unpack(">B7d", body)[1] for kind, body in packages if kind == "U"]
    assert [b - a for a, b in zip(stamps, stamps[1:], strict=False)] == pytest.approx([0.008] * 19)
    client.send("P")
    while client.receive()[0] != "P":
        pass
    client.line.settimeout(0.1)
    with pytest.raises(TimeoutError):
        client.receive()


def test_an_unknown_variable_and_a_rate_above_the_cycle_are_not_accepted(process: UrProcess, client: Client) -> None:
    assert client.ask("O", struct.pack(">d", 125.0) + b"timestamp,nonsense") == b"\x00DOUBLE,NOT_FOUND"
    assert client.ask("O", struct.pack(">d", 500.0) + b"timestamp")[0] == 0
    assert client.ask("S") == b"\x00"
    assert "frequency 500 Hz" in process.backdoor()["violations"][0]


def test_a_register_belongs_to_one_client_until_it_leaves(process: UrProcess, client: Client) -> None:
    assert client.ask("I", b"input_int_register_20,") == b"\x01INT32"
    other = Client(process.host)
    assert other.ask("I", b"input_int_register_20,") == b"\x00IN_USE"
    client.close()
    deadline = time.monotonic() + 60.0
    while other.ask("I", b"input_int_register_20,") != b"\x01INT32":
        assert time.monotonic() < deadline
    other.close()


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
    with pytest.raises(ConnectionError):
        client.receive()
    assert process.backdoor()["violations"]


def test_nothing_goes_before_the_protocol_version(process: UrProcess) -> None:
    client = Client(process.host, negotiate=False)
    with pytest.raises(ConnectionError):
        client.ask("v")
    client.close()


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
    with pytest.raises(ValueError, match="unknown request 'dance'"):
        process.backdoor("dance")
    with pytest.raises(ValueError, match="out of reach"):
        process.backdoor("set", pose=[2.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_the_plant_is_told_the_pose_each_cycle_in_rig_time() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plant:
        plant.bind((free_host(), 0))
        plant.settimeout(60.0)
        start = time.monotonic()
        process = UrProcess(speed=10.0, pose_to=plant.getsockname(), clock_start=start)
        try:
            pose = [0.4, -0.2, 0.3, 0.0, math.pi, 0.0]
            process.backdoor("set", pose=pose)
            poses = [POSE_DATAGRAM.unpack(plant.recv(1024)) for _ in range(200)]
            latest = (time.monotonic() - start) * 10.0
        finally:
            process.stop()
    steps = [b[0] - a[0] for a, b in zip(poses, poses[1:], strict=False)]
    assert min(steps) == pytest.approx(0.08)
    assert 0 < poses[0][0] < poses[-1][0] < latest + 0.2
    assert poses[-1][1:4] == pytest.approx(pose[:3], abs=1e-9)


def test_it_ends_with_the_process_that_started_it() -> None:
    host = free_host()
    parent = f"import os; from sim_fakes.ur.process import UrProcess; UrProcess({host!r}); os._exit(0)"
    subprocess.run([sys.executable, "-c", parent], check=True, timeout=600)
    deadline = time.monotonic() + 60.0
    while True:
        try:
            socket.create_connection((host, 30004), timeout=1.0).close()
        except ConnectionError:
            return
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("arguments", [["--host", "10.0.0.1"], ["--host", "127.0.0.9", "--speed", "0"]])
def test_wrong_arguments_are_refused(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, "-m", "sim_fakes.ur", *arguments], capture_output=True, timeout=600)
    assert done.returncode == 2
