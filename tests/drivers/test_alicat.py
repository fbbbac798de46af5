"""The Alicat driver through pyserial, against the fake units on a pty.

With LAB_TEST_ALICAT_PORT=/dev/ttyUSB0 (and LAB_TEST_ALICAT_UNITS=ABC, LAB_TEST_ALICAT_BAUD, LAB_TEST_ALICAT_FULL_SCALE
in Pa) the tests that need no fault run against real units. Those that pressurise, to 30 kPa at most, want
LAB_TEST_ALLOW_MOTION=1 as well.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pydantic import ValidationError

import timing
from drivers.alicat.driver import Alicat, Config
from drivers.errors import (
    BadReply,
    DeviceFault,
    InstrumentError,
    NoReply,
    StaleReading,
    Unreachable,
    WrongDevice,
)
from sim_fakes.alicat import PA_PER_UNIT, AlicatFake
from sim_fakes.ft300s import Ft300sFake
from sim_fakes.plant import Plant
from timing import RigClock

HARDWARE = os.environ.get("LAB_TEST_ALICAT_PORT")
UNITS = tuple(os.environ.get("LAB_TEST_ALICAT_UNITS", "ABC"))
BAUD: Any = int(os.environ.get("LAB_TEST_ALICAT_BAUD", "115200"))
FULL_SCALE = float(os.environ.get("LAB_TEST_ALICAT_FULL_SCALE", "400e3"))
DIGIT = 10.0
"""Last digit of the display, Pa."""


@pytest.fixture
def clock() -> RigClock:
    return RigClock(speed=1.0 if HARDWARE else 20.0)


@pytest.fixture
def fake(plant: Plant, clock: RigClock) -> Iterator[AlicatFake]:
    if HARDWARE:
        pytest.skip("needs the fake units")
    fake = AlicatFake(plant, clock, seed=2)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def make(request: pytest.FixtureRequest, clock: RigClock) -> Iterator[Callable[..., Alicat]]:
    made: list[Alicat] = []

    def make(**changes: Any) -> Alicat:
        port = HARDWARE or request.getfixturevalue("fake").port
        wiring = tuple((i + 1,) for i in range(len(UNITS)))
        values: dict[str, Any] = {
            "port": port, "baud": BAUD, "units": UNITS, "chambers": wiring, "full_scale": FULL_SCALE, "timeout": 1.0,
            "max_age": 5.0,
        }  # fmt: skip
        made.append(Alicat("pressure", Config(**(values | changes)), clock))
        return made[-1]

    yield make
    for regulators in made:
        regulators.close()


@pytest.fixture
def regulators(make: Callable[..., Alicat]) -> Alicat:
    regulators = make()
    regulators.open()
    return regulators


@pytest.fixture
def may_pressurise() -> None:
    if HARDWARE and os.environ.get("LAB_TEST_ALLOW_MOTION") != "1":
        pytest.skip("pressurises: set LAB_TEST_ALLOW_MOTION=1 when nobody is at the robot")


def raise_to(regulators: Alicat, clock: RigClock, pressures: tuple[float, ...]) -> tuple[float, ...]:
    """Set again and again, as a ramp does, until the rate limit lets the last value through."""
    for _ in range(200):
        confirmed = regulators.set(pressures)
        if max(abs(c - p) for c, p in zip(confirmed, pressures, strict=True)) <= DIGIT:
            return confirmed
        clock.sleep(0.2)
    raise AssertionError(f"{confirmed} did not come to {pressures}")


# -- these run on hardware too
def test_opening_tells_the_model_serial_number_and_firmware_of_the_units(make: Callable[..., Alicat]) -> None:
    identity = make().open()
    assert identity.maker == "Alicat"
    assert "PC" in identity.model
    assert [part.split(":")[0] for part in identity.serial.split(", ")] == list(UNITS)
    assert "v" in identity.firmware


def test_reading_gives_a_value_a_unit_near_ambient_when_vented(regulators: Alicat) -> None:
    regulators.vent()
    sample = regulators.read()
    assert sample.setpoint == (0.0,) * len(UNITS)
    assert len(sample.measured) == len(UNITS)
    assert max(map(abs, sample.measured)) < 2e3


@pytest.mark.usefixtures("may_pressurise")
def test_setting_returns_what_the_units_confirmed_and_reading_shows_it(regulators: Alicat, clock: RigClock) -> None:
    wanted = tuple(10e3 + 2e3 * i for i in range(len(UNITS)))
    assert raise_to(regulators, clock, wanted) == pytest.approx(wanted, abs=DIGIT)
    assert regulators.read().setpoint == pytest.approx(wanted, abs=DIGIT)


@pytest.mark.usefixtures("may_pressurise")
def test_venting_is_not_held_back_by_the_rate_limit(make: Callable[..., Alicat], clock: RigClock) -> None:
    regulators = make(max_rate=5e3)
    regulators.open()
    raise_to(regulators, clock, (10e3,) * len(UNITS))
    regulators.vent()
    assert regulators.read().setpoint == (0.0,) * len(UNITS)


@pytest.mark.usefixtures("may_pressurise")
def test_closing_leaves_the_units_vented_and_may_be_repeated(
    make: Callable[..., Alicat], regulators: Alicat, clock: RigClock
) -> None:
    raise_to(regulators, clock, (10e3,) * len(UNITS))
    regulators.close()
    regulators.close()
    again = make()
    again.open()
    assert again.read().setpoint == (0.0,) * len(UNITS)


# -- these need the fake


def test_nine_units_make_nine_channels(plant: Plant, clock: RigClock) -> None:
    nine = AlicatFake(plant, clock, "ABCDEFGHI", [(i,) for i in range(1, 10)])
    nine.start()
    config = Config(port=nine.port, units=tuple("ABCDEFGHI"), chambers=tuple((i,) for i in range(1, 10)))
    regulators = Alicat("pressure", config, clock)
    regulators.open()
    clock.sleep(1.0)
    wanted = tuple(1e3 * i for i in range(1, 10))
    assert regulators.set(wanted) == pytest.approx(wanted)
    assert plant.regulator.tolist() == pytest.approx(wanted)
    regulators.close()
    assert plant.regulator.tolist() == [0.0] * 9
    nine.stop()


def test_what_is_above_the_limit_is_clipped_and_never_sent(
    make: Callable[..., Alicat], fake: AlicatFake, clock: RigClock
) -> None:
    regulators = make(max_pressure=20_004.0)
    regulators.open()
    confirmed = [regulators.set((1e6, -5e3, 20e3)) for _ in range(20) if clock.sleep(0.2) is None][-1]
    assert confirmed == (20e3, 0.0, 20e3)
    sent = [float(request[2:]) for request in fake.requests if request[1:3] == b"S "]
    assert max(sent) == 20.0
    assert min(sent) == 0.0


def test_a_step_is_cut_to_the_rate_and_the_caller_sees_it(make: Callable[..., Alicat], fake: AlicatFake, plant: Plant) -> None:
    slow = Alicat("pressure", Config(port=fake.port, max_rate=10e3), stopped := StoppedClock())
    slow.open()
    stopped.time += 0.5
    assert slow.set((50e3, 1e3, 0.0)) == (5e3, 1e3, 0.0)
    assert plant.regulator.max() == 5e3
    stopped.time += 0.1
    assert slow.set((50e3, 1e3, 0.0)) == (6e3, 1e3, 0.0)
    slow.close()


class StoppedClock:
    """A clock that a test turns."""

    time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        self.time += duration


def test_a_dead_unit_does_not_keep_the_others_from_venting_and_is_named(
    regulators: Alicat, fake: AlicatFake, clock: RigClock
) -> None:
    raise_to(regulators, clock, (20e3, 20e3, 20e3))
    fake.faults.extra["dead"] = "A"
    with pytest.raises(InstrumentError, match="did not vent A: .*by hand"):
        regulators.vent()
    assert [fake.device[u].setpoint for u in "ABC"] == [20e3, 0.0, 0.0]


def test_a_stop_does_not_wait_for_a_reading_that_waits_for_a_dead_unit(make: Callable[..., Alicat], fake: AlicatFake) -> None:
    regulators = make(timeout=2.0)
    regulators.open()
    fake.faults.extra["dead"] = "A"
    ended: list[str] = []

    def poll() -> None:
        try:
            regulators.read()
        except InstrumentError as e:
            ended.append(str(e))

    heard = len(fake.requests)
    reading = timing.Thread(target=poll, daemon=True)
    reading.start()
    while len(fake.requests) == heard:
        timing.sleep(0.001)
    regulators.connect()
    reading.join(10.0)
    assert len(ended) == 1 and "cancelled by a stop" in ended[0]


def test_a_unit_that_fails_once_is_vented_in_the_second_round(regulators: Alicat, fake: AlicatFake, clock: RigClock) -> None:
    raise_to(regulators, clock, (20e3, 20e3, 20e3))
    fake.faults.extra["miss"] = {"B": 1}
    regulators.vent()
    assert fake.device["B"].setpoint == 0.0


def test_venting_lets_a_held_valve_go(regulators: Alicat, fake: AlicatFake, plant: Plant, clock: RigClock) -> None:
    raise_to(regulators, clock, (20e3, 20e3, 20e3))
    plant.chamber_pressure[:] = 20e3
    fake.device["C"].hold("HP")
    regulators.vent()
    assert plant.regulator.tolist() == [0.0] * 9


def test_closing_with_a_dead_unit_is_quiet_and_vents_the_others(regulators: Alicat, fake: AlicatFake, clock: RigClock) -> None:
    raise_to(regulators, clock, (20e3, 20e3, 20e3))
    fake.faults.extra["dead"] = "B"
    regulators.close()
    assert [fake.device[u].setpoint for u in "AC"] == [0.0, 0.0]


def test_a_unit_that_ignores_set_points_is_a_fault_naming_both_values(
    regulators: Alicat, fake: AlicatFake, clock: RigClock
) -> None:
    fake.faults.extra["ignore"] = "B"
    clock.sleep(1.0)
    with pytest.raises(DeviceFault, match="unit B was set to 12.00 kPa but holds 0.00 kPa.*serial"):
        regulators.set((5e3, 12e3, 5e3))


def test_a_unit_that_clamps_a_set_point_is_a_bad_reply_naming_both_values(
    regulators: Alicat, fake: AlicatFake, clock: RigClock
) -> None:
    fake.device["B"].full_scale = 10e3
    clock.sleep(1.0)
    with pytest.raises(BadReply, match="unit B was set to 12.00 kPa but holds 10.00 kPa"):
        regulators.set((5e3, 12e3, 5e3))


@pytest.mark.parametrize("code", ["ADC", "EXH", "HLD", "MOV", "OPL", "OVR", "POV"])
def test_status_codes_that_matter_are_faults_when_reading(regulators: Alicat, fake: AlicatFake, code: str) -> None:
    fake.faults.extra["status"] = {"B": code}
    with pytest.raises(DeviceFault, match=f"unit B reports {code}"):
        regulators.read()


def test_a_locked_display_is_no_fault(regulators: Alicat, fake: AlicatFake) -> None:
    fake.device["A"].locked = True
    assert len(regulators.read().measured) == 3


@pytest.mark.parametrize(
    ("fault", "error"),
    [({"dead": "B"}, NoReply), ({"refuse": "B"}, BadReply), ({"swap": "B"}, BadReply)],
)
def test_a_unit_that_does_not_answer_properly_is_named(
    regulators: Alicat, fake: AlicatFake, fault: dict[str, object], error: type[Exception]
) -> None:
    fake.faults.extra.update(fault)
    with pytest.raises(error, match="unit B"):
        regulators.read()


@pytest.mark.parametrize("fault", ["truncate", "silent"])
def test_a_disturbed_line_never_gives_a_reading(regulators: Alicat, fake: AlicatFake, fault: str) -> None:
    setattr(fake.faults, fault, True)
    with pytest.raises((BadReply, NoReply)):
        regulators.read()
    setattr(fake.faults, fault, False)
    assert len(regulators.read().measured) == 3


def test_a_single_lost_answer_is_made_good_by_asking_again(regulators: Alicat, fake: AlicatFake) -> None:
    fake.faults.extra["miss"] = {"A": 1, "C": 1}
    assert len(regulators.read().measured) == 3


@pytest.mark.parametrize("at", [2, 4, 6, 7, 10])
def test_an_answer_that_lost_a_digit_is_no_reading(fake: AlicatFake, regulators: Alicat, at: int) -> None:
    regulators.read()
    plain, left = fake._frame, [True]

    def short(letter: str, unit: Any) -> str:
        text = plain(letter, unit)
        return text[:at] + text[at + 1 :] if letter == "B" and left and left.pop() else text

    fake._frame = short  # type: ignore[method-assign]
    assert regulators.read().measured[1] == pytest.approx(0.0, abs=1e3)
    assert regulators._retries.total == 1


def test_garbage_in_front_of_an_answer_is_shown(regulators: Alicat, fake: AlicatFake) -> None:
    fake.faults.garbage = b"\xfe\x01"
    with pytest.raises(BadReply, match="expected an answer"):
        regulators.read()


def test_a_sweep_that_takes_too_long_is_stale(make: Callable[..., Alicat], fake: AlicatFake) -> None:
    regulators = make(max_age=0.05)
    regulators.open()
    fake.faults.delay = 0.06
    with pytest.raises(StaleReading, match="limit 0.05 s"):
        regulators.read()


# -- the wrong device
@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("model", "MC-500SCCM-D", "unit B is a MC-500SCCM-D"),
        ("loop", 34, "controls variable 34, not gauge pressure"),
        ("unit_code", 10, "shows PSI"),
        ("full_scale", 200e3, "full scale of 200 kPa, rig.yaml says 400 kPa"),
        ("source", "A", "its analog input; set its set-point source to serial"),
    ],
)
def test_a_unit_that_cannot_be_used_is_refused_naming_what_was_found(
    make: Callable[..., Alicat], fake: AlicatFake, attribute: str, value: object, message: str
) -> None:
    setattr(fake.device["B"], attribute, value)
    with pytest.raises(WrongDevice, match=message):
        make().open()


def test_missing_units_are_all_named_with_those_that_answered(make: Callable[..., Alicat], fake: AlicatFake) -> None:
    fake.faults.extra["dead"] = "AC"
    with pytest.raises(Unreachable, match=r"no answer from unit A, C .*answered: B\)"):
        make().open()


@pytest.mark.parametrize("firmware", ["5v12.0-R22", "7v09.0-R22", "9v04.0-R23", "10v04.0-R24"])
def test_older_firmware_is_never_asked_what_it_does_not_know(
    make: Callable[..., Alicat], fake: AlicatFake, firmware: str
) -> None:
    for unit in fake.device.values():
        unit.firmware = firmware
    regulators = make(unit="kPa")
    assert regulators.open().firmware == firmware
    unknown = [r for r in fake.requests if r[1:3] == b"LS" or r[1:4] in (b"LCZ", b"ZCA", b"ZCP")]
    assert not unknown
    assert regulators.read().setpoint == (0.0, 0.0, 0.0)


@pytest.fixture
def old(plant: Plant, clock: RigClock) -> Iterator[Callable[[str], AlicatFake]]:
    """Units of firmware 5v12, which answer in their unit of measure without naming it."""
    started: list[AlicatFake] = []

    def old(unit: str) -> AlicatFake:
        started.append(AlicatFake(plant, clock, seed=3, full_scale=413.7e3, firmware="5v12.0-R22", unit=unit))
        started[-1].start()
        return started[-1]

    yield old
    for fake in started:
        fake.stop()


def highest_told(fake: AlicatFake) -> float:
    """The highest set-point that any unit has held, Pa, by what was sent."""
    told = [0.0]
    pa = PA_PER_UNIT[fake.device["A"].unit_code]
    for request in fake.requests:
        words = request.decode().strip()[1:]
        if words.startswith("S "):
            told.append(float(words[2:]) * pa)
        elif words.isdigit():
            told.append(int(words) / 64000 * fake.device["A"].full_scale)
    return max(told)


def test_a_unit_that_does_not_tell_its_unit_of_measure_needs_it_in_rig_yaml(
    make: Callable[..., Alicat], old: Callable[[str], AlicatFake]
) -> None:
    with pytest.raises(WrongDevice, match=r"firmware 5v12.*write what its display shows.*pressure.unit: one of .*psi"):
        make(port=old("psi").port).open()


@pytest.mark.parametrize("unit", ["psi", "bar", "kPa"])
def test_a_unit_that_shows_another_unit_of_measure_is_read_and_set_in_pascal(
    make: Callable[..., Alicat], old: Callable[[str], AlicatFake], clock: RigClock, unit: str
) -> None:
    fake = old(unit)
    regulators = make(port=fake.port, unit=unit, full_scale=413.7e3)
    regulators.open()
    digit = PA_PER_UNIT[fake.device["A"].unit_code] / 100
    for _ in range(200):
        if max(abs(p - 30e3) for p in regulators.set((30e3,) * 3)) <= digit:
            break
        clock.sleep(0.2)
    assert [u.setpoint for u in fake.device.values()] == pytest.approx([30e3] * 3, abs=digit)
    assert regulators.read().setpoint == pytest.approx((30e3,) * 3, abs=digit)


@pytest.mark.parametrize(("shows", "told"), [("psi", "kPa"), ("kPa", "psi"), ("psi", "bar"), ("bar", "mbar"), ("kPa", "Pa")])
def test_a_wrong_unit_of_measure_is_caught_before_the_first_pressure_beyond_5_kpa(
    make: Callable[..., Alicat], old: Callable[[str], AlicatFake], shows: str, told: str
) -> None:
    fake = old(shows)
    regulators = make(port=fake.port, unit=told, full_scale=413.7e3)
    regulators.open()
    timing.sleep(0.1)  # no time, no rise: the rate is limited
    with pytest.raises(WrongDevice, match=f"does not show {told} but {shows}.*correct unit or full_scale"):
        regulators.set((100e3, 0.0, 0.0))
    assert highest_told(fake) <= 5e3 and fake.device["A"].setpoint == 0
    regulators.vent()


@pytest.mark.parametrize("said", [50e3, 2e6])
def test_a_range_far_from_the_unit_s_is_caught_too(
    make: Callable[..., Alicat], old: Callable[[str], AlicatFake], said: float
) -> None:
    fake = old("kPa")
    regulators = make(port=fake.port, unit="kPa", full_scale=said, max_pressure=min(said, 300e3))
    regulators.open()
    timing.sleep(0.1)  # no time, no rise: the rate is limited
    with pytest.raises(WrongDevice, match="its range is not"):
        regulators.set((20e3, 0.0, 0.0))
    assert highest_told(fake) <= 5e3


def test_a_unit_that_tells_its_unit_of_measure_is_believed_before_rig_yaml(make: Callable[..., Alicat], fake: AlicatFake) -> None:
    for unit in fake.device.values():
        unit.unit_code, unit.full_scale = 10, 60 * PA_PER_UNIT[10]
    with pytest.raises(WrongDevice, match="shows PSI.*set its pressure unit to kPa, or write in rig.yaml which `unit`"):
        make().open()
    regulators = make(unit="psi", full_scale=60 * PA_PER_UNIT[10])
    regulators.open()
    assert not any(request.strip()[1:].isdigit() for request in fake.requests)


@pytest.mark.parametrize("streaming", [False, True])
def test_a_force_sensor_on_the_port_is_told_at_opening(plant: Plant, clock: RigClock, streaming: bool) -> None:
    sensor = Ft300sFake(plant, clock)
    sensor.device.streaming = streaming
    sensor.start()
    regulators = Alicat("pressure", Config(port=sensor.port, baud=19200), clock)
    start = timing.now()
    with pytest.raises(WrongDevice if streaming else Unreachable, match="check p.*baud rate"):
        regulators.open()
    assert timing.now() - start < 20.0
    sensor.stop()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"units": ("A", "A", "B")}, "used once"),
        ({"units": ("A", "B")}, "2 units but 3 lists of chambers"),
        ({"units": ("A", "B", "c")}, "'c' must be one letter"),
        ({"max_pressure": 500e3}, "above the units' full_scale"),
        ({"chambers": ((1,), (1,), (2,))}, "chamber 1 is listed"),
        ({"baud": 4800}, "19200"),
        ({"prot": "x"}, "Extra inputs"),
    ],
)
def test_a_configuration_that_cannot_work_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        Config(**({"port": "/dev/ttyUSB0"} | changes))
