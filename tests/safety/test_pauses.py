"""What a person can put right suspends the experiment: vented meanwhile, and every point there once afterwards."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from house import BENDING, STIFFNESS, House, during, recorded, until

import timing
from drivers.errors import InstrumentError
from lab.cli import main
from lab.console import Screen
from lab.files.units import KINDS
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


# a protective stop takes the way of the emergency stop, which switches the arm off in addition
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
    assert any(stop.replace("_", " ") in trouble for trouble in house.fakes.troubles)
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


# -- cameras that take one body for another
@pytest.mark.parametrize("pair", [("Tip", "M2"), pytest.param(("M1", "M3"), marks=pytest.mark.long)])
def test_bodies_exchanged_in_mid_sweep_hold_the_run_up(
    house: House, tmp_path: Path, pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    fakes, plant, cameras = house.fakes, house.fakes.plant, house.fakes.mocap
    assert cameras is not None
    fakes.on_confirm = lambda trouble: fakes.switch.end()
    during(lambda: float(plant.chamber_pressure.max()) > 100e3, lambda: cameras.faults.extra.update(exchange=pair))
    assert house.lab(tmp_path, "bending", *BENDING) == 3
    assert any("mocap" in trouble and "mm apart" in trouble for trouble in fakes.troubles)
    assert "a body was out of the robot's reach" in capsys.readouterr().err
    recording = recorded(tmp_path)
    table = table_of(recording)
    assert [row.step for row in table] == [1, 2, 3, 4, 5] and table.doubtful.any()
    assert recording.marks and recording.marks[0].doubt == "bodies"
    assert all(row.tip is not None and row.tip[2] > 0.25 for row in table)


def test_a_check_names_bodies_that_cannot_be_where_they_are(house: House, capsys: pytest.CaptureFixture[str]) -> None:
    house.change(without=("arm", "force"))
    assert main(["check", "--rig", str(house.rig)]) in (0, 3)
    assert "mm apart" not in capsys.readouterr().err
    mocap = yaml.safe_load(house.rig.read_text())["instruments"]["mocap"]
    written = [c.split() for c in mocap["mocap_to_base"]["position"]]
    position = [float(number) * KINDS["m"][unit] + 0.3 for number, unit in written]
    house.change_instrument("mocap", mocap_to_base={**mocap["mocap_to_base"], "position": position})
    assert main(["check", "--rig", str(house.rig)]) in (0, 3)
    assert "the base and the tip are" in " ".join(capsys.readouterr().err.split())


# -- a state of a jammed spine counts only if it kept its vacuum, or pushes back where the gauge does not tell
PLANNED = 80e3


def vacuum(house: House, supply: float) -> None:
    """Set the level of the vacuum supply, Pa below ambient."""
    with house.fakes.plant.lock:
        house.fakes.plant.vacuum_supply = supply


def lose(house: House) -> None:
    """The vacuum goes, and the gauge does not tell: its value stands still, its noise does not."""
    house.fakes.set_faults("gauge", {"freeze": True})
    vacuum(house, 0.0)


def put_right(house: House) -> None:
    """What a person does about it."""
    house.fakes.switch.end()
    vacuum(house, PLANNED)


@pytest.mark.parametrize("level", [94e3, *(pytest.param(p, marks=pytest.mark.long) for p in (0.0, 60e3))])
def test_a_bending_state_is_read_again_with_the_spine_jammed_anew(house: House, tmp_path: Path, level: float) -> None:
    house.fakes.on_confirm = lambda trouble: vacuum(house, PLANNED)
    plant = house.fakes.plant
    during(lambda: plant.valve_on and float(plant.chamber_pressure.max()) > 100e3, lambda: vacuum(house, level))
    recording = house.completed(tmp_path, "bending", *BENDING)
    assert any("gauge" in trouble and "kPa below ambient" in trouble for trouble in house.fakes.troubles)
    table = table_of(recording)
    assert [row.step for row in table] == [1, 2, 3, 4, 5]
    assert np.all(np.abs(table["vacuum"] - PLANNED) < 11e3)


def test_a_vacuum_that_comes_back_by_itself_between_two_states_is_noticed(house: House, tmp_path: Path) -> None:
    plant = house.fakes.plant

    def lose() -> None:
        vacuum(house, 0.0)
        during(lambda: plant.vacuum_absolute > 90e3, lambda: vacuum(house, PLANNED))

    during(lambda: plant.valve_on and float(plant.regulator.max()) > 70e3, lose)
    recording = house.completed(tmp_path, "bending", *BENDING)
    assert any("gauge" in trouble for trouble in house.fakes.troubles)
    assert [row.step for row in table_of(recording)] == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("stuck", "says"), [(False, "spine jammed at 72 kPa"), (True, "gauge: its reading has been frozen to the last digit")]
)
def test_what_is_not_put_right_ends_the_run_without_a_state_of_a_soft_spine(
    house: House, tmp_path: Path, capsys: pytest.CaptureFixture[str], stuck: bool, says: str
) -> None:
    plant, switch = house.fakes.plant, house.fakes.switch
    spoil = (lambda: switch.begin("gauge", "stuck")) if stuck else (lambda: vacuum(house, 0.0))
    during(lambda: plant.valve_on and float(plant.chamber_pressure.max()) > 50e3, spoil)
    held = ("--set", "reading=hold", "--set", "hold_times=[100]") if stuck else ()
    assert house.lab(tmp_path, "bending", *BENDING, *held) == 1
    assert says in capsys.readouterr().err
    assert all(abs((row.vacuum or 0.0) - PLANNED) < 11e3 for row in table_of(recorded(tmp_path)))


def test_a_spine_without_vacuum_is_read_as_planned(house: House, tmp_path: Path) -> None:
    recording = house.completed(tmp_path, "bending", *BENDING, "--set", "vacuums=[0]")
    assert len(table_of(recording)) == 5 and not house.fakes.troubles


@pytest.mark.parametrize("frozen", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_stiffness_trial_whose_spine_goes_soft_begins_again(house: House, tmp_path: Path, frozen: bool) -> None:
    fakes = house.fakes
    fakes.on_confirm = lambda trouble: put_right(house)
    spoil = lose if frozen else lambda house: vacuum(house, 0.0)
    during(lambda: abs(fakes.plant.probe_force).max() > 2.2, lambda: spoil(house))  # on the way from the first step to the second
    recording = house.completed(tmp_path, "stiffness", *STIFFNESS)
    assert fakes.troubles and ("soft although the gauge" in fakes.troubles[0]) == frozen
    table = table_of(recording)
    assert [row.step for row in table] == [1, 2, 3] and not table.doubtful.any()
    slope = np.polyfit(table["deflection"], table["force"], 1)[0]
    assert slope == pytest.approx(2200, rel=0.15)
    assert bool(recording.marks) == frozen


def test_the_shape_tells_that_the_spine_went_soft_where_the_gauge_does_not(house: House, tmp_path: Path) -> None:
    fakes = house.fakes
    fakes.on_confirm = lambda trouble: put_right(house)
    during(lambda: fakes.plant.valve_on and float(fakes.plant.regulator.max()) > 100e3, lambda: lose(house))
    recording = house.completed(tmp_path, "bending", *BENDING, "--set", "spine_lengths=[0.25]")
    assert any("soft although the gauge" in trouble for trouble in fakes.troubles)
    table = table_of(recording)
    assert [row.step for row in table] == [1, 2, 3, 4, 5] and recording.marks and not table.doubtful.any()
    assert table["x"][3] == pytest.approx(table["x"][1], abs=3e-3)


def test_a_spine_that_stays_soft_marks_its_trial(house: House, tmp_path: Path) -> None:
    fakes = house.fakes

    def each_time() -> None:
        if until(lambda: fakes.plant.valve_on and float(fakes.plant.regulator.max()) > 100e3, 60.0):
            lose(house)

    def again(trouble: str) -> None:
        put_right(house)
        during(lambda: float(fakes.plant.regulator.max()) < 1e3, each_time)

    fakes.on_confirm = again
    during(lambda: True, each_time)
    settings = (*BENDING, "--set", "spine_lengths=[0.25]")
    # with a gauge that has frozen the vacuum's release is not confirmed
    assert house.lab(tmp_path, "bending", *settings) == 1
    assert set(table_of(recorded(tmp_path))["doubt"]) == {"soft"}
