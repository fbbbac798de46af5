"""The state stream of the arm."""

import math
from collections.abc import Iterable, Iterator

import pytest
from ur5_rig import Rig, a_rig

import timing
from drivers.errors import BadReply, NotReady, StaleReading
from drivers.interfaces import ArmSample
from drivers.ur5.driver import DRIVER
from drivers.ur5.state import CycleCounter, UR5State, check_plausible
from drivers.ur5.wire import UrController
from tests.simulated.bench import raises, wait_until
from timing import RigClock


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with a_rig() as rig:
        yield rig


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
