"""Serial instruments, whatever the order of the calls: an illegal one raises its typed error and sends no byte.

For each driver a machine calls its methods in random order on a fake, keeping book of what must be allowed: nothing but
`open` and `close` before `open`, no motion before the zero is known, no value that is none.
"""

from __future__ import annotations

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
from drivers.numato import driver as numato
from drivers.pfeiffer import driver as pfeiffer
from drivers.smc_itv import driver as smc_itv
from drivers.tmcl import driver as tmcl
from sim_fakes.alicat import AlicatFake
from sim_fakes.dynamixel import DynamixelFake
from sim_fakes.ft300s import Ft300sFake
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import Plant
from sim_fakes.pty_fake import PtyFake
from sim_fakes.smc_itv import SmcItvFake
from sim_fakes.tmcl import TmclFake
from timing import RigClock

SPEED = 50.0
QUIET = 0.03
"""Host seconds in which a byte that was sent would have been heard."""
PATIENCE = 1.0
"""Host seconds that a fake on a busy computer may take for an answer."""
Call = Callable[[Any], Any]
ANY_CALL: dict[str, tuple[Call, ...]] = {
    "pressure": (lambda d: d.set((1e3,) * d.channels), lambda d: d.read(), lambda d: d.vent()),
    "spine": (lambda d: d.home(), lambda d: d.stop(), lambda d: d.read()),
    "valve": (lambda d: d.set(True), lambda d: d.set(False), lambda d: d.read()),
    "gauge": (lambda d: d.read(),),
    "force": (lambda d: d.latest(), lambda d: d.zero(2)),
}
"""Calls that are allowed on an open driver and only there."""
NEVER: dict[str, tuple[Call, ...]] = {
    "pressure": (
        lambda d: d.set((math.nan,) * d.channels), lambda d: d.set(()), lambda d: d.set((math.inf,) + (0.0,) * (d.channels - 1)),
    ),
    "spine": (
        lambda d: d.move_to(math.nan, 0.01), lambda d: d.move_to(0.1, 0.0), lambda d: d.move_to(0.1, -1.0),
        lambda d: d.move_to(0.1, math.inf),
    ),
    "valve": (), "gauge": (), "force": (lambda d: d.zero(0),),
}  # fmt: skip
"""Calls that are allowed in no state."""


ONE_SET: dict[str, Any] = {"timeout": PATIENCE, "full_scale": 500e3, "chambers": ((1, 2, 3),)}


def serial(kind: str, driver: Callable[[PtyFake, RigClock], Any], fake: Callable[[Plant, RigClock], PtyFake]) -> type:
    """The machine of a driver on a serial fake."""

    class Machine(RuleBasedStateMachine):
        def __init__(self) -> None:
            super().__init__()
            self.fake = fake(Plant(), RigClock(SPEED))
            self.fake.start()
            self.driver = driver(self.fake, RigClock(SPEED))
            self.opened = self.homed = False

        def teardown(self) -> None:
            self.driver.close()
            self.fake.stop()

        @rule()
        def open(self) -> None:
            self.driver.open()
            self.opened, self.homed = True, self.homed and self.opened

        @rule()
        def close(self) -> None:
            self.driver.close()
            self.opened = self.homed = False

        @precondition(lambda self: self.opened)
        @rule(call=st.sampled_from(ANY_CALL[kind]))
        def allowed(self, call: Call) -> None:
            with contextlib.suppress(DeviceFault):  # an allowed call may find something wrong
                call(self.driver)
            if kind == "spine":
                self.homed = False  # home and stop end what was known, and need time to find it again

        @precondition(lambda self: not self.opened)
        @rule(call=st.sampled_from(ANY_CALL[kind]))
        def closed(self, call: Call) -> None:
            self._refused(call, NotReady)

        @rule(call=st.sampled_from(NEVER[kind] or ANY_CALL[kind]))
        def never(self, call: Call) -> None:
            if NEVER[kind]:
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
            before = self.fake.heard
            with pytest.raises(kinds) as caught:
                call(self.driver)
            assert isinstance(caught.value, InstrumentError) and caught.value.instrument == "it"
            timing.sleep(QUIET)
            assert self.fake.heard == before

        @invariant()
        def alive(self) -> None:
            assert self.fake.is_alive()

    return Machine


MACHINES = {
    "alicat": serial("pressure", lambda f, c: alicat.Alicat("it", alicat.Config(port=f.port, timeout=PATIENCE), c), AlicatFake),
    "smc_itv": serial(
        "pressure",
        lambda f, c: smc_itv.SmcItv("it", smc_itv.Config(ports=(f.port,), **ONE_SET), c),
        lambda p, c: SmcItvFake(p, c, (1, 2, 3)),
    ),
    "dynamixel": serial(
        "spine",
        lambda f, c: dynamixel.DynamixelSpine("it", dynamixel.Config(port=f.port, timeout=1.0, metres_per_turn=0.1), c),
        DynamixelFake,
    ),
    "tmcl": serial(
        "spine",
        lambda f, c: tmcl.TmclSpine("it", tmcl.Config(port=f.port, timeout=PATIENCE, metres_per_turn=0.1), c),
        TmclFake,
    ),
    "numato": serial("valve", lambda f, c: numato.NumatoValve("it", numato.Config(port=f.port, timeout=PATIENCE), c), NumatoFake),
    "pfeiffer": serial(
        "gauge",
        lambda f, c: pfeiffer.PfeifferGauge("it", pfeiffer.Config(port=f.port, timeout=PATIENCE), c),
        PfeifferFake,
    ),
    "ft300s": serial(
        "force",
        lambda f, c: ft300s.FT300S("it", ft300s.Config(port=f.port, timeout=PATIENCE, max_age=1.0), c, lambda s: None),
        Ft300sFake,
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
