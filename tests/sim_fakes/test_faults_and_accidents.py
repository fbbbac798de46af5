"""Every instrument has every fault, off again by `end`; accidents change what the robot does, not what it is told."""

from collections.abc import Iterator

import pytest

from sim_fakes.faults import ACCIDENTS, FAULTS, INSTRUMENTS
from sim_fakes.pty_fake import Faults
from sim_fakes.rig import FakeRig
from tests.simulated.bench import raises

KINDS = (("alicat", "dynamixel"), ("smc_itv", "tmcl"))


@pytest.fixture(scope="module", params=KINDS, ids="+".join)
def rig(request: pytest.FixtureRequest) -> Iterator[FakeRig]:
    """Fakes that are not started: nothing moves but by hand."""
    regulators, spine = request.param
    made = FakeRig(regulators=regulators, spine=spine)
    yield made
    made.stop()


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_can_be_switched_on_and_off_at_each_instrument(rig: FakeRig, fault: str) -> None:
    for instrument in INSTRUMENTS:
        if instrument == "arm":
            continue  # a process of its own, tried with the matrix
        rig.switch.begin(instrument, fault)
        rig.switch.end()
    assert all(line.faults == Faults() and line.port for line in rig.lines.values())
    assert rig.mocap.faults == Faults()


@pytest.mark.parametrize(("instrument", "fault"), [("arms", "silence"), ("spine", "melted")])
def test_an_unknown_name_is_refused(rig: FakeRig, instrument: str, fault: str) -> None:
    raises(ValueError, "one of", rig.switch.begin, instrument, fault)
    raises(ValueError, ACCIDENTS[0], rig.accidents.begin, "meteorite")


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ('{"faults": {"relay": {"silent": true}}}', "no serial line 'relay'; one of "),
        ('{"panel": ["cell", "A", "unlock"]}', "no serial line 'cell'; one of "),
        ('{"tip": false}', "unknown request 'tip'; one of prepare, confirm, state, "),
    ],
)
def test_the_back_door_names_what_there_is(rig: FakeRig, request_: str, said: str) -> None:
    answer = rig.door.answer(request_.encode())["error"]
    assert said in answer and ("serial" not in said or ", ".join(rig.lines) in answer)


def test_the_panel_of_an_alicat_names_its_units() -> None:
    made = FakeRig()
    assert "no unit 'Q'; one of A, B, C" in made.door.answer(b'{"panel": ["pressure", "Q", "unlock"]}')["error"]
    assert "no unit 'furlong'; one of Pa, " in made.door.answer(b'{"panel": ["pressure", "A", "unit", "furlong"]}')["error"]
    made.stop()


def settle(rig: FakeRig) -> None:
    for _ in range(10):
        rig.accidents.advance(rig.robot, rig.plant, 0.5)


@pytest.mark.parametrize(("accident", "held"), [("leak", 70e3), ("burst", 0.0), ("supply_low", 60e3)])
def test_the_chambers_hold_less_than_they_are_told(rig: FakeRig, accident: str, held: float) -> None:
    rig.plant.regulator[:] = 100e3
    settle(rig)
    rig.accidents.begin(accident)
    settle(rig)
    first = rig.wiring[0][0] - 1
    assert rig.plant.chamber_pressure[first] == pytest.approx(held, abs=200)
    assert (rig.plant.regulator == 100e3).all()
    rig.accidents.end()
    settle(rig)
    assert rig.plant.chamber_pressure[first] == pytest.approx(100e3, abs=200)
    rig.plant.regulator[:] = 0.0
    settle(rig)


def test_a_stuck_valve_keeps_its_vacuum(rig: FakeRig) -> None:
    rig.plant.valve_on = True
    settle(rig)
    rig.accidents.begin("valve_stuck")
    settle(rig)
    rig.plant.valve_on = False
    settle(rig)
    assert rig.plant.vacuum_absolute < 40e3
    rig.accidents.end()
    settle(rig)
    assert rig.plant.vacuum_absolute > 80e3


def test_a_lost_marker_hides_the_tip_and_a_slip_shortens_the_spine_once(rig: FakeRig) -> None:
    rig.plant.spine_drive = 0.1
    settle(rig)
    rig.plant.valve_on = True
    settle(rig)
    before = rig.robot.spine.length
    rig.accidents.begin("jam_slip")
    rig.accidents.begin("marker_lost")
    settle(rig)
    assert rig.robot.spine.length == pytest.approx(before - 8e-3, abs=1e-4)
    assert not rig.plant.tip_visible
    rig.switch.end()
    assert rig.plant.tip_visible
    rig.plant.valve_on = False
    settle(rig)
