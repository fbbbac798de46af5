"""What a person can put right suspends the experiment: vented meanwhile, and every point there once afterwards."""

from pathlib import Path

import pytest
from house import BENDING, STIFFNESS, House, during, until

import timing
from drivers.errors import InstrumentError
from lab.console import Screen
from lab.rig.assembly import Rig
from lab.verbs.run import connect, execute, job
from protocols.steering import Steering
from recordings.campaign.replay import table_of
from recordings.file.reader import Recording


@pytest.mark.parametrize(("accident", "word"), [("marker_lost", "mocap"), ("supply_low", "pressure")])
def test_a_bending_sweep_goes_on_without_losing_or_doubling_a_point(
    house: House, tmp_path: Path, accident: str, word: str
) -> None:
    house.change(limits={"max_hidden": 0.5})
    vented: list[float] = []

    def repair(trouble: str) -> None:
        until(lambda: house.highest() < 5e3)  # it is confirmed by readings, whose noise the truth has not
        vented.append(house.highest())
        house.fakes.switch.end()

    house.fakes.on_confirm = repair
    plant = house.fakes.plant
    during(lambda: plant.valve_on and float(plant.regulator.max()) > 100e3, lambda: house.fakes.accidents.begin(accident))
    rows = table_of(house.completed(tmp_path, "bending", *BENDING))
    assert vented and max(vented) < 5e3
    assert len(house.fakes.troubles) == 1 and word in house.fakes.troubles[0]
    asked = [(r.step, r.branch, round(max(r.pressures) / 60e3)) for r in rows]
    assert asked == [(1, "load", 0), (2, "load", 1), (3, "load", 2), (4, "unload", 1), (5, "unload", 0)]


STOPS = {"safeguard_stop": "safeguard stop", "emergency_stop": "emergency stop"}
"""A protective stop takes the way of the emergency stop, which switches the arm off in addition."""


@pytest.mark.parametrize("stop", ["safeguard_stop", pytest.param("emergency_stop", marks=pytest.mark.long)])
def test_a_stiffness_trial_goes_on_after_the_arms_own_safety_system_held_it(house: House, tmp_path: Path, stop: str) -> None:
    ur, plant = house.fakes.ur, house.fakes.plant
    assert ur is not None
    ur.backdoor("forget")
    stopped: list[int] = []

    def put_right(trouble: str) -> None:
        stopped.append(len(ur.backdoor()["commands"]))
        timing.sleep(0.3)  # a person takes a while
        stopped.append(len(ur.backdoor()["commands"]))
        ur.backdoor("clear")

    house.fakes.on_confirm = put_right
    during(lambda: abs(plant.probe_force).max() > 1.0, lambda: ur.backdoor(stop))
    table = table_of(house.completed(tmp_path, "stiffness", *STIFFNESS))
    assert any(STOPS[stop] in trouble for trouble in house.fakes.troubles)
    assert stopped[0] == stopped[1]  # nothing moves before the person has confirmed
    assert [r.step for r in table] == [1, 2, 3]


def test_what_is_not_put_right_ends_the_run_with_its_cause(
    house: House, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    house.change(limits={"max_hidden": 0.5, "resume_within": 1.0})
    plant = house.fakes.plant
    during(lambda: float(plant.regulator.max()) > 50e3, lambda: house.fakes.accidents.begin("marker_lost"))
    assert house.lab(tmp_path, "bending", *BENDING) == 1
    assert "mocap" in capsys.readouterr().err
    assert house.vented() and not house.latch.exists()


@pytest.mark.parametrize("silent", [True, False])
def test_in_a_pause_that_a_person_asked_for_every_instrument_must_go_on_measuring(
    house: House, tmp_path: Path, silent: bool
) -> None:
    house.change(without=("arm", "force"), limits={"max_hidden": 0.5})
    settings = [word for word in BENDING if word != "--set"]
    steering, plant = Steering(), house.fakes.plant
    during(lambda: float(plant.regulator.max()) > 50e3, lambda: steering.ask("pause", "test"))
    rests: list[float] = []

    def in_the_pause() -> None:
        until(lambda: house.highest() < 5e3)
        rests.append(float(plant.valve_on))
        if silent:
            house.fakes.switch.begin("gauge", "silence")
        else:
            house.fakes.accidents.begin("marker_lost")  # as by somebody before the cameras
            timing.sleep(1.0)
            steering.ask("go on", "test")
            timing.sleep(1.0)
            house.fakes.switch.end()

    during(lambda: steering.resting, in_the_pause)
    asked = job("bending", house.rig, settings)
    with Rig(asked.rig) as rig:
        connect(rig, asked.experiment.needs, quiet=True)
        done = execute(rig, asked, tmp_path, Screen("test", quiet=True), steering=steering)
        house.fakes.switch.end()
    assert rests == [1.0]  # vented, and still jammed
    if silent:
        assert done.outcome == "failed" and isinstance(done.error, InstrumentError) and done.error.instrument == "gauge"
    else:
        assert done.outcome == "completed" and [row.step for row in done.table] == [1, 2, 3, 4, 5]
    kinds = [(request.kind, request.done) for request in Recording.open(done.file).requests]
    went_on = [] if silent else [("go on", False), ("go on", True)]
    assert kinds == [("pause", False), ("pause", True), *went_on]
