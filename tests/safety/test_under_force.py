"""The arm moves only while the force sensor sends, through the real drivers and wires."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from house import House, until

import timing
from drivers.errors import DeviceFault, StaleReading
from lab.rig.assembly import Rig
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from tests.simulated.bench import raises

FAR, SLOW, STILL = 0.28, 6e-3, 1e-3
"""m, and m/s of rig time: more than two host seconds at the speed of these fakes; a standing arm is slower than STILL."""


@pytest.fixture
def rig(house: House) -> Iterator[Rig]:
    house.change(without=("mocap",))
    with house.opened() as opened:
        yield opened


def sensor(house: House) -> Any:
    return house.fakes.lines["force"]


def here(house: House) -> Any:
    with house.fakes.plant.lock:
        return house.fakes.plant.probe_position.copy()


def speed(house: House) -> float:
    assert house.fakes.ur is not None
    return float(max(abs(v) for v in house.fakes.ur.backdoor()["tcp_speed"][:3]))


def set_off(house: House, rig: Rig) -> tuple[float, ...]:
    """Start a long slow motion; returns its goal once the arm is on its way."""
    pose = list(rig.streams["arm_state"].latest().tcp_pose)
    goal = (pose[0], pose[1] + (FAR if pose[1] < 0 else -FAR), *pose[2:])
    start = here(house)
    rig.actuators.arm.move_to(goal, SLOW, 0.3)
    assert until(lambda: rig.actuators.arm.moving() and np.linalg.norm(here(house) - start) > 0.01, 20.0)
    return goal


def test_without_samples_the_arm_stops_though_the_program_does_nothing_and_goes_on_with_them(
    house: House, rig: Rig, tmp_path: Path
) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        rig.record_to(recorder)
        goal = set_off(house, rig)
        sensor(house).faults.extra["drip"] = 1e6
        last = here(house)
        assert until(lambda: speed(house) < STILL, 10.0)
        stopped = here(house)
        assert np.linalg.norm(stopped - last) < FAR / 2
        assert rig.vital.landed is None
        del sensor(house).faults.extra["drip"]
        assert until(lambda: not rig.actuators.arm.moving(), 60.0)
        assert until(lambda: recorder.counts()["/log"].generated > 1, 5.0)  # the first line is the recorder's own
        rig.record_to(None)
    assert until(lambda: np.linalg.norm(here(house) - np.array(goal[:3])) < 1e-3, 5.0), (here(house), goal)
    lines = [line.text for line in Recording.open(tmp_path / "a.mcap").log if "max_age_in_motion" in line.text]
    assert len(lines) == 1


def test_a_motion_asked_for_without_samples_does_not_begin(house: House, rig: Rig) -> None:
    sensor(house).faults.extra["drip"] = 1e6
    assert until(lambda: timing.now() - sensor(house)._sent_at > 0.2, 5.0)
    start = here(house)
    pose = list(rig.streams["arm_state"].latest().tcp_pose)
    rig.actuators.arm.move_to((pose[0], pose[1] * 0.8, *pose[2:]), 0.05, 0.3)
    raises(StaleReading, "max_age_in_motion", until, lambda: not rig.actuators.arm.moving(), 30.0)
    assert np.linalg.norm(here(house) - start) < 1e-4


def test_a_drip_never_sets_the_arm_going_again_and_ends_the_motion(house: House, rig: Rig) -> None:
    set_off(house, rig)
    sensor(house).faults.extra["drip"] = 0.4
    sent = sensor(house).sent
    assert until(lambda: sensor(house).sent > sent + 1 and speed(house) < STILL, 10.0)
    stopped, sent = here(house), sensor(house).sent
    raises(StaleReading, "max_age_in_motion", until, lambda: not rig.actuators.arm.moving(), 60.0)
    assert sensor(house).sent > sent + 2, "samples came meanwhile"
    assert np.linalg.norm(here(house) - stopped) < 1e-4


@pytest.mark.parametrize(("zeroed", "newton"), [(False, 250.0), (True, 80.0)])
def test_too_much_force_stops_the_arm_before_the_sensor_has_its_zero_and_after(
    house: House, rig: Rig, zeroed: bool, newton: float
) -> None:
    if zeroed:
        rig.streams["force"].zero(5)
    set_off(house, rig)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensor(house).device, "bias", sensor(house).device.bias + np.array([newton, 0, 0, 0, 0, 0]))
        assert until(lambda: rig.vital.landed is not None, 10.0)
    assert speed(house) < STILL
    with pytest.raises(DeviceFault, match="limits.max_force"):
        rig.actuators.arm.move_to(tuple(rig.streams["arm_state"].latest().tcp_pose), SLOW, 0.3)
