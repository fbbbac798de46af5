"""The SMC ITV driver through pyserial, against nine fake units on nine ptys.

With LAB_TEST_ITV_PORTS=/dev/ttyUSB0,/dev/ttyUSB1 (and LAB_TEST_ITV_FULL_SCALE in Pa) the tests that need no fault run
against real units. Those that pressurise, to 20 kPa at most, want LAB_TEST_ALLOW_MOTION=1 as well.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pydantic import ValidationError

import timing
from drivers.errors import BadReply, DeviceFault, InstrumentError, Unreachable, WrongDevice
from drivers.smc_itv.driver import REREAD_EVERY, Config, SmcItv
from sim_fakes.alicat import AlicatFake
from sim_fakes.plant import Plant
from sim_fakes.smc_itv import SmcItvFake
from timing import RigClock

HARDWARE = [port for port in os.environ.get("LAB_TEST_ITV_PORTS", "").split(",") if port]
FULL_SCALE = float(os.environ.get("LAB_TEST_ITV_FULL_SCALE", "500e3"))
COUNT = FULL_SCALE / 1023
"""One count, Pa."""
CHANNELS = len(HARDWARE) or 9


@pytest.fixture
def clock() -> RigClock:
    return RigClock(speed=1.0 if HARDWARE else 20.0)


@pytest.fixture
def fakes(plant: Plant, clock: RigClock) -> Iterator[list[SmcItvFake]]:
    if HARDWARE:
        pytest.skip("needs the fake units")
    fakes = [SmcItvFake(plant, clock, [i + 1], seed=i) for i in range(CHANNELS)]
    for fake in fakes:
        fake.start()
    yield fakes
    for fake in fakes:
        fake.stop()


@pytest.fixture
def make(request: pytest.FixtureRequest, clock: RigClock) -> Iterator[Callable[..., SmcItv]]:
    made: list[SmcItv] = []

    def make(**changes: Any) -> SmcItv:
        ports = HARDWARE or [fake.port for fake in request.getfixturevalue("fakes")]
        values: dict[str, Any] = {
            "ports": ports,
            "chambers": [[i + 1] for i in range(CHANNELS)],
            "full_scale": FULL_SCALE,
            "timeout": 1.0,
        }
        made.append(SmcItv("pressure", Config(**(values | changes)), clock))
        return made[-1]

    yield make
    for regulators in made:
        regulators.close()


@pytest.fixture
def regulators(make: Callable[..., SmcItv]) -> SmcItv:
    regulators = make()
    regulators.open()
    return regulators


@pytest.fixture
def may_pressurise() -> None:
    if HARDWARE and os.environ.get("LAB_TEST_ALLOW_MOTION") != "1":
        pytest.skip("pressurises: set LAB_TEST_ALLOW_MOTION=1 when nobody is at the robot")


# -- these run on hardware too
def test_opening_recognises_all_units(make: Callable[..., SmcItv]) -> None:
    identity = make().open()
    assert (identity.maker, identity.model) == ("SMC", f"ITV, {CHANNELS} units")


@pytest.mark.usefixtures("may_pressurise")
def test_the_set_point_returned_is_in_whole_counts_of_the_range(regulators: SmcItv, clock: RigClock) -> None:
    clock.sleep(1.0)
    confirmed = regulators.set((20e3,) * CHANNELS)
    assert confirmed == pytest.approx((round(20e3 / COUNT) * COUNT,) * CHANNELS)
    assert regulators.read().setpoint == confirmed


@pytest.mark.usefixtures("may_pressurise")
def test_closing_leaves_the_units_vented_and_may_be_repeated(
    make: Callable[..., SmcItv], regulators: SmcItv, clock: RigClock
) -> None:
    clock.sleep(1.0)
    regulators.set((20e3,) * CHANNELS)
    regulators.close()
    regulators.close()
    again = make()
    timing.sleep(0.15)
    again.open()
    assert again.read().setpoint == (0.0,) * CHANNELS


# -- these need the fakes


def test_polls_keep_the_distance_that_the_units_need(regulators: SmcItv, fakes: list[SmcItvFake]) -> None:
    for _ in range(3):
        regulators.read()
    # a unit leaves a poll that comes too soon without an answer, and the driver would have had to ask again
    assert [fake.requests.count(b"MON\r\n") for fake in fakes] == [3] * CHANNELS


def test_what_is_above_the_limit_is_clipped_and_never_sent(
    make: Callable[..., SmcItv], fakes: list[SmcItvFake], clock: RigClock
) -> None:
    regulators = make(max_pressure=20e3)
    regulators.open()
    clock.sleep(1.0)
    confirmed = regulators.set((1e6, -1e3) + (0.0,) * 7)
    assert confirmed[0] == pytest.approx(40 * COUNT)
    assert confirmed[1] == 0.0
    assert max(int(r.split()[1]) for fake in fakes for r in fake.requests if r.startswith(b"SET")) == 40


def test_a_slow_ramp_in_steps_below_one_count_still_arrives(make: Callable[..., SmcItv], clock: RigClock) -> None:
    regulators = make(max_rate=2e3)
    regulators.open()
    deadline = clock.now() + 60.0
    while (last := regulators.set((5e3,) * CHANNELS))[0] < 5e3 - COUNT and clock.now() < deadline:
        clock.sleep(0.05)
    assert last[0] == pytest.approx(5e3, abs=COUNT)


def test_a_dead_unit_does_not_keep_the_others_from_venting_and_is_named(
    regulators: SmcItv, fakes: list[SmcItvFake], clock: RigClock
) -> None:
    clock.sleep(1.0)
    regulators.set((20e3,) * CHANNELS)
    fakes[0].faults.silent = True
    fakes[4].stop()
    with pytest.raises(InstrumentError, match="did not vent channel 1: .*; channel 5: .*by hand"):
        regulators.vent()
    assert [fake.device.setpoint for fake in fakes if fake not in (fakes[0], fakes[4])] == [0] * 7
    regulators.close()


def test_a_late_answer_is_never_taken_for_that_of_a_later_request(
    make: Callable[..., SmcItv], fakes: list[SmcItvFake], plant: Plant
) -> None:
    """A vented unit says 0; had it been inflated meanwhile, that 0 must not confirm anything."""
    regulators = make(timeout=0.5)
    regulators.open()
    slow = fakes[0]
    assert regulators.read().measured[0] < 5e3
    slow.faults.delay = 1.0  # later than the time-out of 0.5 s, sooner than what is held to be lost
    for _ in range(3):
        with pytest.raises(InstrumentError):
            regulators.read()
    slow.device.setpoint = 100  # inflated behind our back: every answer of before is wrong now
    for _ in range(6):
        try:
            seen = regulators.read().measured[0]
        except InstrumentError:
            continue
        assert seen > 5e3
    with pytest.raises(InstrumentError, match="did not vent channel 1"):
        regulators.vent()
    slow.faults.delay = 0.0
    until = timing.now() + 30.0
    while True:  # what is owed comes in, then the unit is understood again
        try:
            regulators.vent()
            break
        except InstrumentError:
            assert timing.now() < until
    assert slow.device.setpoint == 0


def test_after_a_moment_of_silence_the_units_are_understood_again(make: Callable[..., SmcItv], fakes: list[SmcItvFake]) -> None:
    regulators = make()
    regulators.open()
    fakes[0].faults.silent = True
    with pytest.raises(InstrumentError):
        regulators.read()
    fakes[0].faults.silent = False
    until = timing.now() + 30.0
    while True:
        try:
            assert len(regulators.read().measured) == CHANNELS
            break
        except InstrumentError:
            assert timing.now() < until
    assert len(regulators.read().measured) == CHANNELS


def test_a_unit_that_keeps_its_set_point_is_a_fault_naming_both_values(
    regulators: SmcItv, fakes: list[SmcItvFake], clock: RigClock
) -> None:
    fakes[2].faults.extra["ignore"] = True
    clock.sleep(1.0)
    with pytest.raises(DeviceFault, match=rf"{fakes[2].port} was set to 20.04 kPa but holds 0.00 kPa"):
        regulators.set((20e3,) * CHANNELS)


@pytest.mark.parametrize("text", ["OUT OF RANGE", "UNKNOWN COMMAND", "7777", "12x"])
def test_refusals_and_nonsense_are_bad_replies_that_show_the_words(
    regulators: SmcItv, fakes: list[SmcItvFake], text: str
) -> None:
    fakes[3].faults.extra["refuse"] = text
    with pytest.raises(BadReply, match=rf"{fakes[3].port} answers b'SET 0' with b'{text}'"):
        regulators.set((0.0,) * CHANNELS)


def test_a_unit_with_a_smaller_range_refuses_by_itself(regulators: SmcItv, fakes: list[SmcItvFake], clock: RigClock) -> None:
    fakes[1].device.highest = 20
    clock.sleep(1.0)
    with pytest.raises(BadReply, match="OUT OF RANGE"):
        regulators.set((20e3,) * CHANNELS)
    assert fakes[1].device.setpoint == 0


def test_silent_ports_are_all_named_at_opening(make: Callable[..., SmcItv], fakes: list[SmcItvFake]) -> None:
    fakes[0].faults.silent = fakes[8].faults.silent = True
    with pytest.raises(Unreachable, match=f"no answer on {fakes[0].port}, {fakes[8].port} "):
        make().open()


def test_another_instrument_on_a_port_is_told_at_opening(
    make: Callable[..., SmcItv], fakes: list[SmcItvFake], plant: Plant, clock: RigClock
) -> None:
    stranger = AlicatFake(plant, clock, units=("W",), chambers=((1,),), baud=19200)
    stranger.start()
    ports = [stranger.port, *(fake.port for fake in fakes[1:])]
    with pytest.raises((WrongDevice, Unreachable), match=stranger.port):
        make(ports=ports).open()
    stranger.stop()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ports": ["a"]}, "1 ports but 9 lists"),
        ({"ports": ["a"] * 9}, "listed twice"),
        ({"max_pressure": 600e3}, "above the units' full_scale"),
    ],
)
def test_a_configuration_that_cannot_work_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        Config(**({"ports": list("abcdefghi"), "full_scale": FULL_SCALE} | changes))


def test_a_setpoint_that_was_changed_at_the_panel_is_refused_by_name(
    make: Callable[..., SmcItv], fakes: list[SmcItvFake]
) -> None:
    regulators = make()
    regulators.open()
    regulators.confirm_settings()
    regulators.confirm_settings()
    fakes[1].device.setpoint = 41
    with pytest.raises(WrongDevice, match=r"channel 2: set-point \(REQ\) is 41 counts \(20\.0 kPa\), 0 .*was confirmed"):
        regulators.confirm_settings()
    regulators.vent()
    regulators.confirm_settings()


def test_a_setpoint_changed_while_inflated_is_met_within_ten_readings(
    make: Callable[..., SmcItv], fakes: list[SmcItvFake], clock: RigClock
) -> None:
    regulators = make(poll_interval=0.1)
    regulators.open()
    clock.sleep(2.0)
    regulators.set((20e3,) * CHANNELS)
    assert fakes[0].panel("setpoint", fakes[0].device.setpoint + 30)
    with pytest.raises(WrongDevice, match=r"channel 1: set-point \(REQ\).*its panel"):
        for _ in range(REREAD_EVERY):
            regulators.read()


def test_an_echoing_adapter_is_named_and_harmless(make: Callable[..., SmcItv], fakes: list[SmcItvFake]) -> None:
    fakes[1].faults.echo = True
    regulators = make()
    regulators.open()
    assert len(regulators.read().measured) == CHANNELS
    (told,) = regulators.take_notices()
    assert "echo" in told and fakes[1].port in told
