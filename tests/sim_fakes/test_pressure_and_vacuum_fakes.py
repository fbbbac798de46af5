"""The fake Alicat units, relay module, gauge and ITV, asked what their drivers never ask: forms of a set-point, older firmware,
a person at the panel."""

import re
from collections.abc import Callable

import pytest
import serial

from sim_fakes.alicat import AlicatFake
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake, checksum
from sim_fakes.plant import Plant
from sim_fakes.smc_itv import SmcItvFake
from tests.simulated.bench import Bench, started_fake

Ask = Callable[..., str]
fake = started_fake(AlicatFake, seed=3)
itv_fake = started_fake(SmcItvFake, chambers=(4, 5), seed=3)


@pytest.fixture
def ask(bench: Bench, fake: AlicatFake) -> Ask:
    port = bench.closing(serial.serial_for_url(fake.port, 115200))

    def ask(words: str, within: float = 20.0) -> str:
        port.timeout = within
        port.reset_input_buffer()
        port.write(words.encode() + b"\r")
        return str(port.read_until(b"\r").decode().strip())

    return ask


def numbers(frame: str) -> list[float]:
    return [float(word) for word in frame.split()[1:3]]


@pytest.mark.parametrize("request_", ["AS50", "AS 50.00", "as 50", "A8000"])
def test_each_form_of_set_point_is_understood(ask: Ask, plant: Plant, request_: str) -> None:
    assert numbers(ask(request_))[1] == 50.0
    assert plant.regulator[[8, 0, 1]].tolist() == [50e3] * 3


@pytest.mark.parametrize("words", ["AS", "AS abc", "AS 5 kPa", "AXX", "AVE2", "A64001", "AFPF", "ALS abc"])
def test_what_is_not_exact_is_refused(ask: Ask, words: str) -> None:
    assert ask(words) == "?"


def test_an_unknown_letter_is_met_with_silence(ask: Ask) -> None:
    assert ask("Z", within=0.2) == ""


def test_a_request_before_the_last_answer_jams_the_line(fake: AlicatFake) -> None:
    with serial.serial_for_url(fake.port, 115200, timeout=20) as port:
        port.write(b"A\rB\r")
        assert port.read_until(b"\r").startswith(b"B ")
        port.timeout = 0.2
        assert port.read_until(b"\r") == b""


def test_readings_have_noise_and_the_displays_digits(ask: Ask, plant: Plant) -> None:
    plant.chamber_pressure[:] = 50e3
    readings = [numbers(ask("B"))[0] for _ in range(40)]
    assert 0.05 < max(readings) - min(readings) < 1.0
    assert sum(readings) / 40 == pytest.approx(50.0, abs=0.1)
    assert all(round(r, 2) == r for r in readings)


def test_the_set_point_command_needs_its_firmware(ask: Ask, fake: AlicatFake) -> None:
    assert ask("ALS 50") == "A +050.00 +050.00 04 kPa"
    fake.device["A"].firmware = "8v17.0-R23"
    assert ask("ALS 60") == "?"
    fake.device["A"].firmware = "7v09.0-R22"
    assert ask("ALS 60").endswith("LCK")
    assert fake.device["A"].setpoint == 50e3


def test_a_held_valve_keeps_the_pressure_and_says_so_until_it_is_cancelled(ask: Ask, plant: Plant) -> None:
    ask("AS 50")
    plant.chamber_pressure[:] = 20e3
    assert ask("AHP").endswith("HLD")
    assert plant.regulator[0] == 20e3
    assert not ask("AC").endswith("HLD")
    assert plant.regulator[0] == 50e3
    assert ask("AE").endswith("EXH")
    assert plant.regulator[0] == 0.0


def rows(fake: AlicatFake, words: str, count: int) -> list[str]:
    with serial.serial_for_url(fake.port, 115200, timeout=20) as port:
        port.write(words.encode() + b"\r")
        return [port.read_until(b"\r").decode().rstrip("\r") for _ in range(count)]


@pytest.mark.parametrize("firmware", ["6v21.0-R22", "8v17.0-R23", "10v20.0-R24"])
def test_the_frame_format_names_each_number_of_a_frame_with_its_unit(fake: AlicatFake, ask: Ask, firmware: str) -> None:
    fake.device["A"].firmware, fake.device["A"].unit_code = firmware, 10
    head, *table = rows(fake, "A??D*", 12)
    assert head.split() == ["A", "D00", "ID_", *head.split()[3:]] and head.split()[3].startswith("NAME_")
    found = [re.fullmatch(r"A D(\d\d) (\d{3}) (.{26}) (.{11}) (.*)", row) for row in table]
    fields = [match.groups() for match in found if match is not None]
    assert [int(f[0]) for f in fields] == list(range(1, 12))
    assert [(f[1], f[2].strip()) for f in fields[:3]] == [
        ("700", "Unit ID"), ("006", "Gauge Press"), ("038", "Gauge Press Setpt"),
    ]  # fmt: skip
    assert all(f[4].split()[-3:] == ["010", "02", "PSI"] for f in fields[1:3])
    assert {f[4].split()[-1] for f in fields[3:]} >= {"ADC", "POV", "HLD", "LCK"}
    assert len(ask("A").split()) == 3


def test_firmware_before_6v00_tells_its_frame_format_in_the_older_form(fake: AlicatFake) -> None:
    fake.device["A"].firmware = "5v12.0-R22"
    head, identity, pressure, setpoint, *_ = rows(fake, "A??D*", 12)
    assert head.split() == ["A", "D00", "NAME_______", "TYPE_____", "MinVal_", "MaxVal_", "UNITS__"]
    assert pressure.split() == ["A", "D02", "Pressure", "signed", "+000.00", "+400.00", "kPa"]
    assert setpoint.split()[2] == "SetPoint" and identity.endswith("na")


def test_the_oldest_firmware_wants_dollars_before_what_changes_something(fake: AlicatFake, ask: Ask) -> None:
    assert numbers(ask("A$$S 20"))[1] == 20.0
    fake.device["A"].firmware = "GP07R100"
    assert ask("AS 50") == "?"
    assert numbers(ask("A$$S 50"))[1] == 50.0
    assert numbers(ask("A"))[1] == 50.0
    assert ask("A$$R122") == "?" and ask("AR122") == "A   122 = 38"
    assert ask("A$$W122=34") == "A   122 = 34"


def test_settings_are_kept_without_power_and_the_set_point_as_its_source_says(fake: AlicatFake, ask: Ask) -> None:
    unit = fake.device["A"]
    for source, kept in (("S", 50e3), ("U", 0.0)):
        ask(f"ALSS {source}")
        ask("AS 50")
        unit.zero_active, unit.locked = False, True
        fake.restart()
        assert (unit.setpoint, unit.source, unit.zero_active, unit.locked) == (kept, source, False, False)


def test_a_ramp_of_its_own_slows_a_vent_and_a_passive_zero_keeps_the_pressure(fake: AlicatFake, ask: Ask, plant: Plant) -> None:
    ask("AS 50")
    assert ask("ASR 1 5").split()[1] == "0.0"
    ask("AS 0")
    assert plant.regulator[8] > 40e3
    assert ask("ASR 0 4").split()[1] == "0.0"
    ask("AS 0")
    assert plant.regulator[8] == 0.0
    ask("ALCZA 0")
    plant.chamber_pressure[:] = 30e3
    ask("AS 0")
    assert plant.regulator[8] == pytest.approx(30e3)


# -- the relay module and the gauge
@pytest.fixture
def relay(bench: Bench) -> serial.Serial:
    fake = bench.started(NumatoFake(bench.plant, bench.clock))
    return bench.closing(serial.serial_for_url(fake.port, 19200, timeout=20))


@pytest.fixture
def gauge(bench: Bench) -> serial.Serial:
    fake = bench.started(PfeifferFake(bench.plant, bench.clock))
    return bench.closing(serial.serial_for_url(fake.port, 9600, timeout=20))


def typed(port: serial.Serial, command: str) -> bytes:
    port.write(command.encode() + b"\r")
    return port.read_until(b">")


def test_all_relays_are_written_at_once_and_reset(relay: serial.Serial, plant: Plant) -> None:
    assert typed(relay, "relay writeall 05") == b"relay writeall 05\n\r>"
    assert typed(relay, "relay readall") == b"relay readall\n\r05\n\r>"
    assert typed(relay, "reset") == b"reset\n\r>"
    assert typed(relay, "relay readall") == b"relay readall\n\r00\n\r>"
    assert typed(relay, "relay writeall 5") == b"relay writeall 5\n\r>"
    assert not plant.valve_on


@pytest.mark.parametrize("command", ["RELAY ON 0", "relay  on 0", "relay on 9", "relay on", "on 0", "relay on 00"])
def test_anything_else_does_nothing(relay: serial.Serial, plant: Plant, command: str) -> None:
    assert typed(relay, command) == command.encode() + b"\n\r>"
    assert typed(relay, "relay readall").split()[-2] == b"00"
    assert not plant.valve_on


def telegram(text: str) -> bytes:
    return f"{text}{checksum(text)}\r".encode()


def test_an_unknown_parameter_is_told_so(gauge: serial.Serial) -> None:
    gauge.write(telegram("0010099902=?"))
    assert gauge.read_until(b"\r") == telegram("0011099906NO_DEF")


@pytest.mark.parametrize("request_", [b"0010074002=?000\r", telegram("0020074002=?"), telegram("0010074001?")])
def test_a_telegram_that_is_not_exact_or_not_for_this_gauge_meets_silence(gauge: serial.Serial, request_: bytes) -> None:
    gauge.write(request_)
    gauge.timeout = 0.2
    assert gauge.read(1) == b""


# -- the ITV
@pytest.fixture
def itv(bench: Bench, itv_fake: SmcItvFake) -> serial.Serial:
    return bench.closing(serial.serial_for_url(itv_fake.port, 9600, timeout=20))


def told(itv: serial.Serial, words: str) -> str:
    itv.write(words.encode() + b"\r\n")
    return str(itv.read_until(b"\r\n").decode().strip())


def test_steps_of_two_go_up_and_down_and_stop_at_the_ends(itv: serial.Serial) -> None:
    assert told(itv, "DEC") == "OUT OF RANGE"
    assert [told(itv, "INC"), told(itv, "INC"), told(itv, "DEC")] == ["2", "4", "2"]


@pytest.mark.parametrize("words", ["SET 1024", "SET 99999"])
def test_set_points_out_of_range_are_refused_and_change_nothing(itv: serial.Serial, itv_fake: SmcItvFake, words: str) -> None:
    assert told(itv, words) == "OUT OF RANGE"
    assert itv_fake.device.setpoint == 0


@pytest.mark.parametrize("words", ["SET", "SET -1", "SET  5", "set 5", "SET 5.0", "WHO", ""])
def test_what_is_not_exact_is_an_unknown_command(itv: serial.Serial, words: str) -> None:
    assert told(itv, words) == "UNKNOWN COMMAND"


def test_a_line_without_carriage_return_and_line_feed_is_not_a_line(itv: serial.Serial) -> None:
    itv.write(b"SET 5\r")
    itv.timeout = 0.1
    assert itv.read(10) == b""
    itv.timeout = 20
    itv.write(b"\n")
    assert itv.read_until(b"\r\n") == b"5\r\n"
