"""The jamming valve through pyserial, against the fake relay module.

With LAB_TEST_NUMATO_PORT=/dev/ttyACM0 (and LAB_TEST_NUMATO_RELAY) the tests that need no fault run against a real
module; those that switch the vacuum want LAB_TEST_ALLOW_MOTION=1 as well.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import timing
from drivers.errors import BadReply, DeviceFault, NoReply, Unreachable, WrongDevice
from drivers.numato.driver import Config, NumatoValve
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import Plant
from timing import RigClock

HARDWARE = os.environ.get("LAB_TEST_NUMATO_PORT")
RELAY = int(os.environ.get("LAB_TEST_NUMATO_RELAY", "0"))
Make = Callable[..., NumatoValve]


@pytest.fixture
def fake(plant: Plant) -> Iterator[NumatoFake]:
    if HARDWARE:
        pytest.skip("needs the fake module")
    fake = NumatoFake(plant, RigClock(), relays=16, valve=RELAY)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def make(request: pytest.FixtureRequest) -> Iterator[Make]:
    made: list[NumatoValve] = []

    def make(**changes: Any) -> NumatoValve:
        port = HARDWARE or request.getfixturevalue("fake").port
        made.append(NumatoValve("valve", Config(**{"port": port, "relay": RELAY, "timeout": 1.0} | changes), RigClock()))
        return made[-1]

    yield make
    for valve in made:
        valve.close()


@pytest.fixture
def may_switch() -> None:
    if HARDWARE and os.environ.get("LAB_TEST_ALLOW_MOTION") != "1":
        pytest.skip("switches the vacuum: set LAB_TEST_ALLOW_MOTION=1")


def test_switching_is_read_back(make: Make, may_switch: None) -> None:
    valve = make()
    valve.open()
    assert valve.set(True) is True
    assert valve.read().on is True
    assert valve.set(False) is False
    assert valve.read().on is False


def test_relays_above_nine_are_called_by_letters(make: Make, fake: NumatoFake) -> None:
    valve = make(relay=12)
    valve.open()
    valve.set(True)
    assert fake.coils[12]
    assert b"relay on C" in fake.requests


def test_open_leaves_the_relay_as_it_is(make: Make, fake: NumatoFake) -> None:
    fake.coils[RELAY] = True
    valve = make()
    valve.open()
    assert valve.read().on


def test_a_relay_that_does_not_follow_is_a_fault(make: Make, fake: NumatoFake) -> None:
    valve = make()
    valve.open()
    fake.faults.extra["stuck"] = True
    with pytest.raises(DeviceFault, match="switched on but reads back off"):
        valve.set(True)


def test_a_welded_contact_cannot_be_seen_in_the_read_back(make: Make, fake: NumatoFake, plant: Plant) -> None:
    valve = make()
    valve.open()
    valve.set(True)
    fake.faults.extra["welded"] = True
    assert valve.set(False) is False
    assert plant.valve_on


@pytest.mark.parametrize(("on_close", "jammed"), [("release", False), ("keep", True)])
def test_close_lands_as_configured_and_may_be_called_twice(
    make: Make, fake: NumatoFake, plant: Plant, on_close: str, jammed: bool
) -> None:
    valve = make(on_close=on_close)
    valve.open()
    valve.set(True)
    valve.close()
    valve.close()
    assert plant.valve_on is jammed


def test_close_never_raises(make: Make, fake: NumatoFake) -> None:
    valve = make()
    valve.close()
    valve.open()
    fake.stop()
    valve.close()


def test_half_a_command_of_an_earlier_program_does_no_harm(make: Make, fake: NumatoFake) -> None:
    fake.buffer = b"relay on"
    valve = make()
    valve.open()
    assert valve.read().on is False


def test_a_relay_that_the_module_does_not_have_is_reported_at_open(make: Make, fake: NumatoFake) -> None:
    with pytest.raises(WrongDevice, match="relay number|relay module"):
        make(relay=20).open()


def test_a_silent_module_is_unreachable_at_open_and_gives_no_reply_later(make: Make, fake: NumatoFake) -> None:
    valve = make()
    valve.open()
    fake.faults.silent = True
    with pytest.raises(NoReply):
        valve.read()
    with pytest.raises(Unreachable):
        make().open()


@pytest.mark.parametrize("fault", ["corrupt", "truncate"])
def test_damaged_answers_are_never_taken_for_a_state(make: Make, fake: NumatoFake, fault: str) -> None:
    valve = make()
    valve.open()
    setattr(fake.faults, fault, True)
    with pytest.raises((BadReply, NoReply)):
        valve.read()


def test_answers_in_two_pieces_are_put_together(make: Make, fake: NumatoFake) -> None:
    valve = make()
    valve.open()
    fake.faults.split = True
    assert valve.set(True) is True


def test_another_device_on_the_port_is_reported_quickly(plant: Plant) -> None:
    other = PfeifferFake(plant, RigClock())
    other.start()
    start = timing.now()
    with pytest.raises((Unreachable, WrongDevice)):
        NumatoValve("valve", Config(port=other.port), RigClock()).open()
    assert timing.now() - start < 20
    other.stop()
