"""What a driver refuses before anything is connected, and at opening: named, with what to do."""

from typing import Any

import pytest
from pydantic import ValidationError

from drivers.errors import LimitExceeded, Unreachable, WrongDevice
from lab.driver_contract import Unit, answers, unit
from lab.files.all_drivers import drivers

__all__ = ["unit"]
POSE = {"position": (0, 0, 0), "quaternion": (1, 0, 0, 0)}
TABLES: dict[str, dict[str, Any]] = {
    "alicat": {"port": "/dev/ttyUSB0"},
    "smc_itv": {"ports": list("abcdefghi"), "chambers": [[i] for i in range(1, 10)], "full_scale": 500e3},
    "pfeiffer": {"port": "x"},
    "dynamixel": {"port": "x", "metres_per_turn": 0.1},
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
        ("alicat", {"max_pressure": 500e3}, "above the units' full_scale"),
        ("alicat", {"chambers": ((1,), (1,), (2,))}, "chamber 1 is listed"),
        ("alicat", {"baud": 4800}, "19200"),
        ("alicat", {"prot": "x"}, "Extra inputs"),
        ("smc_itv", {"ports": ["a"]}, "1 ports but 9 lists"),
        ("smc_itv", {"ports": ["a"] * 9}, "listed twice"),
        ("smc_itv", {"max_pressure": 600e3}, "above the units' full_scale"),
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
    with pytest.raises(ValidationError, match=message):
        config.model_validate(table | changes)


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
def test_what_is_not_there(unit: Unit, changes: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        unit.another(**changes).open()


@pytest.mark.parametrize(
    ("unit", "is_", "message"),
    [
        ("pfeiffer", {"kind": "    A3"}, "PPT 100"),
        ("tmcl", {"module": 1140}, "TMCM-1140"),
        ("ft300s", {"faults.extra": {"foreign": "GRP"}}, "'GRP'"),
    ],
    indirect=["unit"],
)
def test_another_model(unit: Unit, is_: dict[str, Any], message: str) -> None:
    (line,) = unit.disturbed
    for name, value in is_.items():
        holder, _, attribute = name.rpartition(".")
        setattr(line.faults if holder else line, attribute, value)
    with pytest.raises(WrongDevice, match=message):
        unit.driver.open()
    assert not answers(unit.driver.open)
