"""What an Alicat unit keeps without power, and what a person changes at its panel while the rig is open."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial

import timing
from drivers.alicat.driver import Alicat, Config
from drivers.errors import WrongDevice
from sim_fakes.alicat import AlicatFake
from sim_fakes.plant import Plant
from timing import RigClock

Open = Callable[..., Alicat]
FAR = 15e3
"""Pa above the pressures of these tests; a set-point read in another unit of measure is further up."""


@pytest.fixture
def fake(plant: Plant) -> Iterator[AlicatFake]:
    fake = AlicatFake(plant, RigClock(speed=20.0), seed=2)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def opened(fake: AlicatFake) -> Iterator[Open]:
    made: list[Alicat] = []

    def opened(**changes: Any) -> Alicat:
        values: dict[str, Any] = {"port": fake.port, "chambers": ((1,), (2,), (3,)), "timeout": 1.0, "max_age": 5.0}
        made.append(Alicat("pressure", Config(**(values | changes)), RigClock(speed=20.0)))
        made[-1].open()
        return made[-1]

    yield opened
    for regulators in made:
        regulators.close()


def hold(regulators: Alicat, plant: Plant, pressure: float) -> None:
    """Ramp all channels to a pressure (Pa) that the chambers then have."""
    for step in range(1, 11):
        regulators._limits.start_from([pressure * step / 10] * 3)
        regulators.set((pressure * step / 10,) * 3)
        plant.chamber_pressure[:] = pressure * step / 10
        regulators.read()


# -- persistent settings are set right at opening, or refused
@pytest.mark.parametrize(
    ("setting", "wrong", "right"),
    [
        ("source", "S", "U"), ("ramp", 20e3, 0.0), ("zero_active", False, True), ("auto_tare", True, False),
        ("power_up_tare", True, False),
    ],
)  # fmt: skip
def test_a_setting_with_one_right_value_is_written(
    opened: Open, fake: AlicatFake, setting: str, wrong: object, right: object
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
        ("loop", 34, "controls variable 34, not gauge pressure .38; register 122.; choose gauge pressure"),
        ("source", "A", "analog input; set its set-point source to serial .register LSS is A, U is needed."),
        ("unit_code", 7, r"shows bar \(code 7; register FPF 6\), kPa is needed \(code 4\); set its pressure unit to kPa"),
    ],
)  # fmt: skip
def test_a_setting_that_stays_wrong_is_refused_with_register_values_and_remedy(
    opened: Open, fake: AlicatFake, setting: str, wrong: object, told: str
) -> None:
    fake.faults.extra["keep"] = "B"
    setattr(fake.device["B"], setting, wrong)
    with pytest.raises(WrongDevice, match=f"unit B.*{told}"):
        opened()


def test_a_unit_that_cannot_forget_its_set_point_is_noticed(opened: Open, fake: AlicatFake) -> None:
    fake.faults.extra["keep"] = "C"
    regulators = opened()
    notices = regulators.take_notices()
    regulators.confirm_settings()
    assert regulators.take_notices() == []
    assert len(notices) == 1 and "unit C: set-point source (register LSS) is S and cannot be set to U" in notices[0]


def test_after_a_loss_of_power_no_unit_drives_its_last_set_point(opened: Open, fake: AlicatFake, plant: Plant) -> None:
    regulators = opened()
    hold(regulators, plant, 60e3)
    for unit in fake.device.values():
        unit.restart()
    assert [unit.setpoint for unit in fake.device.values()] == [0.0] * 3


# -- the panel
def test_panels_are_locked_while_open_and_unlocked_at_the_end(opened: Open, fake: AlicatFake) -> None:
    regulators = opened()
    assert not any(unit.panel("unit", "psi") for unit in fake.device.values())
    regulators.close()
    assert all(unit.panel("unit", "kPa") for unit in fake.device.values())


def test_a_panel_that_somebody_unlocks_is_checked_and_locked_again(opened: Open, fake: AlicatFake) -> None:
    regulators = opened()
    fake.device["B"].locked = False
    asked = len(fake.requests)
    regulators.read()
    assert b"BFPF 6\r" in list(fake.requests)[asked:]
    assert fake.device["B"].locked


@pytest.mark.parametrize("unit", ["psi", "bar", "mbar", "Pa", "MPa", "inH2O", "inHg", "torr", "atm", "hPa"])
@pytest.mark.parametrize("channel", [0, 2])
def test_a_changed_unit_of_measure_is_refused_before_the_next_trial(
    opened: Open, fake: AlicatFake, plant: Plant, unit: str, channel: int
) -> None:
    regulators = opened()
    hold(regulators, plant, 60e3)
    regulators.vent()
    plant.chamber_pressure[:] = 0.0
    device = fake.device["ABC"[channel]]
    device.panel("unlock")
    assert device.panel("unit", unit)
    with pytest.raises(WrongDevice, match=f"(?i)unit {'ABC'[channel]} shows {unit} .*register FPF 6.*kPa is needed"):
        regulators.confirm_settings()
    with pytest.raises(WrongDevice):
        regulators.set((20e3,) * 3)
    assert [u.setpoint for u in fake.device.values()] == [0.0] * 3
    assert device.panel("unit", "kPa")
    regulators.confirm_settings()
    regulators.set((1e3,) * 3)


@pytest.mark.parametrize("unit", ["psi", "bar", "mbar", "Pa", "inH2O"])
@pytest.mark.parametrize("letter", ["A", "C"])
def test_a_unit_of_measure_that_changes_while_inflated_is_met_at_the_next_reading(
    opened: Open, fake: AlicatFake, plant: Plant, unit: str, letter: str
) -> None:
    regulators = opened()
    hold(regulators, plant, 60e3)
    fake.device[letter].locked = False
    fake.device[letter].panel("unit", unit)
    with pytest.raises(WrongDevice, match=f"(?i)unit {letter} shows {unit}"):
        regulators.read()
    assert regulators.read().measured == pytest.approx((60e3,) * 3, abs=1e3), "readings are in Pa whatever it shows"


@pytest.mark.parametrize("pressure", [1e3, 30e3, 60e3])
@pytest.mark.parametrize("unit", ["psi", "bar", "inH2O", "Pa"])
def test_a_unit_of_measure_that_changes_between_reading_and_set_point_lets_nothing_through(
    opened: Open, fake: AlicatFake, plant: Plant, unit: str, pressure: float
) -> None:
    regulators = opened()
    hold(regulators, plant, pressure)
    device = fake.device["A"]
    device.panel("unlock")
    assert device.panel("unit", unit)
    with pytest.raises(WrongDevice, match="unit A shows"):
        regulators.set((pressure + 1e3,) * 3)
    assert device.setpoint < pressure + FAR


@pytest.mark.parametrize("unit", ["bar", "psi", "MPa"])
def test_a_vent_is_not_confirmed_by_a_reading_in_another_unit_of_measure(
    opened: Open, fake: AlicatFake, plant: Plant, unit: str
) -> None:
    """300 kPa shown as 3.00 bar would pass for vented."""
    regulators = opened()
    hold(regulators, plant, 30e3)
    fake.device["B"].locked = False
    fake.device["B"].panel("unit", unit)
    regulators.vent()
    assert regulators.read().measured[1] == pytest.approx(30e3, abs=6e3)
    plant.chamber_pressure[:] = 0.0
    assert regulators.read().measured[1] == pytest.approx(0.0, abs=6e3)


@pytest.mark.parametrize("unit", ["psi", "bar"])
@pytest.mark.parametrize("moment", ["held", "vented"])
def test_a_unit_that_does_not_tell_is_tried_anew(plant: Plant, unit: str, moment: str) -> None:
    fake = AlicatFake(plant, RigClock(speed=20.0), seed=3, firmware="5v12.0-R22")
    fake.start()
    config = Config(port=fake.port, unit="kPa", chambers=((1,), (2,), (3,)), timeout=1.0)
    regulators = Alicat("pressure", config, RigClock(speed=20.0))
    regulators.open()
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
    assert [u.setpoint for u in fake.device.values()] == [0.0] * 3
    regulators.close()
    fake.stop()


# -- the line between
@pytest.mark.parametrize("tail", ["\0", "\n", "\0\0\n", " \t"])
def test_what_a_breakout_box_puts_behind_a_line_costs_no_retry(opened: Open, fake: AlicatFake, tail: str) -> None:
    fake.faults.extra["tail"] = tail
    regulators = opened()
    for _ in range(20):
        regulators.read()
    regulators.set((100.0,) * 3)
    assert regulators._retries.total == 0


def test_an_echoing_adapter_is_named_and_harmless(opened: Open, fake: AlicatFake) -> None:
    fake.faults.echo = True
    regulators = opened()
    assert len(regulators.read().measured) == 3
    told = [text for text in regulators.take_notices() if "echo" in text]
    assert len(told) == 1 and fake.port in told[0]
    assert not any("echo" in text for text in regulators.take_notices())


@pytest.mark.parametrize("start", ["B@ @", "B@=@"])
def test_a_unit_that_streams_is_named_with_what_stops_it(opened: Open, fake: AlicatFake, start: str) -> None:
    with serial.serial_for_url(fake.port, 115200) as port:
        port.write(start.encode() + b"\r")
        assert port.read_until(b"\r")
    with pytest.raises(WrongDevice, match="without being asked: a unit in streaming mode .stop it with `@@"):
        opened()
    with serial.serial_for_url(fake.port, 115200, timeout=0.5) as port:
        port.write(b"@@ B\r")
        while port.read(1):
            pass
    assert len(opened().read().measured) == 3


def test_retries_are_told_when_they_have_become_the_rule(opened: Open, fake: AlicatFake) -> None:
    regulators = opened(timeout=0.1)
    regulators.take_notices()
    for _ in range(3):
        fake.faults.extra["miss"] = {"A": 1}
        regulators.read()
    assert regulators.take_notices() == []
    for _ in range(15):
        fake.faults.extra["miss"] = {"A": 1}
        regulators.read()
    told = regulators.take_notices()
    assert len(told) == 1 and "had to be repeated" in told[0] and "check cable" in told[0]


def test_settings_are_read_while_another_thread_polls(opened: Open) -> None:
    regulators = opened()
    ended = timing.Event()

    def poll() -> None:
        while not ended.is_set():
            regulators.read()

    polling = timing.Thread(target=poll, daemon=True)
    polling.start()
    for _ in range(5):
        regulators.confirm_settings()
    ended.set()
    polling.join(10.0)
    assert not polling.is_alive()
