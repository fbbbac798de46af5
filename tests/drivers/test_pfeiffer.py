"""The vacuum gauge through pfeiffer-vacuum-protocol, against the fake gauge.

With LAB_TEST_PFEIFFER_PORT=/dev/ttyUSB0 (and LAB_TEST_PFEIFFER_ADDRESS) the tests that need no fault run against a real
gauge.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pydantic import ValidationError

import timing
from drivers.errors import BadReply, DeviceFault, NoReply, Unreachable, WrongDevice
from drivers.pfeiffer.driver import HEALTH_EVERY, Config, PfeifferGauge
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import AMBIENT, Plant
from timing import RigClock

HARDWARE = os.environ.get("LAB_TEST_PFEIFFER_PORT")
ADDRESS = int(os.environ.get("LAB_TEST_PFEIFFER_ADDRESS", "1"))
Make = Callable[..., PfeifferGauge]


@pytest.fixture
def fake(plant: Plant) -> Iterator[PfeifferFake]:
    if HARDWARE:
        pytest.skip("needs the fake gauge")
    fake = PfeifferFake(plant, RigClock(20.0), address=ADDRESS, seed=4)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def make(request: pytest.FixtureRequest) -> Iterator[Make]:
    made: list[PfeifferGauge] = []

    def make(**changes: Any) -> PfeifferGauge:
        port = HARDWARE or request.getfixturevalue("fake").port
        values: dict[str, Any] = {"port": port, "address": ADDRESS, "timeout": 0.5} | changes
        made.append(PfeifferGauge("gauge", Config(**values), RigClock(20.0)))
        return made[-1]

    yield make
    for gauge in made:
        gauge.close()


def settled() -> None:
    """Let the fake's cell see the plant once."""
    timing.sleep(0.05)


def test_an_open_gauge_reads_ambient_pressure(make: Make) -> None:
    gauge = make()
    gauge.open()
    assert gauge.read().absolute == pytest.approx(AMBIENT, rel=0.1)


@pytest.mark.parametrize("pascal", [101_325.0, 99_990.0, 20_340.0, 1_000.0, 123.4])
def test_readings_are_absolute_pascals(make: Make, fake: PfeifferFake, plant: Plant, pascal: float) -> None:
    fake.noise = 0.0
    plant.vacuum_absolute = pascal
    settled()
    gauge = make()
    gauge.open()
    assert gauge.read().absolute == pytest.approx(pascal, rel=5.1e-4)


@pytest.mark.parametrize("pascal", [200_000.0, 50.0])
def test_a_reading_that_cannot_be_true_is_a_fault(make: Make, fake: PfeifferFake, pascal: float) -> None:
    gauge = make()
    gauge.open()
    fake.faults.extra["value"] = pascal
    with pytest.raises(DeviceFault, match="outside of 100 to 120000 Pa"):
        gauge.read()


def test_a_defective_gauge_is_a_fault_at_open_and_while_reading(make: Make, fake: PfeifferFake) -> None:
    gauge = make()
    gauge.open()
    fake.faults.extra["error"] = "Err001"
    with pytest.raises(DeviceFault, match="defective transmitter"):
        for _ in range(HEALTH_EVERY + 1):
            gauge.read()
    gauge.close()
    with pytest.raises(DeviceFault, match="defective transmitter"):
        make().open()


def test_a_pirani_gauge_is_the_wrong_device(make: Make, fake: PfeifferFake) -> None:
    fake.kind = "    A3"
    with pytest.raises(WrongDevice, match="PPT 100"):
        make().open()


def test_an_address_that_nobody_has_is_unreachable(make: Make) -> None:
    with pytest.raises(Unreachable, match="address 77"):
        make(address=77).open()


def test_an_answer_from_another_address_is_not_taken(make: Make, fake: PfeifferFake) -> None:
    gauge = make()
    gauge.open()
    fake.faults.extra["wrong_address"] = True
    with pytest.raises(BadReply, match="pressure"):
        gauge.read()


@pytest.mark.parametrize("word", ["NO_DEF", "_RANGE", "_LOGIC"])
def test_a_refusal_is_a_bad_reply(make: Make, fake: PfeifferFake, word: str) -> None:
    gauge = make()
    gauge.open()
    fake.faults.extra["refuse"] = word
    with pytest.raises(BadReply, match=word):
        gauge.read()


@pytest.mark.parametrize("fault", ["corrupt", "truncate"])
def test_damaged_answers_are_never_taken_for_readings(make: Make, fake: PfeifferFake, fault: str) -> None:
    gauge = make()
    gauge.open()
    setattr(fake.faults, fault, True)
    with pytest.raises((BadReply, NoReply)):
        gauge.read()


def test_bytes_that_are_no_text_are_a_bad_reply(make: Make, fake: PfeifferFake) -> None:
    gauge = make()
    gauge.open()
    fake.faults.garbage = b"\xff\xfe"
    with pytest.raises(BadReply):
        gauge.read()


def test_an_answer_that_came_too_late_is_not_taken_for_another_question(make: Make, fake: PfeifferFake, plant: Plant) -> None:
    fake.noise = 0.0
    gauge = make()
    gauge.open()
    fake.faults.delay = 0.7
    with pytest.raises((NoReply, BadReply)):
        gauge.read()
    fake.faults.delay = 0.0
    plant.vacuum_absolute = 20e3
    timing.sleep(1.0)
    assert gauge.read().absolute == pytest.approx(20e3)


def test_a_silent_gauge_gives_no_reply(make: Make, fake: PfeifferFake) -> None:
    gauge = make()
    gauge.open()
    fake.faults.silent = True
    with pytest.raises(NoReply, match="no answer"):
        gauge.read()


def test_limits_the_wrong_way_round_are_a_configuration_error() -> None:
    with pytest.raises(ValidationError, match="lowest"):
        Config(port="x", lowest=2e4, highest=1e4)


def test_another_device_on_the_port_is_reported_quickly(plant: Plant) -> None:
    other = NumatoFake(plant, RigClock())
    other.start()
    start = timing.now()
    with pytest.raises((Unreachable, WrongDevice)):
        PfeifferGauge("gauge", Config(port=other.port), RigClock()).open()
    assert timing.now() - start < 3
    other.stop()


def test_a_correction_factor_that_multiplies_the_pressure_is_set_back(make: Make, fake: PfeifferFake) -> None:
    fake.correction = 420
    gauge = make()
    gauge.open()
    assert fake.correction == 100
    fake.correction = 50  # another program on the line, while it is open
    for _ in range(HEALTH_EVERY + 1):
        gauge.read()
    assert fake.correction == 100


def test_a_correction_factor_that_stays_is_refused_by_name(make: Make, fake: PfeifferFake) -> None:
    fake.correction = 420
    fake.faults.extra["keeps_correction"] = True
    with pytest.raises(WrongDevice, match=r"correction factor \(parameter 742\).*4\.2.*must be 1"):
        make().open()


def test_a_gauge_without_a_correction_factor_is_as_good(make: Make, fake: PfeifferFake) -> None:
    fake.correction = None
    gauge = make()
    gauge.open()
    assert gauge.read().absolute == pytest.approx(AMBIENT, rel=0.05)


def test_an_echoing_adapter_is_named_and_harmless(make: Make, fake: PfeifferFake) -> None:
    fake.faults.echo = True
    gauge = make()
    gauge.open()
    assert gauge.read().absolute == pytest.approx(AMBIENT, rel=0.05)
    (told,) = gauge.take_notices()
    assert "echo" in told and fake.port in told
