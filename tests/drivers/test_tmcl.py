"""What is particular to the Trinamic length unit, through pytrinamic against the fake module."""

from functools import partial

import pytest

from drivers.errors import BadReply, DeviceFault, NotReady, WrongDevice
from sim_fakes.tmcl import AxisNumber, TmclFake
from tests.drivers.spines import Make, arrive, homed, make_pair, watch
from tests.simulated.bench import Bench, raises, wait_until


@pytest.fixture
def make(bench: Bench) -> Make:
    return partial(make_pair, bench, "tmcl")


def stands(module: TmclFake) -> None:
    """Wait until the drum, once it turns, stands again; nothing is sent meanwhile."""
    wait_until(lambda: module.drum.speed != 0)
    wait_until(lambda: module.drum.speed == 0)


def test_open_names_the_module_and_switches_the_deviation_stop_on(make: Make) -> None:
    spine, module = make(max_deviation=0.002)
    identity = spine.open()
    assert (identity.model, identity.firmware) == ("TMCM-1260", "1.16")
    assert module.drum.parameters[AxisNumber.MAX_DEVIATION] == 1024
    assert module.drum.heartbeat == 2.0


def left(module: TmclFake, name: str, number: int, value: int) -> None:
    """Give the module a setting as an earlier program has left it."""
    if name == "axis":
        module.drum.parameters[number] = value
    elif number == 77:
        module.drum.auto_start = bool(value)
    elif number == 87:
        module.secondary_address = value
    elif number == 128:
        module.drum.run()
    else:
        module.drum.heartbeat = value / 1000


WRITTEN = [
    ("axis", 13, 1, 0),
    ("axis", 26, 1, 0),
    ("axis", 204, 1, 0),
    ("axis", 254, 2, 0),
    ("axis", 255, 0, 1),
    ("global", 68, 0, 2000),
    ("global", 77, 1, 0),
    ("global", 87, 3, 0),
    ("global", 128, 1, 0),
]


@pytest.mark.parametrize(("name", "number", "value", "needed"), WRITTEN)
def test_settings_that_an_earlier_program_left_are_written_at_open_and_watched(
    make: Make, name: str, number: int, value: int, needed: int
) -> None:
    spine, module = make()
    left(module, name, number, value)
    spine.open()
    assert (spine._axis.get if name == "axis" else spine._axis.get_global)(number) == needed
    spine.confirm_settings()
    left(module, name, number, value)
    raises(WrongDevice, rf"\({name} parameter {number}\) is {value}, needed {needed}: .*; open", spine.confirm_settings)


def test_the_right_switch_is_the_one_that_must_be_on_for_a_spine_that_grows_backwards(make: Make) -> None:
    spine, module = make({"direction": -1}, direction=-1)
    module.drum.parameters |= {12: 1, 13: 1}
    spine.open()
    assert (module.drum.parameters[12], module.drum.parameters[13]) == (0, 1)


@pytest.mark.parametrize(
    ("number", "value", "message"),
    [
        (6, 0, r"maximum current \(axis parameter 6\) is 0, needed 1: .*TMCL-IDE"),
        (7, 0, r"standby current \(axis parameter 7\) is 0, needed 1: the motor would not hold; .*TMCL-IDE"),
        (5, 100, r"acceleration \(axis parameter 5\) is 100, needed 25600: a stop would take longer than 1 s"),
        (17, 100, r"deceleration \(axis parameter 17\) is 100, needed 25600"),
        (140, 7, r"resolution .* is 25600, needed 51200: lengths would be wrong"),
        (202, 400, r"resolution .* is 102400, needed 51200"),
    ],
)
def test_settings_that_only_a_person_may_change_are_refused(make: Make, number: int, value: int, message: str) -> None:
    spine, module = make()
    spine.open()
    module.drum.parameters[number] = value
    raises(WrongDevice, message, spine.confirm_settings)
    spine.close()
    raises(WrongDevice, message, spine.open)
    assert module.drum.parameters[number] == value


def test_a_stored_program_that_turns_the_motor_stands_after_open(make: Make) -> None:
    spine, module = make()
    module.drum.auto_start = True
    module.restart()
    assert module.drum.program
    spine.open()
    assert not module.drum.program and spine.read().speed == 0
    module.restart()
    assert not module.drum.program


@pytest.mark.parametrize("fault", ["wrong_address", "wrong_command"])
def test_an_answer_to_somebody_elses_question_is_not_taken(make: Make, fault: str) -> None:
    spine, module = make()
    spine.open()
    module.faults.extra[fault] = True
    raises(BadReply, "answered command", spine.read)


def test_a_module_that_answers_another_host_is_told_from_a_broken_cable(make: Make) -> None:
    spine, _ = make({"host": 3}, timeout=0.1)
    assert "cable" not in raises(WrongDevice, r"to host 3, not 2: correct `host` .*global parameter 76", spine.open)


def test_a_broken_coupling_is_noticed_by_the_encoder(make: Make) -> None:
    spine, module = make()
    homed(spine)
    module.faults.extra["stuck"] = True
    spine.move_to(0.1, 0.05)
    raises(DeviceFault, "did not follow", arrive, spine)


def test_a_search_that_was_cut_short_is_not_taken_for_homed(make: Make) -> None:
    spine, module = make({"start_length": 0.3}, heartbeat=0.1)
    spine.open()
    spine.home()
    stands(module)
    raises(DeviceFault, "without reaching the switch", watch, spine, lambda s: s.homed)
    raises(NotReady, None, spine.move_to, 0.1, 0.02)


def test_a_damaged_motor_driver_costs_the_zero(make: Make) -> None:
    spine, module = make()
    homed(spine)
    module.faults.extra["driver"] = 1 << 1
    raises(DeviceFault, "overheated", spine.read)
    raises(NotReady, None, spine.move_to, 0.1, 0.02)
