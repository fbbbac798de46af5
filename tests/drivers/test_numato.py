"""The jamming valve through pyserial, against the fake relay module."""

from collections.abc import Callable

import pytest

from drivers.errors import DeviceFault
from drivers.numato.driver import Config, NumatoValve
from sim_fakes.numato import NumatoFake
from sim_fakes.plant import Plant
from tests.simulated.bench import maker, raises, started_fake

Opened = Callable[..., NumatoValve]
fake = started_fake(NumatoFake, relays=16)
make = maker(NumatoValve, Config, "valve", relay=0, timeout=1.0)


def test_relays_above_nine_are_called_by_letters(opened: Opened, fake: NumatoFake) -> None:
    valve = opened(relay=12)
    valve.set(True)
    assert fake.coils[12]
    assert b"relay on C" in fake.requests


@pytest.mark.parametrize("on", [True, False])
def test_open_leaves_the_relay_as_it_is(opened: Opened, fake: NumatoFake, on: bool) -> None:
    fake.coils[0] = on
    valve = opened()
    assert valve.read().on is on


def test_a_relay_that_does_not_follow_is_a_fault(opened: Opened, fake: NumatoFake) -> None:
    valve = opened()
    fake.faults.extra["stuck"] = True
    raises(DeviceFault, "switched on but reads back off", valve.set, True)


def test_a_welded_contact_cannot_be_seen_in_the_read_back(opened: Opened, fake: NumatoFake, plant: Plant) -> None:
    valve = opened()
    valve.set(True)
    fake.faults.extra["welded"] = True
    assert valve.set(False) is False
    assert plant.valve_on


@pytest.mark.parametrize(("on_close", "jammed"), [("release", False), ("keep", True)])
def test_close_lands_as_configured_and_may_be_called_twice(
    opened: Opened, fake: NumatoFake, plant: Plant, on_close: str, jammed: bool
) -> None:
    valve = opened(on_close=on_close)
    valve.set(True)
    valve.close()
    valve.close()
    assert plant.valve_on is jammed


def test_half_a_command_of_an_earlier_program_does_no_harm(opened: Opened, fake: NumatoFake) -> None:
    fake.buffer = b"relay on"
    valve = opened()
    assert valve.read().on is False


def test_a_module_of_newer_firmware_is_one_too(opened: Opened, fake: NumatoFake) -> None:
    fake.version, fake.line_end = "A0M09.01", b"\r"
    valve = opened()
    assert valve.set(True) is True
