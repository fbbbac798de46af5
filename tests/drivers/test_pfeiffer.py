"""The vacuum gauge through pfeiffer-vacuum-protocol, against the fake gauge."""

from collections.abc import Callable

import pytest

import timing
from drivers.errors import BadReply, DeviceFault, NoReply, WrongDevice
from drivers.pfeiffer.driver import HEALTH_EVERY, Config, PfeifferGauge
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import AMBIENT, Plant
from tests.simulated.bench import maker, raises, started_fake

Opened = Callable[..., PfeifferGauge]
fake = started_fake(PfeifferFake, seed=4)
make = maker(PfeifferGauge, Config, "gauge", timeout=0.5)


@pytest.fixture
def gauge(opened: Opened) -> PfeifferGauge:
    return opened()


@pytest.mark.parametrize("pascal", [101_325.0, 99_999.0, 99_990.0, 20_340.0, 1_000.0, 123.4])
def test_readings_are_absolute_pascals(opened: Opened, fake: PfeifferFake, plant: Plant, pascal: float) -> None:
    fake.noise = 0.0
    plant.vacuum_absolute = pascal
    timing.sleep(0.05)  # the fake's cell sees the plant once
    assert opened().read().absolute == pytest.approx(pascal, rel=5.1e-4)


@pytest.mark.parametrize("pascal", [200_000.0, 50.0])
def test_a_reading_that_cannot_be_true_is_a_fault(gauge: PfeifferGauge, fake: PfeifferFake, pascal: float) -> None:
    fake.faults.extra["value"] = pascal
    raises(DeviceFault, "outside of 100 to 120000 Pa", gauge.read)


def test_a_defective_gauge_is_a_fault_at_open_and_while_reading(opened: Opened, fake: PfeifferFake) -> None:
    gauge = opened()
    fake.faults.extra["error"] = "Err001"
    with pytest.raises(DeviceFault, match="defective transmitter"):
        for _ in range(HEALTH_EVERY + 1):
            gauge.read()
    gauge.close()
    raises(DeviceFault, "defective transmitter", opened)


def test_a_gauge_that_warns_goes_on_measuring_and_says_so_once(opened: Opened, fake: PfeifferFake) -> None:
    fake.faults.extra["error"] = "Wrn007"
    gauge = opened()
    for _ in range(2 * HEALTH_EVERY):
        gauge.read()
    (notice,) = gauge.take_notices()
    assert "warns with Wrn007 (parameter 303)" in notice and "cable" not in notice


@pytest.mark.parametrize(
    ("spoil", "error", "says"),
    [
        *(
            (lambda fake, kind=kind: setattr(fake, "kind", kind), WrongDevice, says)
            for kind, says in (("    A3", "PPT 100"), *((odd, "gauge type") for odd in ("    B7", "UNKNOWN", "a+b(c")))
        ),
        (lambda fake: fake.faults.extra.update(error="Err044"), DeviceFault, "reports Err044"),
    ],
)
def test_what_is_answered_at_opening_with_a_right_checksum_is_no_fault_of_the_cable(
    opened: Opened, fake: PfeifferFake, spoil: Callable[[PfeifferFake], None], error: type[Exception], says: str
) -> None:
    spoil(fake)
    assert "cable" not in raises(error, says, opened)


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ({"wrong_address": True}, "its pressure, but address 2 answered"),
        *(({"refuse": word}, word) for word in ("NO_DEF", "_RANGE", "_LOGIC")),
    ],
)
def test_a_refusal_or_another_address_is_a_bad_reply(
    gauge: PfeifferGauge, fake: PfeifferFake, fault: dict[str, object], says: str
) -> None:
    fake.faults.extra.update(fault)
    assert "cable" not in raises(BadReply, says, gauge.read)


def test_a_refusal_is_no_fault_of_the_line(opened: Opened, fake: PfeifferFake) -> None:
    fake.correction = None
    gauge = opened()
    for _ in range(15 * HEALTH_EVERY):
        assert gauge.read().absolute == pytest.approx(AMBIENT, rel=0.05)
    assert gauge.take_notices() == []


def test_an_answer_that_came_too_late_is_not_taken_for_another_question(opened: Opened, fake: PfeifferFake, plant: Plant) -> None:
    fake.noise = 0.0
    gauge = opened()
    fake.faults.delay = 0.7
    raises((NoReply, BadReply), None, gauge.read)
    fake.faults.delay = 0.0
    plant.vacuum_absolute = 20e3
    timing.sleep(1.0)
    assert gauge.read().absolute == pytest.approx(20e3)


def test_a_correction_factor_that_multiplies_the_pressure_is_set_back(opened: Opened, fake: PfeifferFake) -> None:
    fake.correction = 420
    gauge = opened()
    assert fake.correction == 100
    fake.correction = 50  # another program on the line, while it is open
    for _ in range(HEALTH_EVERY + 1):
        gauge.read()
    assert fake.correction == 100


def test_a_correction_factor_that_stays_is_refused_by_name(opened: Opened, fake: PfeifferFake) -> None:
    fake.correction = 420
    fake.faults.extra["keeps_correction"] = True
    raises(WrongDevice, r"correction factor \(parameter 742\).*4\.2.*must be 1", opened)
