"""A robot fitted with its effect: what is written, that every reader takes it, and that a diagnosis goes on from there."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from diagnosis.errors import BadCase
from diagnosis.fit_effects import Fitted, fit_effects
from lab.cli import main
from lab.comparison import comparison
from lab.files.config import load
from lab.files.inputs import Case
from lab.files.robot_file import write_robot
from lab.verbs.fit import residual_lines
from model.effects import CATALOGUE
from model.errors import BadEffect
from model.prediction import Predictor
from model.robot import Robot
from recordings.trials import Table
from tests.diagnosis.small_campaigns import FEW, SOME, answer, campaign, measured, moved_by, quick
from tests.diagnosis.test_case import ROBOT, Measured, case, sweep
from tests.diagnosis.test_edits import FINGER, read
from tests.lab.diagnosed_case import campaign as bending
from tests.lab.diagnosed_case import folder
from tests.simulated.bench import raises

ANGLE = np.radians(8)


@pytest.fixture(scope="module", name="campaign")
def that_of_answer() -> Measured:
    return campaign()


@pytest.fixture(scope="module")
def fitted(campaign: Measured) -> Fitted:
    return fit_effects(campaign, ["chamber_azimuth"])


def test_the_size_that_was_withheld_is_found_within_its_uncertainty(fitted: Fitted) -> None:
    angle = fitted.parameters["chamber_azimuth.angle"]
    assert angle.unit == "rad" and abs(angle.value - ANGLE) < 4 * angle.sd and angle.sd < 0.02
    assert fitted.left_mm < 0.3 * fitted.calibrated_mm
    posterior = fitted.robot.posterior
    assert posterior is not None and posterior.parameters[:2] == ("area_factor", "chamber_azimuth.angle")
    assert 0.2e-3 < posterior.noise.floor < 1e-3
    assert set(fitted.robot.tolerances) >= {"tilt", "frame_turn", "frame_shift", "length", "youngs_modulus", "density"}


def test_robot_yaml_reads_back_and_compares_as_the_fit_said(fitted: Fitted, campaign: Measured, tmp_path: Path) -> None:
    path = write_robot(fitted.robot, tmp_path / "robot.yaml")
    assert "angle: {value: " in path.read_text() and load(path, Robot) == fitted.robot
    found = comparison(Case(fitted.robot, campaign.table))
    assert 1e3 * found.table.rmse == pytest.approx(fitted.left_mm, rel=1e-3)


def test_the_other_kind_of_thrust_is_named_where_with_it_alone_the_model_is_near() -> None:
    on_walls = measured(1, 3, FEW, chamber_thrust__share=1.0)
    for stated, other, words in ((None, "walls", 1), ("cap", "walls", 1), ("walls", "cap", 0)):
        notes = comparison(Case(ROBOT.replace(thrust=stated), on_walls.table)).notes
        assert sum(f"write `thrust: {other}` in robot.yaml" in note for note in notes) == words, notes


def test_an_effect_in_robot_yaml_is_part_of_the_baseline_that_is_diagnosed(fitted: Fitted, campaign: Measured) -> None:
    some = {e: CATALOGUE[e] for e in ("chamber_azimuth", "base_tilt", "precurvature", "pressure_offset")}
    before, after = answer(SOME), diagnose(Case(fitted.robot, campaign.table), quick(some))
    assert before.attribute.effects == ("chamber_azimuth",)
    assert before.calibration is not None
    assert before.calibration.area_factor == pytest.approx(fitted.parameters["area_factor"].value, rel=1e-3)
    assert after.attribute.verdict == "none" and after.locate.gap_rmse_mm < 0.3 * before.locate.gap_rmse_mm


def test_a_diagnosis_quotes_the_robot_that_the_fit_writes(fitted: Fitted, campaign: Measured) -> None:
    found = answer(SOME)
    robot = found.fitted
    assert robot is not None and robot.left_mm == pytest.approx(fitted.left_mm, rel=0.05)
    for said in ("cause, and other effects within their tolerances, ", "no other effect, one area", "as `lab fit --with` does"):
        assert said in found.statement
    assert f"misses the tip by {robot.left_mm:.2f} mm (in-sample" in found.statement
    (angle,) = [r.parameters["chamber_azimuth.angle"] for r in found.attribute.ranking if r.effects == ("chamber_azimuth",)]
    assert angle.value == robot.parameters["chamber_azimuth.angle"].value
    assert angle.value == pytest.approx(fitted.parameters["chamber_azimuth.angle"].value, rel=0.02)
    start = {name: v.value for name, v in robot.parameters.items()} | {"chamber_azimuth.angle": -0.4}
    assert fit_effects(campaign, ["chamber_azimuth"], start=start).left_mm == pytest.approx(fitted.left_mm, rel=0.02)


def test_fitting_again_begins_without_what_is_fitted(fitted: Fitted, campaign: Measured) -> None:
    again = fit_effects(Case(fitted.robot, campaign.table), ["chamber_azimuth"])
    angle, first = (f.parameters["chamber_azimuth.angle"] for f in (again, fitted))
    assert angle.value == pytest.approx(first.value, abs=0.2 * first.sd)
    none = fit_effects(Case(fitted.robot, campaign.table), [])
    assert none.robot.effects == fitted.robot.effects and none.left_mm < 0.3 * fitted.calibrated_mm


def test_what_the_data_say_nothing_of_is_undetermined_and_leaves_no_more(fitted: Fitted, campaign: Measured) -> None:
    assert all(p.determined for p in fitted.parameters.values())
    found = fit_effects(campaign, ["chamber_azimuth", "viscoelastic"])
    assert not found.parameters["viscoelastic.spine"].determined and found.parameters["chamber_azimuth.angle"].determined
    absent = fit_effects(campaign, ["spine_slip"])
    assert absent.left_mm <= 1.001 * absent.calibrated_mm
    worse = " ".join(residual_lines(replace(absent, left_mm=2.21, calibrated_mm=1.79)))
    assert "1.79 mm rms with area factor and set-up fitted, 2.21 mm with the effects, which is larger: spine_slip does" in worse
    alone = " ".join(residual_lines(replace(absent, effects=(), left_mm=2.21, calibrated_mm=1.79)))
    assert "2.21 mm rms with area factor and set-up fitted;" in alone.replace(" noise floor", ";") and "larger" not in alone


def test_a_fit_ends_at_the_same_numbers_from_its_own_starts_and_from_those_of_an_answer() -> None:
    case = Measured(ROBOT.replace(thrust="cap"), Table.of(bending({"chamber_ballooning.growth": 0.3}, 2, 2, (0.0, 0.1, 0.2))))
    found = fit_effects(case, ["chamber_ballooning"]).parameters
    again = fit_effects(case, ["chamber_ballooning"], start={name: p.value for name, p in found.items()}).parameters
    assert all(again[name].value == pytest.approx(p.value, abs=0.01 * p.sd) for name, p in found.items())


def test_a_cable_that_pulls_many_times_harder_than_is_plausible_has_its_size_and_leaves_none_of_it_to_the_area() -> None:
    pulls = {"x": 1.5, "y": -0.6, "spring": 25.0}
    fitted = fit_effects(measured(2, 1, (0.0,), **{f"tether_load__{k}": v for k, v in pulls.items()}), ["tether_load"])
    for name, value in pulls.items():
        found = fitted.parameters[f"tether_load.{name}"]
        assert found.determined and abs(found.value - value) < 2 * found.sd, found


@pytest.mark.parametrize(
    ("stated", "share", "azimuth", "distance"),
    [({}, 1.0, 200.0, 0.025), ({"gravity": (0.0, -9.81, 0.0), "tip_mass": 0.2}, 0.35, 180.0, -0.06)],  # hangs; lies and sags
)
def test_an_obstacle_is_found_on_a_side_that_robot_yaml_does_not_state(
    stated: dict[str, Any], share: float, azimuth: float, distance: float
) -> None:
    groups = [
        replace(r, trial=r.trial + 9 * k, t=r.t + 1e4 * k, pressures=tuple((share * np.roll(r.pressures, 3 * k)).tolist()))
        for k in range(3)
        for r in sweep(2, (0.0, 0.15))
    ]
    acting, robot = {"contact__stiffness": 150.0, "contact__distance": distance}, ROBOT.replace(**stated)
    touching = replace(moved_by(groups, 3, robot.replace(obstacle_azimuth_deg=azimuth), **acting), robot=robot)
    found = diagnose(touching, quick({e: CATALOGUE[e] for e in ("contact", "body_modulus", "tip_payload", "base_tilt")}))
    assert found.attribute.effects == ("contact",) and found.attribute.probability > 0.9
    (stands,) = [f for f in found.findings if f.code == "obstacle_stands"]
    assert stands.values["azimuth"] == pytest.approx(azimuth, abs=3.0)
    assert stands.values["mm"] == pytest.approx(1e3 * (0.175 * ROBOT.length + distance), abs=10.0)


def test_each_axis_has_the_noise_that_its_repeats_show(campaign: Measured) -> None:
    noisy = campaign.table["y"] + 1.5e-3 * np.random.default_rng(4).normal(size=len(campaign.table))
    robot = fit_effects(Case(campaign.robot, campaign.table.replaced({"y": noisy})), ["chamber_azimuth"]).robot
    assert robot.posterior is not None and robot.posterior.noise.reading_by_axis is not None
    x, y, z = robot.posterior.noise.reading_by_axis
    assert 1.2e-3 < y < 1.8e-3 and max(x, z) < 0.5 * y
    found = Predictor(robot, cores=1)([[60e3] * 3 + [0.0] * 6], intervals=True)
    assert found.sd is not None and found.model_sd is not None
    np.testing.assert_allclose(found.sd**2 - found.model_sd**2, [[x**2, y**2, z**2]])


def test_what_cannot_be_fitted_is_refused(campaign: Measured) -> None:
    raises(BadEffect, "did you mean chamber_azimuth", fit_effects, campaign, ["chamber_azimut"])
    raises(BadCase, None, fit_effects, case([]), ["chamber_azimuth"])


def test_a_fit_states_the_error_of_each_marker_that_it_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = FINGER.model_copy(update={"markers": (0.4 * FINGER.length, 0.7 * FINGER.length)})
    table = read(robot)
    moved = table.replaced({"m2x": table["m2x"] + 5e-3 * (table["trial"] % 2)})
    assert main(["fit", str(folder(tmp_path / "case", moved, write_robot(robot, tmp_path / "robot.yaml"))), "--set-up"]) == 0
    first, second = re.findall(r"marker \d, which the fit used too: ([\d.]+) mm rms", capsys.readouterr().out)
    assert float(second) > 2 * float(first) > 0
