"""What every driver must do, tried on its fake: `pytest --pyargs lab.driver_contract`, the project's own drivers and those
of installed packages alike. `-k NAME` tries one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from drivers.errors import InstrumentError, LimitExceeded, Unreachable
from drivers.interfaces import Identity, PressureSample
from drivers.registry import drivers
from sim_fakes.clock import SimClock
from sim_fakes.instrument import Site
from sim_fakes.plant import Plant
from sim_fakes.pty_fake import Faults, PtyFake
from sim_fakes.registry import fakes, of_role

from .files.clock import RigClock

SPEED = 20.0
HOSES = ((9, 1, 2), (3, 4, 5), (6, 7, 8))
WITHIN = 30.0
"""Host seconds for what takes a fraction of one: a busy computer is no fault."""
ASKED = 20e3
"""Pa."""
CALLS: dict[str, tuple[Callable[[Any], Any], ...]] = {
    "pressure": (lambda d: d.read(), lambda d: d.set((0.0,) * d.channels), lambda d: d.vent()),
    "spine": (lambda d: d.read(), lambda d: d.home(), lambda d: d.stop(), lambda d: d.move_to(0.1, 0.01)),
    "valve": (lambda d: d.read(), lambda d: d.set(False)),
    "gauge": (lambda d: d.read(),),
    "force": (lambda d: d.latest(), lambda d: d.zero(1)),
}
"""What may be asked of each kind."""


@dataclass
class Unit:
    """A driver and the fake that it reaches."""

    role: str
    driver: Any
    lines: list[PtyFake]
    plant: Plant
    config: Any

    def another(self, **changes: Any) -> Any:
        """A driver of the same kind with another table in rig.yaml."""
        kind = drivers()[self.config.driver]
        config = kind.config.model_validate(self.config.model_dump() | changes)
        more = (lambda sample: None, lambda text: None) if self.role == "force" else ()
        return kind.make("it", config, RigClock(SPEED), *more)


def units(*roles: str) -> Any:
    """Every registered driver of these kinds that has a fake."""
    names = [name for name, fake in fakes().items() if fake.role in (roles or CALLS) and name in drivers()]
    return pytest.mark.parametrize("unit", names, indirect=True)


@pytest.fixture
def unit(request: pytest.FixtureRequest) -> Iterator[Unit]:
    """The driver of one name on its fake, not yet opened."""
    fake = fakes()[request.param]
    site = Site(Plant(), SimClock(SPEED), 1, HOSES, fake.full_scale)
    lines = list(fake.plug(site))
    for line in lines:
        line.start()
    table: dict[str, Any] = {"driver": request.param, **fake.table(site, lines)}
    if fake.role == "pressure":
        table |= {"chambers": HOSES, "full_scale": site.full_scale, "max_pressure": 2 * ASKED}
    kind = drivers()[request.param]
    if "timeout" in kind.config.model_fields:
        table["timeout"] = 0.5
    made = Unit(fake.role, None, lines, site.plant, kind.config.model_validate(table))
    made.driver = made.another()
    yield made
    made.driver.close()
    for line in lines:
        line.stop()


def until(condition: Callable[[], bool]) -> bool:
    """Look until the condition holds."""
    end = time.monotonic() + WITHIN
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


@units()
def test_it_says_who_it_is_and_takes_a_second_open(unit: Unit) -> None:
    for _ in range(2):
        identity = unit.driver.open()
        assert isinstance(identity, Identity) and identity.maker and identity.model


@units()
def test_closed_it_refuses_every_call_with_its_name(unit: Unit) -> None:
    for when in ("never opened", "closed again"):
        for call in CALLS[unit.role]:
            with pytest.raises(InstrumentError) as caught:
                call(unit.driver)
            assert caught.value.instrument == "it", when
        unit.driver.open()
        unit.driver.close()
        unit.driver.close()


@units()
def test_a_port_that_is_not_there_is_unreachable(unit: Unit) -> None:
    nowhere = [f"/dev/none{i}" for i in range(len(HOSES))]
    key, value = ("port", nowhere[0]) if hasattr(unit.config, "port") else ("ports", nowhere)
    with pytest.raises(Unreachable, match="/dev/none"):
        unit.another(**{key: value}).open()


@units()
@pytest.mark.parametrize("fault", ["silent", "corrupt", "truncate", "garbage"])
def test_a_disturbed_line_is_told_as_an_instrument_error_or_overcome(unit: Unit, fault: str) -> None:
    quick = unit.another(timeout=0.05) if hasattr(unit.config, "timeout") else unit.driver
    assert until(lambda: answers(quick.open))
    for line in unit.lines:
        setattr(line.faults, fault, b"\x00#\x7f!" if fault == "garbage" else True)
    for call in CALLS[unit.role]:
        try:
            call(quick)
        except InstrumentError as error:
            assert error.instrument == "it" and error.message
    for line in unit.lines:
        line.faults = Faults()
    quick.close()


def answers(call: Callable[[], Any]) -> bool:
    """Whether a call succeeds: on a busy computer a quick time-out may pass."""
    try:
        call()
    except InstrumentError:
        return False
    return True


@units("pressure")
def test_each_channel_fills_its_own_chambers_and_no_other(unit: Unit) -> None:
    unit.driver.open()
    for channel, chambers in enumerate(HOSES):
        asked = tuple(ASKED if c == channel else 0.0 for c in range(unit.driver.channels))
        assert until(lambda asked=asked: near(unit.driver.set(asked), asked))  # type: ignore[misc]
        regulator = [ASKED if number in chambers else 0.0 for number in range(1, 10)]
        assert until(lambda want=regulator: near(unit.plant.regulator, want))  # type: ignore[misc]
    sample = unit.driver.read()
    assert isinstance(sample, PressureSample)
    assert len(sample.setpoint) == len(sample.measured) == unit.driver.channels and near(sample.setpoint, asked)


@units("pressure")
def test_what_is_measured_is_the_plant_s_pressure(unit: Unit) -> None:
    unit.driver.open()
    truth = [1e3 * chamber for chamber in range(1, 10)]
    with unit.plant.lock:
        unit.plant.chamber_pressure[:] = truth
    wanted = [sum(truth[c - 1] for c in chambers) / len(chambers) for chambers in HOSES]
    assert until(lambda: near(unit.driver.read().measured, wanted))


@units("pressure")
def test_set_points_keep_range_and_rate(unit: Unit) -> None:
    unit.driver.open()
    assert until(lambda: near(unit.driver.set((1e9,) * unit.driver.channels), (2 * ASKED,) * unit.driver.channels))
    assert max(unit.driver.set((1e9,) * unit.driver.channels)) <= 2 * ASKED * (1 + 1e-9)
    slow = unit.another(max_rate=1.0)
    unit.driver.close()
    slow.open()
    try:
        assert max(slow.set((ASKED,) * slow.channels)) < ASKED / 2  # at 1 Pa/s it takes hours
        for wrong in ((math.nan,) * slow.channels, (math.inf,) * slow.channels, (0.0,) * (slow.channels + 1)):
            with pytest.raises(LimitExceeded):
                slow.set(wrong)
    finally:
        slow.close()


@units("pressure")
def test_vent_and_close_leave_nothing_inflated(unit: Unit) -> None:
    unit.driver.open()
    for end in (unit.driver.vent, unit.driver.close):
        asked = (ASKED,) * unit.driver.channels
        assert until(lambda asked=asked: near(unit.driver.set(asked), asked))  # type: ignore[misc]
        end()
        assert until(lambda: not unit.plant.regulator.any())


@units("pressure")
def test_connect_is_enough_to_vent(unit: Unit) -> None:
    unit.driver.open()
    asked = (ASKED,) * unit.driver.channels
    assert until(lambda: near(unit.driver.set(asked), asked))
    unit.lines[0].faults.silent = True  # so that closing cannot vent it
    unit.driver.close()
    unit.lines[0].faults = Faults()
    late = unit.another()
    late.connect()
    late.vent()
    assert until(lambda: not unit.plant.regulator.any())
    late.close()


def near(values: Any, wanted: Any) -> bool:
    """Equal within what a regulator's steps and noise are."""
    return all(abs(a - b) < 1.5e3 for a, b in zip(values, wanted, strict=True))


def test_every_registered_pressure_driver_is_tried() -> None:
    assert set(of_role("pressure")) >= {"alicat", "smc_itv"}
