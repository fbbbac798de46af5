"""A state of a jammed spine counts only if the spine kept its vacuum, or pushes back where the gauge does not tell."""

from pathlib import Path

import numpy as np
import pytest
from house import BENDING, STIFFNESS, House, during, recorded, until

from recordings.campaign.replay import table_of

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
