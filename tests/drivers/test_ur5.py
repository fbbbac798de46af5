"""The state stream of the arm, and its motion through the maker's library."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import pytest
from ur5_rig import Rig, a_rig, an_arm, discard, raised

import timing
from drivers.errors import BadReply, DeviceFault, LimitExceeded, NotReady, StaleReading
from drivers.interfaces import ArmSample
from drivers.ur5.driver import DRIVER, UR5, Config
from drivers.ur5.motion import Deadline, distance_between, turn_between
from drivers.ur5.state import CycleCounter, UR5State, check_plausible
from drivers.ur5.wire import UrController
from tests.simulated.bench import raises, wait_until
from timing import RigClock


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with a_rig() as rig:
        yield rig
        assert rig.process.backdoor()["violations"] == []


class Stream:
    """An open state driver and everything it has delivered."""

    def __init__(self, rig: Rig) -> None:
        self.samples: list[ArmSample] = []
        self.driver = UR5State(UrController("arm state", rig.host, 1.0), rig.clock, self.samples.append)
        self.identity = self.driver.open()


@pytest.fixture(scope="module")
def stream(rig: Rig) -> Iterator[Stream]:
    stream = Stream(rig)
    yield stream
    stream.driver.close()


def accounted(stream: Stream) -> None:
    """Every cycle between the first and the last stamp was either delivered or counted as lost."""
    driver = stream.driver
    while True:  # the thread counts a sample before it delivers it: look again when one came in between
        lost, stamps = driver.lost, [sample.device_time for sample in stream.samples]
        timing.sleep(0.002)
        if (driver.lost, len(stream.samples)) == (lost, len(stamps)):
            break
    steps = [(b - a) / driver.cycle for a, b in zip(stamps, stamps[1:], strict=False)]
    assert all(math.isclose(step, round(step), abs_tol=1e-3) and round(step) >= 1 for step in steps)
    assert sum(round(step) - 1 for step in steps) == lost


def test_stamps_step_by_whole_cycles(stream: Stream) -> None:
    wait_until(lambda: len(stream.samples) > 60)
    assert stream.driver.cycle == 0.008
    accounted(stream)


def test_a_sample_tells_where_the_arm_is(rig: Rig, stream: Stream) -> None:
    state, sample = rig.process.backdoor(), stream.driver.latest()
    assert sample.joints == pytest.approx(state["q"], abs=2e-4)
    assert sample.tcp_pose[:3] == pytest.approx(state["pose"][:3], abs=2e-4)
    assert max(map(abs, sample.tcp_speed)) < 2e-3
    assert (sample.safety_bits, sample.program_running) == (1, False)


def stale(stream: Stream) -> str:
    """Why the newest sample is refused for its age, nothing when it is not."""
    try:
        stream.driver.latest()
    except StaleReading as e:
        return str(e)
    return ""


def test_a_frozen_controller_makes_the_reading_stale_and_its_gap_is_counted(rig: Rig, stream: Stream) -> None:
    before = stream.driver.lost
    rig.process.backdoor("freeze", seconds=1.8)  # the stream of a busy computer is late by some of it
    wait_until(lambda: "limit 0.2 s" in stale(stream))
    # A busy computer's own gaps are counted by themselves.
    wait_until(lambda: stream.driver.lost - before >= 1.4 / 0.008)
    wait_until(lambda: not stale(stream))
    assert stream.driver.latest().device_time > 0
    accounted(stream)


def test_a_dropped_connection_is_taken_up_again_and_its_gap_is_counted(rig: Rig, stream: Stream) -> None:
    before, interruptions = stream.driver.lost, stream.driver.interruptions
    rig.process.backdoor("drop")
    wait_until(lambda: stream.driver.interruptions > interruptions and stream.driver.lost > before)
    assert stream.driver.interruptions == interruptions + 1
    accounted(stream)
    assert rig.process.backdoor()["violations"] == []


@pytest.mark.parametrize(
    ("joint", "shift", "turn"),
    [(1e9, 0.3, 3.1), (1.0, 4.0, 3.1), (1.0, 0.3, 1e200), (1.0, 0.3, 7.5), (math.nan, 0.3, 3.1), (0.0, 0.0, 0.0)],
)
def test_numbers_that_no_arm_can_have_are_refused(joint: float, shift: float, turn: float) -> None:
    sample = ArmSample(0.0, 0.0, (joint, *[0.0] * 5), (shift, 0.0, 0.0, turn, 0.0, 0.0), (0.0,) * 6, 1, True)
    raises(BadReply, "which is impossible", check_plausible, "arm state", "127.0.0.1", sample)


def test_a_full_turn_is_no_wonder() -> None:
    sample = ArmSample(0.0, 0.0, (6.2,) * 6, (0.3, 0.1, 0.4, -3.2, 0.1, 0.0), (0.0,) * 6, 1, True)
    check_plausible("arm state", "127.0.0.1", sample)


def test_a_sped_up_e_series_shows_its_own_cycle() -> None:
    with a_rig(speed=10.0, version="5.12.4.1101661") as rig:
        stream = Stream(rig)
        wait_until(lambda: len(stream.samples) > 60)
        accounted(stream)
        assert stream.driver.cycle == pytest.approx(0.020)
        rig.process.kill()
        wait_until(lambda: stream.driver.interruptions == 1)
        start = timing.now()
        stream.driver.close()
        stream.driver.close()
        assert timing.now() - start < 30.0
        raises(NotReady, None, stream.driver.latest)


@pytest.mark.parametrize(("seen", "missing"), [({*range(60)} - {3, 4}, 2), (range(0, 60, 2), 29), ([*range(50, 90), 0, 1], 0)])
def test_the_counter_finds_every_gap_from_the_first_stamp_on(seen: Iterable[int], missing: int) -> None:
    counter = CycleCounter(0.008)
    assert sum(counter.add(0.008 * i) for i in seen) == missing


def test_the_arms_timeout_is_also_that_of_its_states() -> None:
    assert DRIVER.make_state is not None
    arm = DRIVER.config(host="127.0.0.1", timeout=3.0, max_age=0.7)
    stream = DRIVER.make_state("arm_state", arm, RigClock(), lambda sample: None)
    assert isinstance(stream, UR5State)
    assert (stream.controller.timeout, stream.max_age) == (3.0, 0.7)


# -- its motion
UP = 0.01
"""m; the moves of these tests go so far up and back."""
SPEED, ACCELERATION = 0.05, 0.5


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
