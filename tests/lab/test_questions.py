"""Numbers that hint at a wrong unit are asked about, and a gauge that has frozen is told from one that is at rest."""

import numpy as np
import pandas
import pytest

import lab
from diagnosis.answer.sentences import far_off
from diagnosis.diagnose import Options
from lab.files.robot_file import paper_robot
from lab.files.robot_numbers import doubtful_numbers, doubts
from lab.rig.watch import STUCK, Repeats
from lab.verbs.compare import thrust_taken
from model.actuators import Chambers
from model.effects import CATALOGUE
from model.prediction import Predictor
from model.robot import load_robot
from recordings.trials import Table
from tests.diagnosis.test_edits import TENDON_ARM

# ------------------------------------------------------------------ robot.yaml
ARM = TENDON_ARM.replace(tip_mass=0.0)


def test_disks_that_stand_out_are_no_news_and_a_path_radius_in_another_unit_is() -> None:
    assert not list(doubtful_numbers(ARM))
    rod = {"outer_radius": 0.001, "youngs_modulus": 40e9, "shear_modulus": 5e9, "bending_stiffness": 0.03}
    assert not list(doubtful_numbers(ARM.replace(**rod)))
    (said,) = doubtful_numbers(ARM.replace(bending_stiffness=9164.0))
    assert "9164 N m^2, 1e+06 times" in said and "in N mm^2, divide by 1e6" in said
    (said,) = doubtful_numbers(ARM.replace(posterior={"parameters": ["area_factor", "tilt.x"], "correlation": [[1], [0, 1]],
                                                      "area_factor_sd": 0.1}))  # fmt: skip
    assert said == "posterior: tilt.x not stated in effects or tolerances, and ignored"
    (said,) = doubtful_numbers(ARM.replace(tendons={"path_radius": 0.11, "azimuths_deg": [0.0, 90.0]}))
    assert said.startswith("tendons.path_radius is 110 mm") and "outer_radius of 6 mm" in said


def test_a_cap_inside_a_body_that_others_bend_is_named_with_what_takes_the_thrust() -> None:
    robot = load_robot(paper_robot())
    early = robot.replace(chambers={**robot.chambers.model_dump(), "ends": [0.2, 0.4, 0.37] * 3}, thrust="cap")
    (said,) = doubtful_numbers(early)
    assert said.startswith("chambers.ends: chambers 1, 4, 7 from 200 mm, more than an outer radius (50 mm) before")
    assert thrust_taken(early) == ", thrust: cap, walls of chambers 1, 4, 7"
    walls = early.replace(thrust="walls")
    assert not [*doubtful_numbers(walls)] and thrust_taken(walls) == ", thrust: walls"


@pytest.mark.parametrize(("shear", "asked"), [(9e6, True), (3e6, False), (4.5e6, False), (2e6, True)])
def test_a_shear_modulus_that_no_material_has_is_asked_about(shear: float, asked: bool) -> None:
    said = list(doubtful_numbers(ARM.replace(shear_modulus=shear)))
    assert bool(said) == asked and all("Poisson" in text and "youngs_modulus 9 MPa" in text and "3 MPa" in text for text in said)


@pytest.mark.parametrize(
    ("stiffness", "says"),
    [(10.4, "pressures (mbar and kPa differ by 10)"), (0.1, "0.1 times as stiff"), (6.8, "psi and kPa differ by 6.895"),
     (1 / 6.9, "psi"), (2.9, ""), (0.3, ""), (8.4, "kPa differ by 10, psi and kPa differ"), (30.0, "pressures; until")],
)  # fmt: skip
def test_a_body_as_stiff_as_no_tolerance_makes_it_is_asked_about(stiffness: float, says: str) -> None:
    said = " ".join(f.text for f in far_off(stiffness, Chambers.words))
    assert says in said and bool(said) == bool(says)
    assert not said or all(word in said for word in ("youngs_modulus", "outer_radius", "path_radius", "unit of the pressures"))


def test_a_density_in_grams_and_a_tip_mass_in_grams_are_asked_about() -> None:
    (said,) = doubtful_numbers(ARM.replace(density=1.1))
    assert "density is 1.1 kg/m^3" in said and "multiply by 1000" in said
    (said,) = doubtful_numbers(ARM.replace(tip_mass=20.0))
    assert "tip_mass is 20 kg" in said and "divide by 1000" in said
    assert not list(doubtful_numbers(ARM.replace(tip_mass=0.2, density=0.0)))


def test_a_column_of_masses_that_replaces_a_larger_one_of_the_robot_is_asked_about() -> None:
    masses = Table({"trial": np.array([1, 2]), "p1": np.zeros(2), "tip_mass": np.array([0.0, 0.05])})
    (said,) = doubts(ARM.replace(tip_mass=0.022), masses, "robot.yaml")
    assert said.startswith("column tip_mass (0 to 50 g) replaces the tip_mass of 22 g of robot.yaml: does it include them?")
    assert not doubts(ARM, masses, "robot.yaml")
    pushed = masses.replaced({"protocol": np.array(["stiffness", "bending"]), "tip_mass": np.array([0.0, 0.022])})
    assert not doubts(ARM.replace(tip_mass=0.022), pushed, "robot.yaml")


def test_the_diagnosis_asks_about_tensions_that_are_ten_times_too_large() -> None:
    robot, noise = ARM, 0.1e-3 * np.random.default_rng(8).normal(size=(32, 3))
    pulls = np.array([p for k in range(4) for p in np.outer((0.0, 4e3, 8e3, 12e3), np.eye(4)[k])] * 2)
    frame = pandas.DataFrame(10 * pulls, columns=["p1", "p2", "p3", "p4"])
    frame[["x", "y", "z"]] = Predictor(robot)(pulls).tip + noise
    with pytest.warns(match="the tip moves 0.1 times as far as robot.yaml predicts for these tensions: check the unit"):
        case = lab.case(frame.assign(t=9.0 * np.arange(32), trial=1 + np.arange(32) // 4), robot)
    answer = lab.diagnose(case, Options(quantify=False, experiments=False, catalogue={"base_tilt": CATALOGUE["base_tilt"]}))
    (said,) = (c for c in answer.concerns if "times as stiff as" in c)
    assert "unit of the tensions" in said


# ------------------------------------------------------------------ a frozen gauge and one at rest
POLL = 0.05


def stuck(noise: float, digit: float, frozen: bool, seed: int = 0, level: float = 21_330.0) -> float:
    """The longest that is said of a gauge which shows 30 s of noise (Pa) in digits (Pa), and then perhaps freezes for 3 s."""
    random, repeats, longest = np.random.default_rng(seed), Repeats(), 0.0
    shown = level
    for k in range(660):
        if not frozen or k < 600:
            shown = float(np.rint((level + noise * random.normal()) / digit) * digit)
        repeats.take(shown, k * POLL)
        longest = max(longest, repeats.stuck)
    return longest


@pytest.mark.parametrize(("noise", "digit"), [(107.0, 10.0), (30.0, 10.0), (500.0, 100.0)])
def test_a_noisy_gauge_that_repeats_itself_is_frozen(noise: float, digit: float) -> None:
    assert stuck(noise, digit, True) > STUCK
    assert stuck(noise, digit, False) == 0.0


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.5])
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 0.5, 1.0, 2.0])
def test_a_gauge_of_coarse_resolution_is_no_frozen_one(noise: float, offset: float) -> None:
    for seed in range(20):
        assert stuck(100.0 * noise, 100.0, False, seed, 21_300.0 + 100.0 * offset) <= STUCK


def test_a_pressure_that_changes_and_then_rests_is_no_frozen_gauge() -> None:
    repeats = Repeats()
    for k in range(60):
        repeats.take(100e3 - 1e3 * k, k * POLL)
    for k in range(60, 200):
        repeats.take(40e3, k * POLL)
        assert repeats.stuck == 0.0


def test_what_was_before_a_pause_is_forgotten() -> None:
    random, repeats = np.random.default_rng(1), Repeats()
    for k in range(40):
        repeats.take(float(np.rint(21e3 + 100 * random.normal())), k * POLL)
    repeats.forget()
    for k in range(40, 80):
        repeats.take(21e3, k * POLL)
        assert repeats.stuck == 0.0
