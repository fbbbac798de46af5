"""The fake Motive on its wire, without any driver."""

import socket
import struct

import pytest

import timing
from sim_fakes.motive import CLIENT_TIMEOUT, MotiveFake
from sim_fakes.ur.process import free_host
from tests.simulated.bench import Bench, raises

CONNECT, SERVERINFO, REQUEST_MODELDEF, MODELDEF, FRAME, KEEPALIVE = 0, 1, 4, 5, 7, 10
ECHO_REQUEST, ECHO_RESPONSE, UNRECOGNIZED, DISCONNECT = 12, 13, 100, 9
REQUEST, RESPONSE, REQUEST_FRAME = 2, 3, 6


class Host:
    """A NatNet client of bare sockets."""

    def __init__(self, fake: MotiveFake) -> None:
        self.fake = fake
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))

    def send(self, message: int, payload: bytes = b"\0", announced: int | None = None) -> None:
        size = len(payload) if announced is None else announced
        self.socket.sendto(struct.pack("<HH", message, size) + payload, (self.fake.host, 1510))

    def receive(self, wanted: int, within: float = 20.0) -> bytes:
        """Payload of the next message of this id. Raises `TimeoutError` when none comes."""
        deadline = timing.now() + within
        while (left := deadline - timing.now()) > 0:
            if timing.readable([self.socket], left):
                data = self.socket.recv(65536)
                message, size = struct.unpack("<HH", data[:4])
                assert size == len(data) - 4
                if message == wanted:
                    return data[4:]
        raise TimeoutError(f"no message {wanted} within {within:g} s")


@pytest.fixture
def host(bench: Bench, request: pytest.FixtureRequest) -> Host:
    changes = getattr(request, "param", {})
    fake = bench.started(MotiveFake(bench.plant, bench.clock, free_host(), **changes))
    host = Host(fake)
    bench.closing(host.socket)
    return host


def test_no_frames_come_after_disconnecting(host: Host) -> None:
    host.send(CONNECT)
    assert host.receive(FRAME)
    host.send(DISCONNECT)
    deadline = timing.now() + 60
    while timing.readable([host.socket], 0.2):
        assert timing.now() < deadline, "frames still come"
        timing.recv(host.socket, 65536)


def test_a_datagram_of_another_length_than_announced_is_dropped(host: Host) -> None:
    host.send(CONNECT, b"Ping\0", announced=3)
    raises(TimeoutError, "no message 1", host.receive, SERVERINFO, 0.1)


def test_requests_without_content_may_end_with_the_zero_byte_of_the_makers_sample(
    host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim_fakes.motive.CLIENT_TIMEOUT", 1.5)
    host.send(CONNECT, b"Ping\0")
    host.send(REQUEST_MODELDEF, b"\0", announced=0)
    assert host.receive(MODELDEF)
    for content in (b"\0", b""):
        heard = host.fake.keep_alives
        until = timing.now() + 2.5
        while timing.now() < until:
            host.send(KEEPALIVE, content, announced=0)
            assert host.receive(FRAME)
            timing.sleep(0.02)
        assert host.fake.keep_alives > heard


@pytest.mark.long
def test_an_independent_client_hears_frames_for_longer_than_a_client_is_remembered(host: Host) -> None:
    client = pytest.importorskip("natnet").NatNetClient(
        server_ip_address=host.fake.host, local_ip_address="127.0.0.1", use_multicast=False
    )
    frames: list[object] = []
    models: list[object] = []
    client.on_data_frame_received_event.handlers.append(frames.append)
    client.on_data_description_received_event.handlers.append(models.append)
    client.connect()
    client.request_modeldef()
    until = timing.now() + CLIENT_TIMEOUT + 2
    while timing.now() < until:
        client.update_sync()
        timing.sleep(0.05)
    count = len(frames)
    client.update_sync()
    timing.sleep(0.1)
    client.update_sync()
    assert len(frames) > count and models
    client.shutdown()


def test_a_client_is_sent_the_bitstream_that_it_asked_for(host: Host) -> None:
    def size_of_a_frame() -> int:
        host.receive(FRAME)
        return len(host.receive(FRAME))

    other = Host(host.fake)
    try:
        other.send(CONNECT, b"Ping\0")
        for version in ((4, 1), (3, 1), (2, 9)):
            host.send(CONNECT, b"Ping".ljust(265, b"\0") + bytes((*version, 0, 0)) + b"\0")
            assert host.receive(SERVERINFO)
            assert size_of_a_frame() == len(host.fake._frame_payload(version))
        assert command(host, "Bitstream") == b"Bitstream,2.9"
        for asked, told in (("Bitstream,4.0", 0), ("Bitstream,9.0", -1), ("Bitstream,x", -1), ("Bitstream,3.0", 0)):
            assert command(host, asked) == struct.pack("<i", told)
        assert size_of_a_frame() == len(host.fake._frame_payload((3, 0)))
        assert host.fake.versions.keys() == {host.socket.getsockname()}
    finally:
        other.socket.close()


def command(host: Host, text: str) -> bytes:
    host.send(REQUEST, text.encode() + b"\0")
    return host.receive(RESPONSE)


def test_remote_requests_are_answered(host: Host) -> None:
    assert command(host, "FrameRate") == struct.pack("<f", 100.0)
    assert command(host, "AnalogSamplesPerMocapFrame") == command(host, "CurrentMode") == struct.pack("<i", 0)
    assert command(host, "StartRecording") == struct.pack("<i", 0)
    assert command(host, "CurrentMode") == struct.pack("<i", 1)
    host.send(REQUEST_FRAME)
    assert host.receive(FRAME)[-6] == 1  # recording
    assert command(host, "EditMode") == struct.pack("<i", 0) and command(host, "CurrentMode") == struct.pack("<i", 2)
    assert command(host, "Nonsense") == struct.pack("<i", -1)


@pytest.mark.parametrize("host", [{"version": (2, 9)}], indirect=True)
def test_a_client_of_old_counts_the_header_and_gets_the_short_description(host: Host) -> None:
    host.send(CONNECT, b"", announced=4)
    assert len(host.receive(SERVERINFO)) == 264
    host.send(REQUEST, b"FrameRate", announced=4 + len("FrameRate"))
    assert host.receive(RESPONSE)


def test_an_echo_request_gets_its_own_stamp_and_the_servers(host: Host) -> None:
    host.send(ECHO_REQUEST, struct.pack("<Q", 1234567))
    answer = host.receive(ECHO_RESPONSE)
    assert len(answer) == 16 and struct.unpack("<Q", answer[:8]) == (1234567,)
    host.send(55)
    assert host.receive(UNRECOGNIZED) == b""


def test_stamps_are_rig_time_at_any_speed(host: Host) -> None:
    payload = host.fake._frame_payload(host.fake.version)
    stamp = struct.unpack("<d", payload[-4 - 2 - 8 - 24 - 8 : -4 - 2 - 8 - 24])[0]
    assert stamp == pytest.approx(host.fake.clock.now(), abs=5.0)
