"""Instruments, whatever the order of the calls: an illegal one raises its typed error and sends no byte.

For each driver a machine calls its methods in random order on a fake, keeping book of what must be allowed: nothing but
`open` and `close` before `open`, no motion before the zero is known, no value that is none.
"""

import contextlib
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

import timing
from drivers.alicat import driver as alicat
from drivers.dynamixel import driver as dynamixel
from drivers.errors import DeviceFault, InstrumentError, LimitExceeded, NotReady
from drivers.ft300s import driver as ft300s
from drivers.natnet import driver as natnet
from drivers.numato import driver as numato
from drivers.pfeiffer import driver as pfeiffer
from drivers.smc_itv import driver as smc_itv
from drivers.tmcl import driver as tmcl
from drivers.ur5 import driver as ur5
from drivers.ur5.state import UR5State
from drivers.ur5.wire import UrController
from sim_fakes.alicat import AlicatFake
from sim_fakes.dynamixel import DynamixelFake
from sim_fakes.ft300s import Ft300sFake
from sim_fakes.motive import MOCAP_TO_BASE, MotiveFake
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import Plant
from sim_fakes.pty_fake import PtyFake
from sim_fakes.smc_itv import SmcItvFake
from sim_fakes.tmcl import TmclFake
from sim_fakes.ur.process import UrProcess, free_host
from timing import RigClock

SPEED = 50.0
QUIET = 0.03
"""Host seconds in which a byte that was sent would have been heard."""
HERE = (0.4, 0.1, 0.5, 0.0, 1.57, 0.0)
Call = Callable[[Any], Any]
ANY_CALL: dict[str, tuple[Call, ...]] = {
    "pressure": (lambda d: d.set((1e3,) * d.channels), lambda d: d.read(), lambda d: d.vent()),
    "spine": (lambda d: d.home(), lambda d: d.stop(), lambda d: d.read()),
    "valve": (lambda d: d.set(True), lambda d: d.set(False), lambda d: d.read()),
    "gauge": (lambda d: d.read(),),
    "force": (lambda d: d.latest(), lambda d: d.zero(2)),
    "stream": (lambda d: d.latest(),),
    "arm": (
        lambda d: d.moving(), lambda d: d.stop(), lambda d: d.standing(),
        lambda d: d.move_to(HERE, 0.05, 0.2), lambda d: d.move_to((0.4, 0.12, 0.5, 0.0, 1.57, 0.0), 0.05, 0.2),
    ),
}  # fmt: skip
"""Calls that are allowed on an open driver and only there."""
NEVER: dict[str, tuple[Call, ...]] = {
    "pressure": (
        lambda d: d.set((math.nan,) * d.channels), lambda d: d.set(()), lambda d: d.set((math.inf,) + (0.0,) * (d.channels - 1)),
    ),
    "spine": (
        lambda d: d.move_to(math.nan, 0.01), lambda d: d.move_to(0.1, 0.0), lambda d: d.move_to(0.1, -1.0),
        lambda d: d.move_to(0.1, math.inf),
    ),
    "force": (lambda d: d.zero(0),),
    "arm": (
        lambda d: d.move_to((math.nan,) * 6, 0.05, 0.2), lambda d: d.move_to((0.4, 0.1, 0.5), 0.05, 0.2),
        lambda d: d.move_to((0.4, 0.1, 5.0, 0.0, 0.0, 0.0), 0.05, 0.2), lambda d: d.move_to(HERE, 9.0, 0.2),
        lambda d: d.move_to(HERE, 0.05, -1.0), lambda d: d.move_to(HERE, math.inf, 0.2),
    ),
}  # fmt: skip
"""Calls that are allowed in no state."""


def arm_marks(fake: Any, opened: bool) -> object:
    """While it is open, the arm hears the kicks of its watchdog; the log of commands must not grow."""
    state = fake.backdoor()
    return state["commands"], None if opened else (state["heard"], state["connections"])


def machine(
    kind: str, driver: Call, fake: Callable[[], Any], marks: Callable[[Any, bool], object] = lambda fake, opened: fake.heard
) -> type:
    """The machine of a driver on its fake; `marks` is what a refused call must not change."""

    class Machine(RuleBasedStateMachine):
        def __init__(self) -> None:
            super().__init__()
            self.fake = fake()
            if not hasattr(self.fake, "backdoor"):  # an arm's controller begins by itself
                self.fake.start()
            self.driver = driver(self.fake)
            self.opened = self.homed = False

        def teardown(self) -> None:
            self.driver.close()
            self.fake.stop()

        @rule()
        def open(self) -> None:
            if kind == "arm" and self.opened:  # two programs must not command one arm
                self._refused(lambda d: d.open(), NotReady)
                return
            self.driver.open()
            self.opened, self.homed = True, self.homed and self.opened

        @rule()
        def close(self) -> None:
            self.driver.close()
            self.opened = self.homed = False

        @precondition(lambda self: self.opened)
        @rule(call=st.sampled_from(ANY_CALL[kind]))
        def allowed(self, call: Call) -> None:
            # an allowed call may find something wrong; an arm may move, or stand too far away
            with contextlib.suppress(DeviceFault, *((LimitExceeded, NotReady) if kind == "arm" else ())):
                call(self.driver)
            if kind == "spine":
                self.homed = False  # home and stop end what was known, and need time to find it again

        @precondition(lambda self: not self.opened)
        @rule(call=st.sampled_from(ANY_CALL[kind]))
        def closed(self, call: Call) -> None:
            self._refused(call, NotReady)

        @precondition(lambda self: kind in NEVER)
        @rule(call=st.sampled_from(NEVER.get(kind, (print,))))
        def never(self, call: Call) -> None:
            self._refused(call, (LimitExceeded, NotReady))

        @precondition(lambda self: kind == "spine" and not self.homed)
        @rule()
        def move_without_zero(self) -> None:
            homed = False
            if self.opened:
                with contextlib.suppress(DeviceFault):
                    homed = self.driver.read().homed
            if not homed:
                self._refused(lambda d: d.move_to(0.1, 0.01), NotReady)

        def _refused(self, call: Call, kinds: type[InstrumentError] | tuple[type[InstrumentError], ...]) -> None:
            timing.sleep(QUIET)
            before = marks(self.fake, self.opened)
            with pytest.raises(kinds) as caught:
                call(self.driver)
            assert isinstance(caught.value, InstrumentError) and caught.value.instrument == "it"
            timing.sleep(QUIET)
            assert marks(self.fake, self.opened) == before

        @invariant()
        def alive(self) -> None:
            assert not isinstance(self.fake, PtyFake) or self.fake.is_alive()

    return Machine


def on_a_line(kind: str, module: Any, make: str, fake: Callable[..., PtyFake], sink: bool = False, **table: Any) -> type:
    """The machine of a driver with one port."""

    def driver(line: PtyFake) -> Any:
        config = module.Config(
            **{"ports" if module is smc_itv else "port": (line.port,) if module is smc_itv else line.port} | table
        )
        return getattr(module, make)("it", config, RigClock(SPEED), *([lambda sample: None] if sink else []))

    return machine(kind, driver, lambda: fake(Plant(), RigClock(SPEED)))


def arm() -> Any:
    return timing.made(UrProcess, speed=SPEED)


def nobody(sample: object) -> None:
    """A sink."""


BASE = {"position": MOCAP_TO_BASE[0], "quaternion": MOCAP_TO_BASE[1]}
ONE_SET: dict[str, Any] = {"full_scale": 500e3, "chambers": ((1, 2, 3),)}
TURN = {"metres_per_turn": 0.1}
MACHINES = {
    "alicat": on_a_line("pressure", alicat, "Alicat", AlicatFake, timeout=1.0),
    "smc_itv": on_a_line("pressure", smc_itv, "SmcItv", lambda p, c: SmcItvFake(p, c, (1, 2, 3)), timeout=1.0, **ONE_SET),
    "dynamixel": on_a_line("spine", dynamixel, "DynamixelSpine", DynamixelFake, timeout=1.0, **TURN),
    "tmcl": on_a_line("spine", tmcl, "TmclSpine", TmclFake, timeout=1.0, **TURN),
    "numato": on_a_line("valve", numato, "NumatoValve", NumatoFake, timeout=1.0),
    "pfeiffer": on_a_line("gauge", pfeiffer, "PfeifferGauge", PfeifferFake, timeout=1.0),
    "ft300s": on_a_line("force", ft300s, "FT300S", Ft300sFake, sink=True, timeout=1.0, max_age=1.0),
    "ur5": machine("arm", lambda f: ur5.UR5("it", ur5.Config(host=f.host), RigClock(SPEED)), arm, arm_marks),
    "ur5 state": machine(
        "stream", lambda f: UR5State(UrController("it", f.host, 1.0), RigClock(SPEED), nobody, max_age=1.0), arm, arm_marks
    ),
    "natnet": machine(
        "stream",
        lambda f: natnet.NatNetMocap(
            "it", natnet.Config(server=f.host, body="Tip", mocap_to_base=BASE, max_age=1.0), RigClock(), nobody
        ),
        lambda: MotiveFake(Plant(), RigClock(1.0), free_host()),
        lambda fake, opened: (list(fake.messages), fake.keep_alives),
    ),
}


@pytest.mark.parametrize("name", MACHINES)
def test_calls_in_any_order(name: str) -> None:
    run_state_machine_as_test(
        MACHINES[name],
        settings=settings(
            max_examples=10, stateful_step_count=12, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )  # fmt: skip
