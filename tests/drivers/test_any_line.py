"""What a serial line may do to any driver, beyond `lab.driver_contract`: half an answer, two pieces, an echo, a stranger."""

from dataclasses import replace
from typing import Any

import pytest

import timing
from drivers.errors import BadReply, InstrumentError, NoReply, Unreachable, WrongDevice
from lab import driver_contract
from lab.driver_contract import POLLED, SPEED, DriverOnFake, answers, unit, units, until
from lab.verbs.fakes import found_fakes
from sim_fakes.instrument import Site
from sim_fakes.pty_fake import Faults, PtyFake
from tests.simulated.bench import raises
from timing import RigClock

__all__ = ["unit"]
READ = tuple(role for role in POLLED if role != "force")
"""Kinds that answer when they are asked."""
STRANGERS = {"alicat": "ft300s", "smc_itv": "alicat", "numato": "pfeiffer", "ft300s": "alicat"}
"""Which other instrument is tried at the port of a driver; numato where none is named."""


def read_of(unit: DriverOnFake) -> Any:
    """The call that gives its newest reading."""
    return unit.driver.latest if unit.role == "force" else unit.driver.read


@units(*READ)
@pytest.mark.parametrize("fault", ["silent", "truncate"])
def test_half_an_answer_or_none_is_no_reading_and_the_next_whole_one_is(unit: DriverOnFake, fault: str) -> None:
    quick = unit.hasty()
    quick.open()
    for line in unit.disturbed:
        setattr(line.faults, fault, True)
    start = timing.now()
    raises((NoReply, BadReply), None, quick.read)
    assert timing.now() - start < 20.0
    for line in unit.disturbed:
        line.faults = Faults()
    assert until(lambda: answers(quick.read))
    quick.close()


@units("pressure")
def test_a_fake_that_fails_is_told_and_one_without_a_line_to_disturb_is_skipped_with_what_to_offer(unit: DriverOnFake) -> None:
    damaged = driver_contract.test_it_does_not_open_on_a_line_whose_answers_are_all_damaged
    for test in (driver_contract.test_connect_is_enough_to_vent, damaged):
        raises(pytest.skip.Exception, r"`faults = Faults\(\)` .* `send`", test, replace(unit, parts=[]))
    failed = type("OwnFake", (), {"ended_by": KeyError("bits")})()
    raises(AssertionError, r"fake's own code failed: OwnFake ended by KeyError\('bits'\)", damaged, replace(unit, parts=[failed]))


@units(*READ)
def test_answers_in_two_pieces_are_put_together(unit: DriverOnFake) -> None:
    unit.driver.open()
    for line in unit.disturbed:
        line.faults.split = True
    unit.driver.read()


@units(*READ)
def test_a_line_that_is_lost_is_told_and_closing_is_quiet_about_it(unit: DriverOnFake) -> None:
    unit.driver.open()
    for part in unit.parts:
        part.stop()
    raises((Unreachable, NoReply), None, unit.driver.read)
    unit.driver.close()


@units(*POLLED)
def test_an_echoing_adapter_is_harmless_and_named_where_notices_are_taken(unit: DriverOnFake) -> None:
    if unit.config.driver == "numato":
        pytest.skip("no two-wire line")
    line = unit.disturbed[0]
    line.faults.echo = True
    unit.driver.open()
    assert answers(read_of(unit))
    if hasattr(unit.driver, "take_notices"):
        told = [text for text in unit.driver.take_notices() if "echo" in text]
        assert len(told) == 1 and line.port in told[0]
        assert not any("echo" in text for text in unit.driver.take_notices())


@units(*READ)
@pytest.mark.parametrize("delay", [0.008, 0.016, 0.02])
def test_answers_that_an_adapter_holds_back_are_named_once_with_the_remedy(unit: DriverOnFake, delay: float) -> None:
    driver = unit.another(timeout=1.0)
    for line in unit.disturbed:
        line.byte_time *= SPEED  # the line itself is as slow as in rig.yaml
    driver.open()
    for _ in range(25):
        driver.read()
    assert driver.take_notices() == []
    for line in unit.disturbed:
        line.faults.delay = delay
    for _ in range(25):
        driver.read()
    (told, *_) = driver.take_notices()
    assert "later than the line needs" in told and "latency" in told
    assert driver.take_notices() == []
    driver.close()


@units(*POLLED)
def test_noise_of_a_line_that_is_turned_round_is_no_part_of_an_answer(unit: DriverOnFake) -> None:
    for line in unit.disturbed:
        line.faults.garbage = b"\xff\0"
    unit.driver.open()
    assert answers(read_of(unit))


@units(*POLLED)
def test_another_instrument_on_the_port_is_told_in_time(unit: DriverOnFake) -> None:
    stranger = found_fakes().usable[STRANGERS.get(unit.config.driver, "numato")]
    (line, *_) = stranger.plug(Site(unit.plant, RigClock(SPEED), 1, ((1,), (2,), (3,)), 500e3))
    assert isinstance(line, PtyFake)
    line.start()
    ports = [line.port, *unit.config.ports[1:]] if hasattr(unit.config, "ports") else None
    wrong = unit.another(**({"ports": ports} if ports else {"port": line.port}))
    start = timing.now()
    with pytest.raises((Unreachable, WrongDevice)) as caught:
        wrong.open()
    assert isinstance(caught.value, InstrumentError) and line.port in str(caught.value)
    assert timing.now() - start < 20.0
    line.stop()
