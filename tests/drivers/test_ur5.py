"""Motion of the arm, through the maker's library."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from ur5_rig import Rig, a_rig, an_arm, discard, raised

import timing
from drivers.errors import DeviceFault, LimitExceeded, NotReady
from drivers.ur5.driver import UR5, Config
from drivers.ur5.motion import Deadline, distance_between, turn_between
from drivers.ur5.state import UR5State
from drivers.ur5.wire import UrController
from tests.simulated.bench import raises, wait_until
from timing import RigClock

UP = 0.01
"""m; the moves of these tests go so far up and back."""
SPEED, ACCELERATION = 0.05, 0.5


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with a_rig() as rig:
        yield rig
        assert rig.process.backdoor()["violations"] == []


@pytest.fixture(scope="module")
def arm(rig: Rig) -> Iterator[UR5]:
    with an_arm(rig, watchdog_frequency=2.0) as arm:  # a busy computer may be late
        yield arm


@pytest.fixture(scope="module")
def watcher(rig: Rig) -> Iterator[UR5State]:
    """A second pair of eyes on the arm."""
    state = UR5State(UrController("watcher", rig.host, 1.0), rig.clock, discard, max_age=5.0)
    state.open()
    yield state
    state.close()


def arrived(arm: UR5, timeout: float = 10.0) -> None:
    wait_until(lambda: not arm.moving(), timeout)


BEYOND: dict[str, tuple[dict[str, Any], str]] = {
    "speed": ({"speed": 0.2}, r"speed 0.2 m/s outside 0..0.1 m/s"),
    "no speed": ({"speed": 0.0}, r"speed 0 m/s outside"),
    "acceleration": ({"acceleration": 2.0}, r"acceleration 2 m/s\^2 outside 0..0.5"),
    "workspace": ({"shift": (0.0, 2.0, 0.0)}, r"y = .* m outside the workspace -0.75..0.75 m"),
    "table": ({"z": 0.0}, r"z = 0.0000 m outside the workspace"),
    "step": ({"shift": (-0.35, 0.0, 0.0)}, r"target is 0.3500 m away, limit 0.3 m"),
    "turn": ({"rotation": (0.0, 0.0, 0.0)}, r"target is turned by 3.142 rad, limit 0.8 rad"),
    "nan": ({"z": math.nan}, "needs six numbers"),
}


def test_a_motion_refuses_a_second_one_is_seen_by_a_glance_that_takes_no_control_and_stops_within_a_short_distance(
    rig: Rig, arm: UR5, watcher: UR5State
) -> None:
    stranger, start = UR5("stranger", Config(host=rig.host), rig.clock), watcher.latest().tcp_pose
    assert stranger.glance() is True
    arm.move_to(raised(start, 10 * UP), SPEED, ACCELERATION)
    raises(NotReady, "still moving", arm.move_to, start, SPEED, ACCELERATION)
    wait_until(lambda: watcher.latest().tcp_speed[2] > 0.8 * SPEED)
    assert stranger.glance() is False
    arm.stop()
    stopped = watcher.latest().tcp_pose
    assert distance_between(start, stopped) < 5 * UP
    assert stranger.glance() is True and arm.moving() is False
    timing.sleep(0.1)
    assert distance_between(watcher.latest().tcp_pose, stopped) < 1e-3
    arm.move_to(start, SPEED, ACCELERATION)  # the arm is still in our control
    arrived(arm)


@pytest.mark.parametrize("what", BEYOND)
def test_a_request_beyond_a_limit_is_refused_and_nothing_is_sent(rig: Rig, arm: UR5, watcher: UR5State, what: str) -> None:
    change, message = BEYOND[what]
    pose = list(watcher.latest().tcp_pose)
    for axis, by in enumerate(change.get("shift", ())):
        pose[axis] += by
    pose[2] = change.get("z", pose[2])
    pose[3:] = change.get("rotation", pose[3:])
    rig.process.backdoor("forget")
    raises(LimitExceeded, message, arm.move_to, pose, change.get("speed", SPEED), change.get("acceleration", ACCELERATION))
    timing.sleep(0.03)
    assert rig.process.backdoor()["commands"] == []


def test_a_motion_that_takes_too_long_is_stopped_and_reported(rig: Rig, arm: UR5, watcher: UR5State) -> None:
    rig.process.backdoor("set", slider=0.05)
    arm.move_to(raised(watcher.latest().tcp_pose, UP), SPEED, ACCELERATION)
    raises(DeviceFault, "speed slider", arrived, arm)
    rig.process.backdoor("set", slider=1.0)
    assert not arm.moving()
    assert rig.process.backdoor()["commands"][-1]["name"] == "stopl"


def test_a_sped_up_rig_moves_by_its_own_clock_and_with_the_tcp_it_was_given() -> None:
    with a_rig(speed=20.0) as rig:
        arm = UR5("arm", Config(host=rig.host, timeout=3.0, tcp=(0.0, 0.0, 0.12, 0.0, 0.0, 0.0)), rig.clock)
        arm.open()
        start = tuple(rig.process.backdoor()["pose"])
        goal = raised(start, -0.2)
        before = timing.now(), rig.clock.now()
        arm.move_to(goal, SPEED, ACCELERATION)  # 4.1 s of the rig
        arrived(arm)
        host, own = timing.now() - before[0], rig.clock.now() - before[1]
        assert own > 3.5 and host < own / 10  # a late fake catches up
        assert distance_between(rig.process.backdoor()["pose"], goal) < 1e-4
        assert start[2] == pytest.approx(0.4319 - 0.12, abs=1e-3)
        arm.close()
        assert rig.process.backdoor()["ended"] == ["stopped by the client"]


def test_the_two_names_of_a_half_turn_are_the_same_orientation() -> None:
    a, b = (0.0, 0.0, 0.0, math.pi - 1e-6, 0.0, 0.0), (0.0, 0.0, 0.0, -math.pi + 1e-6, 0.0, 0.0)
    assert turn_between(a, b) == pytest.approx(2e-6, rel=1e-3)
    assert turn_between((0.0,) * 6, (0.0, 0.0, 0.0, 0.0, 0.7, 0.0)) == pytest.approx(0.7)


def test_a_deadline_counts_the_motion_in_rig_time_and_the_wire_in_host_time() -> None:
    clock = RigClock(100.0)
    deadline = Deadline.after(clock, rig_allowed=5.0, host_margin=0.2)
    clock.sleep(10.0)  # 0.1 s of the host: the motion's time is over, the wire's margin is not
    assert not deadline.expired
    clock.sleep(25.0)
    assert deadline.expired
