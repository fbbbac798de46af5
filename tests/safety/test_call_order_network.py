"""Instruments on the network, whatever the order of the calls: an illegal one raises its typed error and sends nothing.

Between calls an open arm hears the kicks of its watchdog, and an open motion capture its keep-alives; there the log of
commands must not grow. Where nothing is open, not one byte may arrive.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

import timing
from drivers.errors import DeviceFault, InstrumentError, LimitExceeded, NotReady
from drivers.natnet import driver as natnet_mocap
from drivers.natnet.config import Pose
from drivers.ur5 import driver as ur5
from drivers.ur5 import state as ur5_state
from sim_fakes.motive import MOCAP_TO_BASE, MotiveFake
from sim_fakes.plant import Plant
from sim_fakes.ur.process import UrProcess, free_host
from timing import RigClock

SPEED = 50.0
QUIET = 0.03
"""Host seconds in which a byte that was sent would have been heard."""
HERE = (0.4, 0.1, 0.5, 0.0, 1.57, 0.0)
Call = Callable[[Any], Any]
ARM_CALLS: tuple[Call, ...] = (lambda d: d.moving(), lambda d: d.stop(), lambda d: d.standing())
ARM_MOVES: tuple[Call, ...] = (
    lambda d: d.move_to(HERE, 0.05, 0.2), lambda d: d.move_to((0.4, 0.12, 0.5, 0.0, 1.57, 0.0), 0.05, 0.2),
)  # fmt: skip
ARM_NEVER: tuple[Call, ...] = (
    lambda d: d.move_to((math.nan,) * 6, 0.05, 0.2), lambda d: d.move_to((0.4, 0.1, 0.5), 0.05, 0.2),
    lambda d: d.move_to((0.4, 0.1, 5.0, 0.0, 0.0, 0.0), 0.05, 0.2), lambda d: d.move_to(HERE, 9.0, 0.2),
    lambda d: d.move_to(HERE, 0.05, -1.0), lambda d: d.move_to(HERE, math.inf, 0.2),
)  # fmt: skip


class Machine(RuleBasedStateMachine):
    """What all three have in common; `driver` is made and `marks` looks at the wire."""

    driver: Any

    def __init__(self) -> None:
        super().__init__()
        self.opened = False

    def marks(self) -> object:
        """What must not change by a refused call."""
        raise NotImplementedError

    def refused(self, call: Call, *kinds: type[InstrumentError]) -> None:
        """The call raises one of these errors, and the wire has heard nothing."""
        timing.sleep(QUIET)
        before = self.marks()
        with pytest.raises(kinds) as caught:
            call(self.driver)
        assert caught.value.instrument == "it"
        timing.sleep(QUIET)
        assert self.marks() == before

    def teardown(self) -> None:
        self.driver.close()

    @precondition(lambda self: not self.opened)
    @rule()
    def open(self) -> None:
        self.driver.open()
        self.opened = True

    @rule()
    def close(self) -> None:
        self.driver.close()
        self.opened = False


def arm_machine(ur: UrProcess) -> type[Machine]:
    """Of the arm's motion."""

    class ArmMachine(Machine):
        def __init__(self) -> None:
            super().__init__()
            self.driver = ur5.UR5("it", ur5.Config(host=ur.host), RigClock(SPEED))

        def marks(self) -> object:
            state = ur.backdoor()
            return state["commands"], None if self.opened else (state["heard"], state["connections"])

        @rule(call=st.sampled_from(ARM_NEVER))
        def never(self, call: Call) -> None:
            self.refused(call, LimitExceeded, NotReady)

        @precondition(lambda self: not self.opened)
        @rule(call=st.sampled_from(ARM_CALLS + ARM_MOVES))
        def closed(self, call: Call) -> None:
            self.refused(call, NotReady)

        @precondition(lambda self: self.opened)
        @rule()
        def open_twice(self) -> None:
            self.refused(lambda d: d.open(), NotReady)

        @precondition(lambda self: self.opened)
        @rule(call=st.sampled_from(ARM_CALLS + ARM_MOVES))
        def allowed(self, call: Call) -> None:
            with contextlib.suppress(DeviceFault, LimitExceeded, NotReady):  # too far from where it stands, or moving
                call(self.driver)

    return ArmMachine


def state_machine(ur: UrProcess) -> type[Machine]:
    """Of the stream of the arm's state."""

    class StateMachine(Machine):
        def __init__(self) -> None:
            super().__init__()
            config = ur5_state.Config(host=ur.host, max_age=1.0)
            self.driver = ur5_state.UR5State("it", config, RigClock(SPEED), lambda sample: None)

        def marks(self) -> object:
            state = ur.backdoor()
            return state["heard"], state["connections"]

        @precondition(lambda self: not self.opened)
        @rule()
        def closed(self) -> None:
            self.refused(lambda d: d.latest(), NotReady)

        @precondition(lambda self: self.opened)
        @rule()
        def allowed(self) -> None:
            assert len(self.driver.latest().tcp_pose) == 6

    return StateMachine


def mocap_machine(fake: MotiveFake) -> type[Machine]:
    """Of the motion capture."""

    class MocapMachine(Machine):
        def __init__(self) -> None:
            super().__init__()
            pose = Pose(position=MOCAP_TO_BASE[0], quaternion=MOCAP_TO_BASE[1])
            config = natnet_mocap.Config(server=fake.host, body="Tip", mocap_to_base=pose, max_age=1.0)
            self.driver = natnet_mocap.NatNetMocap("it", config, RigClock(), lambda sample: None)

        def marks(self) -> object:
            return list(fake.messages), fake.keep_alives

        @precondition(lambda self: not self.opened)
        @rule()
        def closed(self) -> None:
            self.refused(lambda d: d.latest(), NotReady)

        @precondition(lambda self: self.opened)
        @rule()
        def allowed(self) -> None:
            assert self.driver.latest().valid

    return MocapMachine


@pytest.fixture(scope="module")
def ur() -> Iterator[UrProcess]:
    process = UrProcess(speed=SPEED)
    yield process
    process.stop()


def in_any_order(machine: type[Machine], examples: int, steps: int) -> None:
    """Run it; the same orders each time."""
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples, stateful_step_count=steps, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )  # fmt: skip


def test_the_arm_in_any_order(ur: UrProcess) -> None:
    in_any_order(arm_machine(ur), 4, 10)


def test_the_arms_state_in_any_order(ur: UrProcess) -> None:
    in_any_order(state_machine(ur), 5, 8)


def test_motion_capture_in_any_order() -> None:
    fake = MotiveFake(Plant(), RigClock(1.0), free_host())
    fake.start()
    try:
        in_any_order(mocap_machine(fake), 10, 10)
    finally:
        fake.stop()
