"""Who may prepare and confirm: a program of the same user at a Unix socket, and nobody else."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

import timing
from lab.files.rig_file import RigFile
from lab.rig.operator import Program, operator
from protocols.bench import Setup
from protocols.errors import ProtocolError, Stopped

SETUP = Setup("robot", 0.0, 0.0, 80e3)
needs_root = pytest.mark.skipif(os.getuid() != 0, reason="needs a second user")
NOBODY = 65534


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Short enough for a socket, of mode 0700."""
    folder = tmp_path_factory.mktemp("op", numbered=True)
    folder.chmod(0o700)
    yield folder


@contextmanager
def answering(path: Path, answer: object) -> Iterator[list[dict[str, object]]]:
    """A program that answers one question."""
    asked: list[dict[str, object]] = []
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()

        def serve() -> None:
            try:
                connection, _ = server.accept()
            except OSError:
                return  # nobody asked
            with connection:
                asked.append(json.loads(connection.makefile().readline()))
                connection.sendall(json.dumps(answer).encode() + b"\n")

        thread = timing.Thread(target=serve, daemon=True)
        thread.start()
        yield asked
        server.shutdown(socket.SHUT_RDWR)
        thread.join(10)


def test_a_program_of_ones_own_prepares_and_confirms(folder: Path) -> None:
    path = folder / "operator.sock"
    with answering(path, {"ok": True}) as asked:
        operator(f"unix:{path}").prepare(SETUP)
    assert asked[0]["prepare"]["mount"] == "robot"  # type: ignore[index]
    path.unlink()
    with answering(path, {"ok": False}), pytest.raises(Stopped, match="does not confirm"):
        operator(f"unix:{path}").confirm("the tip is hidden")


@pytest.mark.parametrize("mode", [0o755, 0o750, 0o701, 0o770])
def test_a_folder_that_others_may_enter_is_refused_with_what_to_do(folder: Path, mode: int) -> None:
    folder.chmod(mode)
    with answering(folder / "operator.sock", {"ok": True}) as asked:
        with pytest.raises(ProtocolError, match=f"mode {mode:04o}.*chmod 700 {folder}"):
            Program(folder / "operator.sock").confirm("the tip is hidden")
        assert asked == []


@needs_root
def test_a_folder_of_another_user_is_refused(folder: Path) -> None:
    os.chown(folder, NOBODY, NOBODY)
    with answering(folder / "operator.sock", {"ok": True}) as asked:
        with pytest.raises(ProtocolError, match=f"belongs to user {NOBODY}"):
            Program(folder / "operator.sock").prepare(SETUP)
        assert asked == []


@needs_root
def test_another_user_who_listens_there_is_refused(folder: Path) -> None:
    path = folder / "operator.sock"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        child = os.fork()
        if child == 0:
            os.setuid(NOBODY)
            server.listen()
            server.accept()[0].recv(1000)
            os._exit(0)
        try:
            said = "Connection refused"
            while "Connection refused" in said:  # until the other user listens
                with pytest.raises(ProtocolError) as refused:
                    Program(path).prepare(SETUP)
                said = str(refused.value)
            assert f"user {NOBODY} listens there" in said
        finally:
            os.kill(child, 9)
            os.waitpid(child, 0)


def test_nobody_there_is_told_with_what_to_do(folder: Path) -> None:
    with pytest.raises(ProtocolError, match="no usable answer.*operator: console"):
        Program(folder / "operator.sock").prepare(SETUP)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("tcp://127.0.0.1:4000", "anybody on this computer could connect there; write console, or unix:/FOLDER"),
        ("unix:operator.sock", "unix:/FOLDER"),
        ("unix:/" + "a" * 200, "shorter than 108 bytes"),
        ("", "write console"),
    ],
)
def test_a_line_that_is_open_to_everybody_is_refused_with_what_to_write(spec: str, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        RigFile.model_validate(yaml.safe_load(f"{{name: r, robot: robot.yaml, instruments: {{}}, operator: {spec!r}}}"))
