"""Forged motion capture, and the fakes' own doors, on a whole rig."""

from __future__ import annotations

import json
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from virtual_lab import VirtualLab

import timing
from lab.cli import main
from recordings.file.reader import Recording

LIAR = "127.66.66.66"
FRAME_OF_AN_OLD_SESSION = b"\x07\x00\x04\x00" + (10**6).to_bytes(4, "little")


@contextmanager
def forging(virtual_lab: VirtualLab) -> Iterator[None]:
    """Meanwhile another address sends datagrams to whatever hears any in this process."""
    over = timing.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as liar:
            liar.bind((LIAR, 0))
            while not over.wait(0.5):
                for c in psutil.Process().net_connections("udp4"):
                    if c.laddr.ip not in (virtual_lab.fakes.host, LIAR):
                        liar.sendto(FRAME_OF_AN_OLD_SESSION, (c.laddr.ip, c.laddr.port))

    thread = timing.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_check_tells_once_that_something_else_speaks(virtual_lab: VirtualLab, capsys: pytest.CaptureFixture[str]) -> None:
    with forging(virtual_lab):
        assert main(["check", "--rig", str(virtual_lab.rig), "--seconds", "1", "--json"]) in (0, 3)
    said = capsys.readouterr()
    (warning,) = json.loads(said.out)["warnings"]
    assert LIAR in warning and virtual_lab.fakes.host in warning
    assert said.err.count("warning:") == 1


def test_the_recording_of_a_run_says_so_once_and_the_server_goes_on(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ["--set", "spine_lengths=[0.05]", "--set", "pressures=[60 kPa]"]
    with forging(virtual_lab):  # whether busy processors let the run settle is not the question here
        main(["run", "bending", "--rig", str(virtual_lab.rig), *short, "--out", str(tmp_path)])
    assert capsys.readouterr().err.count("warning:") == 1
    (file,) = tmp_path.glob("*.mcap")
    recording = Recording.open(file)
    (warning,) = [line for line in recording.log if LIAR in line.text]
    assert warning.level == "warning"
    tips = recording.stream("/tip")
    assert len(tips) > 100 and (tips["frame"] != 10**6).all()


def test_everything_that_fakes_listen_on_is_of_this_computer_alone(virtual_lab: VirtualLab) -> None:
    own = psutil.Process()
    ports = [c for p in (own, *own.children(recursive=True)) for c in p.net_connections("inet")]
    listening = [c.laddr.ip for c in ports if c.status == psutil.CONN_LISTEN or c.type == socket.SOCK_DGRAM]
    assert len(listening) >= 6 and all(ip.startswith("127.") for ip in listening), listening


def test_the_back_doors_let_their_own_user_in_alone(real_lab: VirtualLab) -> None:
    ur = real_lab.fakes.ur
    assert ur is not None
    for path in (real_lab.fakes.door.path, ur.door):
        assert path.is_socket() and stat.S_IMODE(path.parent.stat().st_mode) == 0o700
