"""What a driver refuses before anything is connected, and at opening: named, with what to do."""

import socket
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

import timing
from drivers.configs import RegulatorsConfig, known_port
from drivers.errors import LimitExceeded, Unreachable, WrongDevice
from drivers.serial_line import SerialLine, SerialPort
from lab.driver_contract import DriverOnFake, unit
from lab.files.rig_file import drivers
from tests.simulated.bench import raises

__all__ = ["unit"]
POSE = {"position": (0, 0, 0), "quaternion": (1, 0, 0, 0)}
TABLES: dict[str, dict[str, Any]] = {
    "alicat": {"port": "/dev/ttyUSB0"},
    "smc_itv": {"ports": [f"/dev/tty{i}" for i in range(9)], "chambers": [[i] for i in range(1, 10)], "full_scale": 500e3},
    "pfeiffer": {"port": "/dev/ttyUSB0"},
    "dynamixel": {"port": "/dev/ttyUSB0", "metres_per_turn": 0.1},
    "ur5": {"host": "127.0.0.1"},
    "natnet": {"server": "127.0.0.1", "body": "Tip", "mocap_to_base": POSE},
}
"""Tables of rig.yaml that can work."""


@pytest.mark.parametrize(
    ("driver", "changes", "message"),
    [
        ("alicat", {"units": ("A", "A", "B")}, "used once"),
        ("alicat", {"units": ("A", "B")}, "2 units but 3 lists of chambers"),
        ("alicat", {"units": ("A", "B", "c")}, "'c' must be one letter"),
        ("alicat", {"baud": 4800}, "19200"),
        ("alicat", {"prot": "x"}, "Extra inputs"),
        ("smc_itv", {"ports": ["/dev/a"]}, "1 ports but 9 lists"),
        ("smc_itv", {"ports": ["/dev/a"] * 9}, "listed twice"),
        ("pfeiffer", {"lowest": 2e4, "highest": 1e4}, "lowest"),
        ("dynamixel", {"homing_current": 2.0, "current_limit": 1.0}, "homing_current"),
        ("ur5", {"workspace_min": (0.0, 1.0, 0.0), "workspace_max": (0.5, 0.5, 0.5)}, "workspace_min y"),
        ("natnet", {"mocap_to_base": {**POSE, "quaternion": (1, 1, 0, 0)}}, "length 1"),
        ("natnet", {"max_age": 0.01}, "two frames"),
        ("natnet", {"mocap_to_base": None}, "mocap_to_base"),
    ],
)
def test_a_table_that_cannot_work(driver: str, changes: dict[str, Any], message: str) -> None:
    config, table = drivers()[driver].config, {"driver": driver, **TABLES[driver]}
    config.model_validate(table)
    raises(ValidationError, message, config.model_validate, table | changes)


@pytest.mark.parametrize("changes", [{"max_pressure": 6e5}, {"chambers": ((1,), (1,))}])
def test_regulators_of_every_driver_stay_within_their_range_and_their_wiring(changes: dict[str, Any]) -> None:
    table = {"chambers": ((1,),), "full_scale": 500e3}
    RegulatorsConfig.model_validate(table)
    raises(ValidationError, "above the units' full_scale|chamber 1 is listed", RegulatorsConfig.model_validate, table | changes)


NO_PORTS = [
    "spy:///dev/null?file={file}", "SPY:///dev/null?file={file}", "alt:///dev/null?class=Serial", "loop://", "hwgrep://USB",
    "cp2110://x", "socket://127.0.0.1:4000?logging=debug", "rfc2217://127.0.0.1:4000?ign_set_control", "socket://127.0.0.1",
    "socket://:4000", "socket://127.0.0.1:0", "socket://127.0.0.1:70000", "socket://a@b:4000", "socket://127.0.0.1:4000/",
    "socket://127.0.0.1:4000#x", "SOCKET://127.0.0.1:4000", " /dev/ttyUSB0", "ttyUSB0", "", "/dev/tty\nUSB0", "/dev/a://b",
    "socket://127.0.0.1:\u0664\u0660\u0660\u0660",
]  # fmt: skip


@pytest.mark.parametrize("port", NO_PORTS)
def test_a_port_is_a_device_path_or_a_terminal_server(port: str, tmp_path: Path) -> None:
    file = tmp_path / "precious"
    file.write_text("data")
    port = port.format(file=file)
    tables = {"port": ("alicat", {"port": port}), "ports": ("smc_itv", {"ports": [port, *TABLES["smc_itv"]["ports"][1:]]})}
    for key, (driver, changes) in tables.items():
        config, table = drivers()[driver].config, {"driver": driver, **TABLES[driver]}
        with pytest.raises(ValidationError, match=f"{key}\n.*is not a port; write the path of a device, .*socket://HOST:PORT"):
            config.model_validate(table | changes)
    raises(Unreachable, "is not a port; write the path of a device", SerialPort("valve", port, 19200, 1.0).open)
    assert file.read_text() == "data"


def test_ports_of_terminal_servers_are_known() -> None:
    ports = ["socket://192.168.1.9:4001", "rfc2217://moxa-1.lab:950", "socket://[fe80::1]:4000", "/dev/serial/by-id/usb-A_B:1"]
    assert [known_port(port) for port in ports] == ports


def test_a_line_behind_a_terminal_server_is_asked_as_any_other() -> None:
    def greet() -> None:
        accepted.append(server.accept()[0])
        accepted[0].sendall(b"PQ-4\r")

    accepted: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        greeter = timing.Thread(target=greet)
        line = SerialLine("valve", f"socket://127.0.0.1:{server.getsockname()[1]}", 19200, 5.0, settle=0.1)
        greeter.start()
        line.open()
        greeter.join()
        with accepted[0] as device:
            assert line.read_until(b"\r") == b"PQ-4"  # the greeting, that is there when the line is open
            line.write(b"A\r")
            assert device.recv(10) == b"A\r"
            device.sendall(b"yes\r")
            assert line.read_until(b"\r") == b"yes"
        line.close()


@pytest.mark.parametrize(
    ("unit", "changes", "error", "message"),
    [
        ("dynamixel", {"id": 7}, Unreachable, "id 7"),
        ("dynamixel", {"current_limit": 4.5}, LimitExceeded, "3.2"),
        ("tmcl", {"address": 9}, Unreachable, "module 9"),
        ("pfeiffer", {"address": 77}, Unreachable, "address 77"),
        ("numato", {"relay": 20}, WrongDevice, "relay number|relay module"),
        ("ur5", {"serial": "1"}, WrongDevice, "serial number .* is '20183500000', not '1'"),
        ("ur5", {"model": "UR10"}, WrongDevice, "model .* is 'UR5', not 'UR10'"),
        ("natnet", {"server": "a" * 200}, Unreachable, "a" * 200),
        ("natnet", {"server": "255.255.255.255"}, Unreachable, "255.255.255.255"),
        ("natnet", {"local": "192.0.2.1"}, Unreachable, "192.0.2.1"),
        ("natnet", {"body": "Tipp"}, WrongDevice, "'Tipp'.*nearest name is 'Tip'"),
        ("natnet", {"markers": ("M9",)}, WrongDevice, "'M9'"),
    ],
    indirect=["unit"],
)
def test_what_is_not_there(unit: DriverOnFake, changes: dict[str, Any], error: type[Exception], message: str) -> None:
    raises(error, message, unit.another(**changes).open)
