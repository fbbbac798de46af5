"""The Alicat driver through pyserial: venting, set-points, readings, and what its units keep or a person changes at a panel."""

from collections.abc import Callable
from typing import Any

import pytest
import serial

import timing
from drivers.alicat.driver import Alicat, Config
from drivers.errors import BadReply, DeviceFault, InstrumentError, NoReply, StaleReading, Unreachable, WrongDevice
from sim_fakes.alicat import PA_PER_UNIT, AlicatFake
from sim_fakes.ft300s import Ft300sFake
from sim_fakes.plant import Plant
from tests.simulated.bench import Bench, maker, raises, started_fake

Make = Callable[..., Alicat]
FAR = 15e3
"""Pa above the pressures of these tests; a set-point read in another unit of measure is further up."""
fake = started_fake(AlicatFake, seed=2)
make = maker(Alicat, Config, "pressure", chambers=((1,), (2,), (3,)), timeout=1.0, max_age=5.0)


@pytest.fixture
def regulators(opened: Make) -> Alicat:
    return opened()


def hold(regulators: Alicat, plant: Plant, pressure: float) -> None:
    """Ramp all channels to a pressure (Pa) that the chambers then have."""
    for step in range(1, 11):
        regulators._limits.start_from([pressure * step / 10] * 3)
        regulators.set((pressure * step / 10,) * 3)
        plant.chamber_pressure[:] = pressure * step / 10
        regulators.read()


def setpoints(fake: AlicatFake) -> list[float]:
    return [unit.setpoint for unit in fake.device.values()]


def test_opening_tells_the_serial_numbers_of_the_units_in_their_order(make: Make) -> None:
    identity = make().open()
    assert "PC" in identity.model and "v" in identity.firmware
    assert [part.split(":")[0] for part in identity.serial.split(", ")] == ["A", "B", "C"]


# -- set-points
def test_what_is_above_the_limit_is_clipped_and_never_sent(bench: Bench, opened: Make, fake: AlicatFake) -> None:
    regulators = opened(max_pressure=20_004.0)
    confirmed = [regulators.set((1e6, -5e3, 20e3)) for _ in range(20) if bench.clock.sleep(0.2) is None][-1]
    assert confirmed == (20e3, 0.0, 20e3)
    sent = [float(request[2:]) for request in fake.requests if request[1:3] == b"S "]
    assert max(sent) == 20.0 and min(sent) == 0.0


def test_a_unit_that_ignores_set_points_is_a_fault_naming_both_values(bench: Bench, regulators: Alicat, fake: AlicatFake) -> None:
    fake.faults.extra["ignore"] = "B"
    bench.clock.sleep(1.0)
    raises(DeviceFault, "unit B was set to 12.00 kPa but holds 0.00 kPa.*serial", regulators.set, (5e3, 12e3, 5e3))


def test_a_unit_that_clamps_a_set_point_is_a_bad_reply_naming_both_values(
    bench: Bench, regulators: Alicat, fake: AlicatFake
) -> None:
    fake.device["B"].full_scale = 10e3
    bench.clock.sleep(1.0)
    raises(BadReply, "unit B was set to 12.00 kPa but holds 10.00 kPa", regulators.set, (5e3, 12e3, 5e3))


# -- venting
def test_venting_is_not_held_back_by_the_rate_limit(opened: Make, plant: Plant) -> None:
    regulators = opened(max_rate=5e3)
    hold(regulators, plant, 10e3)
    regulators.vent()
    assert regulators.read().setpoint == (0.0,) * 3


def test_a_dead_unit_keeps_no_other_from_venting_and_is_named_and_closing_is_quiet_about_it(
    regulators: Alicat, fake: AlicatFake, plant: Plant
) -> None:
    for land in (regulators.vent, regulators.close):
        hold(regulators, plant, 20e3)
        fake.faults.extra["dead"] = "A"
        if land == regulators.vent:
            raises(InstrumentError, "did not vent A: .*by hand", land)
        else:
            land()
        assert setpoints(fake) == [20e3, 0.0, 0.0]
        fake.faults.extra.clear()


@pytest.mark.parametrize(
    "spoil", [lambda fake: fake.faults.extra.update(miss={"B": 1}), lambda fake: fake.device["C"].hold("HP")]
)
def test_a_unit_that_fails_once_or_whose_valve_is_held_is_vented(
    regulators: Alicat, fake: AlicatFake, plant: Plant, spoil: Callable[[AlicatFake], None]
) -> None:
    hold(regulators, plant, 20e3)
    spoil(fake)
    regulators.vent()
    assert setpoints(fake) == [0.0] * 3 and plant.regulator.tolist() == [0.0] * 9


def test_a_stop_does_not_wait_for_a_reading_that_waits_for_a_dead_unit(opened: Make, fake: AlicatFake) -> None:
    regulators = opened(timeout=2.0)
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


# -- readings
@pytest.mark.parametrize("code", ["ADC", "EXH", "HLD", "MOV", "OPL", "OVR", "POV"])
def test_status_codes_that_matter_are_faults_when_reading(regulators: Alicat, fake: AlicatFake, code: str) -> None:
    fake.device["A"].locked = True  # which is no fault
    assert len(regulators.read().measured) == 3
    fake.faults.extra["status"] = {"B": code}
    raises(DeviceFault, f"unit B reports {code}", regulators.read)


@pytest.mark.parametrize(
    ("fault", "errors", "message"),
    [
        ({"extra": {"dead": "B"}}, NoReply, "unit B"),
        ({"extra": {"refuse": "B"}}, BadReply, "unit B"),
        ({"extra": {"swap": "B"}}, BadReply, "unit B"),
        ({"garbage": b"\xfe\x01"}, BadReply, "expected an answer"),
    ],
    ids=str,
)
def test_an_answer_that_is_none_is_no_reading_and_names_its_unit(
    regulators: Alicat, fake: AlicatFake, fault: dict[str, Any], errors: type[Exception], message: str
) -> None:
    sound = fake.faults
    fake.faults = type(sound)(**fault)
    raises(errors, message, regulators.read)
    fake.faults = sound
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
    assert regulators._line.quality.repeats == 1


def test_a_sweep_that_takes_too_long_is_stale(opened: Make, fake: AlicatFake) -> None:
    regulators = opened(max_age=0.05)
    fake.faults.delay = 0.06
    raises(StaleReading, "limit 0.05 s", regulators.read)


def test_retries_are_told_when_they_have_become_the_rule(opened: Make, fake: AlicatFake) -> None:
    regulators = opened(timeout=0.1)
    regulators.take_notices()
    for times, told in ((3, 0), (15, 1)):
        for _ in range(times):
            fake.faults.extra["miss"] = {"A": 1}
            regulators.read()
        notices = regulators.take_notices()
        assert len(notices) == told and all("had to be repeated" in n and "check cable" in n for n in notices)


@pytest.mark.parametrize("tail", ["\0", "\n", "\0\0\n", " \t"])
def test_what_a_breakout_box_puts_behind_a_line_costs_no_retry(opened: Make, fake: AlicatFake, tail: str) -> None:
    fake.faults.extra["tail"] = tail
    regulators = opened()
    for _ in range(20):
        regulators.read()
    regulators.set((100.0,) * 3)
    assert regulators._line.quality.repeats == 0


# -- who answers
def test_missing_units_are_all_named_with_those_that_answered(make: Make, fake: AlicatFake) -> None:
    fake.faults.extra["dead"] = "AC"
    raises(Unreachable, r"no answer from unit A, C .*answered: B\)", make().open)


@pytest.mark.parametrize("start", ["B@ @", "B@=@"])
def test_a_unit_that_streams_is_named_with_what_stops_it(opened: Make, fake: AlicatFake, start: str) -> None:
    with serial.serial_for_url(fake.port, 115200) as port:
        port.write(start.encode() + b"\r")
        assert port.read_until(b"\r")
    raises(WrongDevice, "without being asked: a unit in streaming mode .stop it with `@@", opened)
    with serial.serial_for_url(fake.port, 115200, timeout=0.5) as port:
        port.write(b"@@ B\r")
        while port.read(1):
            pass
    assert len(opened().read().measured) == 3


def test_a_force_sensor_that_streams_on_the_port_is_told_at_opening(bench: Bench, make: Make) -> None:
    sensor = bench.started(Ft300sFake(bench.plant, bench.clock))
    sensor.device.streaming = True
    start = timing.now()
    raises(WrongDevice, "check p.*baud rate", make(port=sensor.port, baud=19200).open)
    assert timing.now() - start < 20.0


# -- units that do not tell their unit of measure
OLD = "5v12.0-R22"


@pytest.fixture
def old(bench: Bench) -> Callable[[str], AlicatFake]:
    """Units of an old firmware, which answer in their unit of measure without naming it."""
    return lambda unit: bench.started(AlicatFake(bench.plant, bench.clock, seed=3, full_scale=413.7e3, firmware=OLD, unit=unit))


@pytest.mark.parametrize("firmware", [OLD, "7v09.0-R22", "9v04.0-R23", "10v04.0-R24"])
def test_older_firmware_is_never_asked_what_it_does_not_know(make: Make, fake: AlicatFake, firmware: str) -> None:
    for unit in fake.device.values():
        unit.firmware = firmware
    regulators = make(unit="kPa")
    assert regulators.open().firmware == firmware
    assert not [r for r in fake.requests if r[1:3] == b"LS" or r[1:4] in (b"LCZ", b"ZCA", b"ZCP")]
    assert regulators.read().setpoint == (0.0, 0.0, 0.0)


def test_a_unit_that_does_not_tell_its_unit_of_measure_needs_it_in_rig_yaml(make: Make, old: Callable[[str], AlicatFake]) -> None:
    with pytest.raises(WrongDevice, match=r"firmware 5v12.*write what its display shows.*pressure.unit: one of .*psi"):
        make(port=old("psi").port).open()


@pytest.mark.parametrize("unit", ["psi", "bar", "kPa"])
def test_a_unit_that_shows_another_unit_of_measure_is_read_and_set_in_pascal(
    bench: Bench, opened: Make, old: Callable[[str], AlicatFake], unit: str
) -> None:
    fake = old(unit)
    regulators = opened(port=fake.port, unit=unit, full_scale=413.7e3)
    digit = PA_PER_UNIT[fake.device["A"].unit_code] / 100
    for _ in range(200):
        if max(abs(p - 30e3) for p in regulators.set((30e3,) * 3)) <= digit:
            break
        bench.clock.sleep(0.2)
    assert setpoints(fake) == pytest.approx([30e3] * 3, abs=digit)
    assert regulators.read().setpoint == pytest.approx((30e3,) * 3, abs=digit)


@pytest.mark.parametrize(
    ("shows", "told", "full_scale"),
    [("psi", "kPa", 413.7e3), ("kPa", "psi", 413.7e3), ("psi", "bar", 413.7e3), ("bar", "mbar", 413.7e3),
     ("kPa", "Pa", 413.7e3), ("kPa", "kPa", 50e3), ("kPa", "kPa", 2e6)],
)  # fmt: skip
def test_a_wrong_unit_of_measure_or_range_is_caught_before_the_first_pressure_beyond_5_kpa(
    opened: Make, old: Callable[[str], AlicatFake], shows: str, told: str, full_scale: float
) -> None:
    fake = old(shows)
    regulators = opened(port=fake.port, unit=told, full_scale=full_scale, max_pressure=min(full_scale, 300e3))
    timing.sleep(0.1)  # no time, no rise: the rate is limited
    wrong = "its range is not" if shows == told else f"does not show {told} but {shows}.*correct unit or full_scale"
    raises(WrongDevice, wrong, regulators.set, (min(full_scale, 100e3), 0.0, 0.0))
    held, pa = [0.0], PA_PER_UNIT[fake.device["A"].unit_code]  # set-points of any unit, Pa, by what was sent
    for request in fake.requests:
        words = request.decode().strip()[1:]
        if words.startswith("S "):
            held.append(float(words[2:]) * pa)
        elif words.isdigit():
            held.append(int(words) / 64000 * fake.device["A"].full_scale)
    assert max(held) <= 5e3 and fake.device["A"].setpoint == 0
    regulators.vent()


def test_a_unit_that_tells_its_unit_of_measure_is_believed_before_rig_yaml(make: Make, opened: Make, fake: AlicatFake) -> None:
    for unit in fake.device.values():
        unit.unit_code, unit.full_scale = 10, 60 * PA_PER_UNIT[10]
    raises(WrongDevice, "shows PSI.*set its pressure unit to kPa, or write in rig.yaml which `unit`", make().open)
    opened(unit="psi", full_scale=60 * PA_PER_UNIT[10])
    assert not any(request.strip()[1:].isdigit() for request in fake.requests)


@pytest.mark.parametrize("unit", ["psi", "bar"])
@pytest.mark.parametrize("moment", ["held", "vented"])
def test_a_unit_that_does_not_tell_is_tried_anew(bench: Bench, opened: Make, plant: Plant, unit: str, moment: str) -> None:
    fake = bench.started(AlicatFake(plant, bench.clock, seed=3, firmware=OLD))
    regulators = opened(port=fake.port, unit="kPa")
    hold(regulators, plant, 60e3)
    if moment == "vented":
        regulators.vent()
        plant.chamber_pressure[:] = 0.0
    fake.device["B"].locked = False
    fake.device["B"].panel("unit", unit)
    if moment == "vented":
        regulators.confirm_settings()
    with pytest.raises(WrongDevice, match=f"unit B .*does not show kPa but {unit}"):
        if moment == "held":
            regulators.read()
        regulators._limits.start_from([20e3] * 3)
        regulators.set((20e3,) * 3)
    assert fake.device["B"].setpoint <= 60e3
    regulators.vent()
    assert setpoints(fake) == [0.0] * 3


# -- persistent settings are set right at opening, or refused
@pytest.mark.parametrize(
    ("setting", "wrong", "right"),
    [("source", "S", "U"), ("ramp", 20e3, 0.0), ("zero_active", False, True), ("auto_tare", True, False),
     ("power_up_tare", True, False)],
)  # fmt: skip
def test_a_setting_with_one_right_value_is_written(
    opened: Make, fake: AlicatFake, setting: str, wrong: object, right: object
) -> None:
    setattr(fake.device["B"], setting, wrong)
    opened()
    assert getattr(fake.device["B"], setting) == right


@pytest.mark.parametrize(
    ("setting", "wrong", "told"),
    [
        ("ramp", 20e3, r"set-point ramp \(register SR\) was 20, is 20 and must be 0, because .*vent.*panel"),
        ("zero_active", False, r"\(register LCZA\) was 0, is 0 and must be 1.*keeps the pressure"),
        ("auto_tare", True, r"\(register ZCA\) was 1, is 1 and must be 0"),
        ("power_up_tare", True, r"\(register ZCP\) was 1, is 1 and must be 0"),
        ("model", "MC-500SCCM-D", "is a MC-500SCCM-D"),
        ("full_scale", 200e3, "full scale of 200 kPa, rig.yaml says 400 kPa"),
        ("loop", 34, "controls variable 34, not gauge pressure .38; register 122.; choose gauge pressure"),
        ("source", "A", "analog input; set its set-point source to serial .register LSS is A, U is needed."),
        ("unit_code", 7, r"shows bar \(code 7; register FPF 6\), kPa is needed \(code 4\); set its pressure unit to kPa"),
    ],
)  # fmt: skip
def test_a_unit_that_cannot_be_used_is_refused_with_register_values_and_remedy(
    opened: Make, fake: AlicatFake, setting: str, wrong: object, told: str
) -> None:
    fake.faults.extra["keep"] = "B"
    setattr(fake.device["B"], setting, wrong)
    raises(WrongDevice, f"unit B.*{told}", opened)


def test_a_unit_that_cannot_forget_its_set_point_is_noticed(opened: Make, fake: AlicatFake) -> None:
    fake.faults.extra["keep"] = "C"
    regulators = opened()
    (notice,) = regulators.take_notices()
    assert "unit C: set-point source (register LSS) is S and cannot be set to U" in notice
    regulators.confirm_settings()
    assert regulators.take_notices() == []


def test_after_a_loss_of_power_no_unit_drives_its_last_set_point(regulators: Alicat, fake: AlicatFake, plant: Plant) -> None:
    hold(regulators, plant, 60e3)
    for unit in fake.device.values():
        unit.restart()
    assert setpoints(fake) == [0.0] * 3


# -- the panel
def test_panels_are_locked_while_open_and_unlocked_at_the_end(regulators: Alicat, fake: AlicatFake) -> None:
    assert not any(unit.panel("unit", "psi") for unit in fake.device.values())
    regulators.close()
    assert all(unit.panel("unit", "kPa") for unit in fake.device.values())


@pytest.mark.parametrize("answer", ["?", ""], ids=["rejected", "ignored"])
def test_a_unit_that_does_not_lock_its_panel_is_used_with_a_warning(opened: Make, fake: AlicatFake, answer: str) -> None:
    fake.faults.extra["no_lock"] = {"B": answer}
    regulators = opened(timeout=0.1)
    (notice,) = regulators.take_notices()
    assert "unit B does not lock its front panel (command BL" in notice
    regulators.confirm_settings()
    regulators.set((1e3,) * 3)
    assert regulators.take_notices() == []
    assert fake.device["A"].locked and not fake.device["B"].locked


def test_a_panel_that_somebody_unlocks_is_checked_and_locked_again(regulators: Alicat, fake: AlicatFake) -> None:
    fake.device["B"].locked = False
    asked = len(fake.requests)
    regulators.read()
    assert b"BFPF 6\r" in list(fake.requests)[asked:]
    assert fake.device["B"].locked


@pytest.mark.parametrize("unit", ["psi", "bar", "mbar", "Pa", "MPa", "inH2O", "inHg", "torr", "atm", "hPa"])
def test_a_changed_unit_of_measure_is_refused_before_the_next_trial(
    regulators: Alicat, fake: AlicatFake, plant: Plant, unit: str
) -> None:
    hold(regulators, plant, 60e3)
    regulators.vent()
    plant.chamber_pressure[:] = 0.0
    device = fake.device["C"]
    device.panel("unlock")
    assert device.panel("unit", unit)
    raises(WrongDevice, f"(?i)unit C shows {unit} .*register FPF 6.*kPa is needed", regulators.confirm_settings)
    raises(WrongDevice, None, regulators.set, (20e3,) * 3)
    assert setpoints(fake) == [0.0] * 3
    assert device.panel("unit", "kPa")
    regulators.confirm_settings()
    regulators.set((1e3,) * 3)


@pytest.mark.parametrize("letter", ["A", "C"])
@pytest.mark.parametrize("unit", ["psi", "bar", "mbar", "Pa", "inH2O"])
def test_a_unit_of_measure_that_changes_while_inflated_is_met_at_the_next_reading(
    regulators: Alicat, fake: AlicatFake, plant: Plant, unit: str, letter: str
) -> None:
    hold(regulators, plant, 60e3)
    fake.device[letter].locked = False
    fake.device[letter].panel("unit", unit)
    raises(WrongDevice, f"(?i)unit {letter} shows {unit}", regulators.read)
    assert regulators.read().measured == pytest.approx((60e3,) * 3, abs=1e3), "readings are in Pa whatever it shows"


@pytest.mark.parametrize("pressure", [1e3, 30e3, 60e3])
@pytest.mark.parametrize("unit", ["psi", "bar", "inH2O", "Pa"])
def test_a_unit_of_measure_that_changes_between_reading_and_set_point_lets_nothing_through(
    regulators: Alicat, fake: AlicatFake, plant: Plant, unit: str, pressure: float
) -> None:
    hold(regulators, plant, pressure)
    device = fake.device["A"]
    device.panel("unlock")
    assert device.panel("unit", unit)
    raises(WrongDevice, "unit A shows", regulators.set, (pressure + 1e3,) * 3)
    assert device.setpoint < pressure + FAR


@pytest.mark.parametrize("unit", ["bar", "psi", "MPa"])
def test_a_vent_is_not_confirmed_by_a_reading_in_another_unit_of_measure(
    regulators: Alicat, fake: AlicatFake, plant: Plant, unit: str
) -> None:
    """300 kPa shown as 3.00 bar would pass for vented."""
    hold(regulators, plant, 30e3)
    fake.device["B"].locked = False
    fake.device["B"].panel("unit", unit)
    regulators.vent()
    assert regulators.read().measured[1] == pytest.approx(30e3, abs=6e3)
    plant.chamber_pressure[:] = 0.0
    assert regulators.read().measured[1] == pytest.approx(0.0, abs=6e3)
