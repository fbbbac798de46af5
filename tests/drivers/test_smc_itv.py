"""The SMC ITV driver through pyserial, against nine fake units on lines of their own."""

from collections.abc import Callable
from typing import Any

import pytest

from drivers.errors import BadReply, DeviceFault, InstrumentError, Unreachable, WrongDevice
from drivers.smc_itv.driver import REREAD_EVERY, Config, SmcItv
from sim_fakes.smc_itv import SmcItvFake
from tests.simulated.bench import Bench, answered, raises

FULL_SCALE = 500e3
COUNT = FULL_SCALE / 1023
"""One count, Pa."""
Opened = Callable[..., SmcItv]


@pytest.fixture
def fakes(bench: Bench) -> list[SmcItvFake]:
    return [bench.started(SmcItvFake(bench.plant, bench.clock, [i + 1], seed=i)) for i in range(9)]


@pytest.fixture
def opened(bench: Bench, fakes: list[SmcItvFake]) -> Opened:
    """Opens drivers of the fakes, with other settings in rig.yaml; a rig second later they may be set."""

    def opened(**changes: Any) -> SmcItv:
        ports, chambers = [fake.port for fake in fakes], [[i + 1] for i in range(9)]
        config = Config(**({"ports": ports, "chambers": chambers, "full_scale": FULL_SCALE, "timeout": 1.0} | changes))
        regulators = bench.closing(SmcItv("pressure", config, bench.clock))
        regulators.open()
        bench.clock.sleep(1.0)
        return regulators

    return opened


@pytest.fixture
def regulators(opened: Opened) -> SmcItv:
    return opened()


def test_the_set_point_returned_is_in_whole_counts_of_the_range(regulators: SmcItv) -> None:
    confirmed = regulators.set((20e3,) * 9)
    assert confirmed == pytest.approx((round(20e3 / COUNT) * COUNT,) * 9)
    assert regulators.read().setpoint == confirmed


def test_polls_keep_the_distance_that_the_units_need(regulators: SmcItv, fakes: list[SmcItvFake]) -> None:
    for _ in range(3):
        regulators.read()
    # a unit leaves a poll that comes too soon without an answer, and the driver would have had to ask again
    assert [fake.requests.count(b"MON\r\n") for fake in fakes] == [3] * 9


def test_a_slow_ramp_in_steps_below_one_count_still_arrives(bench: Bench, opened: Opened) -> None:
    regulators = opened(max_rate=2e3)
    deadline = bench.clock.now() + 60.0
    while (last := regulators.set((5e3,) * 9))[0] < 5e3 - COUNT and bench.clock.now() < deadline:
        bench.clock.sleep(0.05)
    assert last[0] == pytest.approx(5e3, abs=COUNT)


def test_a_dead_unit_does_not_keep_the_others_from_venting_and_is_named(regulators: SmcItv, fakes: list[SmcItvFake]) -> None:
    regulators.set((20e3,) * 9)
    fakes[0].faults.silent = True
    fakes[4].stop()
    raises(InstrumentError, "did not vent channel 1: .*; channel 5: .*by hand", regulators.vent)
    assert [fake.device.setpoint for fake in fakes if fake not in (fakes[0], fakes[4])] == [0] * 7
    regulators.close()


def test_a_late_answer_is_never_taken_for_that_of_a_later_request(opened: Opened, fakes: list[SmcItvFake]) -> None:
    """A vented unit says 0; had it been inflated meanwhile, that 0 must not confirm anything."""
    regulators = opened(timeout=0.5)
    slow = fakes[0]
    assert regulators.read().measured[0] < 5e3
    slow.faults.delay = 1.0  # later than the time-out of 0.5 s, sooner than what is held to be lost
    for _ in range(3):
        raises(InstrumentError, None, regulators.read)
    slow.device.setpoint = 100  # inflated behind our back: every answer of before is wrong now
    for _ in range(6):
        try:
            seen = regulators.read().measured[0]
        except InstrumentError:
            continue
        assert seen > 5e3
    raises(InstrumentError, "did not vent channel 1", regulators.vent)
    slow.faults.delay = 0.0
    answered(regulators.vent)
    assert slow.device.setpoint == 0


def test_a_unit_that_keeps_its_set_point_is_a_fault_naming_both_values(regulators: SmcItv, fakes: list[SmcItvFake]) -> None:
    fakes[2].faults.extra["ignore"] = True
    raises(DeviceFault, rf"{fakes[2].port} was set to 20.04 kPa but holds 0.00 kPa", regulators.set, (20e3,) * 9)


@pytest.mark.parametrize("text", ["OUT OF RANGE", "UNKNOWN COMMAND", "7777", "12x"])
def test_refusals_and_nonsense_are_bad_replies_that_show_the_words(
    regulators: SmcItv, fakes: list[SmcItvFake], text: str
) -> None:
    fakes[3].faults.extra["refuse"] = text
    raises(BadReply, rf"{fakes[3].port} answers b'SET 0' with b'{text}'", regulators.set, (0.0,) * 9)


def test_silent_ports_are_all_named_at_opening(opened: Opened, fakes: list[SmcItvFake]) -> None:
    fakes[0].faults.silent = fakes[8].faults.silent = True
    raises(Unreachable, f"no answer on {fakes[0].port}, {fakes[8].port} ", opened)


def test_a_setpoint_that_was_changed_at_the_panel_is_refused_by_name(opened: Opened, fakes: list[SmcItvFake]) -> None:
    regulators = opened()
    regulators.confirm_settings()
    regulators.confirm_settings()
    fakes[1].device.setpoint = 41
    with pytest.raises(WrongDevice, match=r"channel 2: set-point \(REQ\) is 41 counts \(20\.0 kPa\), 0 .*was confirmed"):
        regulators.confirm_settings()
    regulators.vent()
    regulators.confirm_settings()


def test_a_setpoint_changed_while_inflated_is_met_within_ten_readings(opened: Opened, fakes: list[SmcItvFake]) -> None:
    regulators = opened(poll_interval=0.1)
    regulators.set((20e3,) * 9)
    assert fakes[0].panel("setpoint", fakes[0].device.setpoint + 30)
    with pytest.raises(WrongDevice, match=r"channel 1: set-point \(REQ\).*its panel"):
        for _ in range(REREAD_EVERY):
            regulators.read()
