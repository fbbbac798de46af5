"""A clock that is not the host's belongs to fakes: what is real is told by what it is, and refused."""

import os
import pty
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml
from commands import Cli, refused

from drivers.configs import HOSTS, PORTS
from lab.files.rig_file import Instruments, NotInstalled, load_rig
from lab.files.robot_file import paper_robot
from lab.rig.real_time import at_real_speed, clock_of, demand_fakes

Write = Callable[..., Path]
REAL = "/dev/null"
"""A character device that is no pseudo-terminal, as a serial adapter is."""


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(speed: float = 20.0, **instruments: dict[str, Any]) -> Path:
        path = tmp_path / "rig.yaml"
        data = {"name": "a rig", "robot": str(paper_robot()), "clock": {"speed": speed}, "instruments": instruments}
        path.write_text(yaml.safe_dump(data))
        return path

    return write


def valve(port: str) -> dict[str, Any]:
    return {"driver": "numato", "port": port}


def arm(host: str) -> dict[str, Any]:
    return {"driver": "ur5", "host": host}


def mocap(server: str, local: str = "") -> dict[str, Any]:
    still = {"position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
    return {"driver": "natnet", "server": server, "local": local, "body": "Tip", "mocap_to_base": still}


def test_a_pseudo_terminal_under_any_name_and_loopback_hosts_may_run_fast(write: Write, tmp_path: Path) -> None:
    link, (master, slave) = tmp_path / "ttyUSB0", pty.openpty()
    link.symlink_to(os.ttyname(slave))
    rig = write(valve=valve(str(link)), arm=arm("127.3.2.1"), mocap=mocap("localhost", "127.0.0.1"))
    assert clock_of(load_rig(rig)).speed == 20.0
    os.close(slave)
    os.close(master)


def test_a_name_that_leads_elsewhere_is_refused_though_it_sounds_local(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(*_: object, **__: object) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 0)) for address in ("127.0.0.1", "192.168.1.5")]

    monkeypatch.setattr(socket, "getaddrinfo", found)
    refused(r"instruments.arm.host = localhost", clock_of, load_rig(write(arm=arm("localhost"))))


@pytest.mark.parametrize(
    ("instruments", "key"),
    [
        ({"arm": arm("192.168.1.5")}, "instruments.arm.host = 192.168.1.5"),
        ({"mocap": mocap("10.0.0.9")}, "instruments.mocap.server = 10.0.0.9"),
        ({"mocap": mocap("127.0.0.1", "10.0.0.2")}, "instruments.mocap.local = 10.0.0.2"),
        (
            {"pressure": {"driver": "smc_itv", "ports": [REAL], "chambers": [[1]], "full_scale": "500 kPa"}},
            f"instruments.pressure.ports = {REAL}",
        ),
        ({"valve": valve("socket://127.0.0.1:4000")}, "instruments.valve.port = socket://127.0.0.1:4000"),
        ({"valve": valve("rfc2217://127.0.0.1:4000")}, "instruments.valve.port = rfc2217://127.0.0.1:4000"),
    ],
)
@pytest.mark.parametrize("speed", [0.5, 20.0])
def test_what_is_real_is_named_by_instrument_and_place(write: Write, instruments: dict[str, Any], key: str, speed: float) -> None:
    refused(f"clock.speed = {speed:g}: {key} ", clock_of, load_rig(write(speed, **instruments)))
    clock_of(load_rig(write(1.0, **instruments)))


def test_a_port_that_appears_after_the_rig_was_assembled_is_looked_at_again(write: Write, tmp_path: Path) -> None:
    late = tmp_path / "ttyUSB0"
    rig = load_rig(write(valve=valve(str(late))))
    clock_of(rig)  # nothing is there: opening it says so
    late.symlink_to(REAL)
    refused("instruments.valve.port", demand_fakes, rig, only="valve")
    demand_fakes(rig, only="gauge")


@pytest.mark.parametrize("name", ["x" * 300, "loop", "pts/7"])
def test_a_port_that_cannot_be_looked_at_or_has_the_name_of_a_terminal_is_real(name: str, write: Write, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "pts").mkdir()
    (tmp_path / "pts/7").symlink_to(REAL)
    rig = load_rig(write(valve=valve(str(tmp_path / name))))
    refused(rf"clock.speed = 20: instruments.valve.port = {tmp_path / name} .*write speed: 1", clock_of, rig)


def test_a_port_that_could_write_a_file_stops_every_verb(write: Write, cli: Cli, tmp_path: Path) -> None:
    file = tmp_path / "precious"
    file.write_text("data")
    rig = write(1.0, valve=valve(f"spy:///dev/null?file={file}"))
    for verb, code in ((["check"], 2), (["run", "bending"], 2), (["safe"], 1)):
        said = cli(*verb, "--rig", rig, code=code)
        assert "instruments.valve.port" in said.out + said.err and "is not a port" in said.out + said.err
    assert file.read_text() == "data"


@pytest.mark.parametrize("verb", [["check"], ["run", "bending"]])
def test_no_verb_opens_real_instruments_at_another_speed(write: Write, cli: Cli, verb: list[str]) -> None:
    names = ("pressure", "spine", "gauge")
    tables = {
        "pressure": {"driver": "alicat", "port": REAL},
        "spine": {"driver": "tmcl", "port": REAL, "metres_per_turn": 0.1},
        "gauge": {"driver": "pfeiffer", "port": REAL},
    }
    rig = write(valve=valve(REAL), mocap=mocap("192.0.2.1"), **tables)
    text = cli(*verb, "--rig", rig, code=2).err
    assert all(f"clock.speed = 20: instruments.{name}.port = {REAL}" in text for name in (*names, "valve"))
    assert "instruments.mocap.server = 192.0.2.1" in text


def test_a_landing_is_not_refused_and_is_done_at_real_speed(write: Write, cli: Cli) -> None:
    path = write(valve=valve(REAL))
    rig, told = at_real_speed(load_rig(path))
    assert rig.clock.speed == 1 and rig.path == path.resolve() and "speed 1" in told
    done = cli("safe", "--rig", path, code=1)
    assert f"instruments.valve.port = {REAL}" in done.err and "NOT CONFIRMED" in done.out


def test_every_instrument_has_an_address_that_the_rule_knows() -> None:
    for name, field in Instruments.model_fields.items():
        kinds = [kind for kind in _leaves(field.annotation) if hasattr(kind, "model_fields") and kind is not NotInstalled]
        assert kinds or name == "sensors", name
        for kind in kinds:
            assert set(kind.model_fields) & {*PORTS, *HOSTS}, f"{name}: {kind.__name__} is reached by none of the keys"


def _leaves(annotation: Any) -> list[Any]:
    inner = [leaf for a in get_args(annotation) for leaf in _leaves(a)]
    return inner or [annotation]
