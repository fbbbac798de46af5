"""Forged motion capture, hostile text in what instruments and files say, and the fakes' own doors, on a whole rig."""

import re
import socket
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import psutil
import pytest
import yaml
from commands import SOUND, Cli
from terminal import Terminal
from virtual_lab import VirtualLab, meanwhile, recorded, settings

from lab.verbs.fakes import PATIENT_SETTLE
from recordings.file.reader import Recording
from tests.simulated.bench import repeated

# ------------------------------------------------------------------ who may speak
LIAR = "127.66.66.66"
FRAME_OF_AN_OLD_SESSION = b"\x07\x00\x04\x00" + (10**6).to_bytes(4, "little")


def forging(virtual_lab: VirtualLab) -> AbstractContextManager[None]:
    """Meanwhile another address sends datagrams to whatever hears any in this process."""

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as liar:
            liar.bind((LIAR, 0))
            for c in psutil.Process().net_connections("udp4"):
                if c.laddr.ip not in (virtual_lab.fakes.host, LIAR):
                    liar.sendto(FRAME_OF_AN_OLD_SESSION, (c.laddr.ip, c.laddr.port))

    return repeated(send, 0.5)


def test_check_tells_once_that_something_else_speaks(virtual_lab: VirtualLab, cli: Cli) -> None:
    with forging(virtual_lab):
        said = cli("check", "--rig", virtual_lab.rig, "--seconds", "1", "--json", code=SOUND)
    (warning,) = said.json["warnings"]
    assert LIAR in warning and virtual_lab.fakes.host in warning
    assert said.err.count("warning:") == 1


def test_the_recording_of_a_run_says_so_once_and_the_server_goes_on(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    short = settings("spine_lengths=[0.05]", "pressures=[60 kPa]")
    with forging(virtual_lab):  # whether busy processors let the run settle is not the question here
        said = cli("run", "bending", "--rig", virtual_lab.rig, *short, "--out", tmp_path, code=(0, 1, 3))
    assert said.err.count("warning:") == 1
    recording = Recording.open(recorded(tmp_path))
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


# ------------------------------------------------------------------ text that acts
HOSTILE = "[/red] [bold]x[/] \x1b[2J <script>alert(1)</script>"
SHOWN = "[/red] [bold]x[/]"
SERIAL = "\x1b[2J[/b]"
"""Eight characters that are no blanks, as the module's identity is."""
SHORT = settings("spine_lengths=[0.05, 0.08]", "pressures=[60 kPa]", *PATIENT_SETTLE)
"""Noise looks like motion when the processors are busy."""


@contextmanager
def hostile(lab: VirtualLab, folder: Path) -> Iterator[Path]:
    """A rig file and a robot with such names, and a valve with such an identity."""
    name = HOSTILE.replace("\x1b", "")  # a file that holds a control character is refused
    rig = yaml.safe_load(lab.rig.read_text()) | {"name": name}
    robot = yaml.safe_load(lab.rig.with_name("robot.yaml").read_text()) | {"name": name}
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot))
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(rig))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lab.fakes.lines["valve"], "identity", SERIAL)
        patch.setattr(lab.fakes.lines["valve"].faults, "extra", {})
        yield path


def test_check_shows_names_and_answers_plain_and_limits_with_units(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    with hostile(virtual_lab, tmp_path) as rig:
        said = cli("check", "--rig", rig, "--seconds", "0.3", code=SOUND)
        assert "\x1b" not in said.out + said.err and SHOWN in said.out and "\\x1b[2J[/b]" in said.out
        limits = "".join("".join(line.split("│")[-2] for line in said.out.splitlines() if line.startswith("│")).split())
        assert re.search(r"pressure\d+kPa,rate\d+kPa/s", limits) and re.search(r"turn[\d.]+rad", limits)
        virtual_lab.fakes.lines["valve"].faults.extra["foreign"] = HOSTILE
        said = cli("check", "--rig", rig, "--seconds", "0.3", code=1)
        assert "\x1b" not in said.out + said.err
        assert "missing: valve" in said.err and "[/red]" in said.err and "[/red]" in said.out and "missing" in said.out


def test_a_fault_in_mid_run_ends_it_with_its_error_and_a_whole_recording(real_lab: VirtualLab, tmp_path: Path) -> None:
    plant, valve = real_lab.fakes.plant, real_lab.fakes.lines["valve"]
    meanwhile(lambda: plant.valve_on, lambda: valve.faults.extra.update(garbled=HOSTILE))
    with hostile(real_lab, tmp_path) as rig, Terminal("run", "bending", "--rig", rig, *SHORT, "--out", tmp_path) as terminal:
        assert terminal.end() == 1, terminal.shown
    assert "\x1b[2J" not in terminal.raw, "the terminal was repainted"
    assert SHOWN in terminal.raw and "Traceback" not in terminal.raw
    recording = Recording.open(recorded(tmp_path))
    assert recording.outcome == "failed"
    assert "valve" in recording.metadata["outcome"]["detail"]
