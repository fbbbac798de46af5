"""What `lab paper` says of the paper's published numbers, against values worked out independently."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lab.files.example import paper_robot
from lab.paper.area import READINGS, AreaFindings, area_findings
from lab.paper.moduli import modulus_forms
from lab.verbs.paper import PaperReport, bending_states, main, reproduce
from model.robot import load_robot

pytestmark = pytest.mark.usefixtures("drawn")

ROBOT = load_robot(paper_robot())


@pytest.fixture(scope="module")
def area() -> AreaFindings:
    return area_findings(ROBOT, bending_states(ROBOT))


@pytest.fixture(scope="module")
def report() -> PaperReport:
    return reproduce(ROBOT)


# ------------------------------------------------------------------ Table II
def test_table_two_is_shear_like_to_six_percent_and_constant_to_ninety() -> None:
    assert ROBOT.spine is not None
    found = modulus_forms(ROBOT.spine.modulus, ROBOT.spine.radius)
    shear = found.fit("shear-like")
    assert shear.values == pytest.approx((6.60, 0.0070), rel=0.01)
    assert shear.log_rms == pytest.approx(0.061, abs=0.001) and shear.leave_one_out == pytest.approx(0.097, abs=0.001)
    assert shear.aicc == pytest.approx(-15.6, abs=0.1)
    rms = {f.law.name: f.log_rms for f in found.fits}
    assert rms["constant"] == pytest.approx(0.89, abs=0.01) and rms["root rotation"] == pytest.approx(0.31, abs=0.01)
    assert rms["root translation"] == pytest.approx(0.15, abs=0.01) and rms["affine"] == pytest.approx(0.053, abs=0.001)
    assert min(found.fits, key=lambda f: f.leave_one_out) is shear


def test_what_stays_tied_is_named_with_its_implied_shear_modulus() -> None:
    assert ROBOT.spine is not None
    found = modulus_forms(ROBOT.spine.modulus, ROBOT.spine.radius)
    assert found.tied == ("affine",)
    assert 0.05 < found.shear_modulus < 0.101
    assert found.fit("affine").shortest == pytest.approx(0.032, abs=0.001)
    text = " ".join(found.sentences())
    assert "Not settled" in text and "clamped at spans" in text and "factor 14" in text


@pytest.mark.parametrize("name, form", [
    ("shear-like", lambda x: 1 / (1 / 6.0 + 0.005 / x**2)), ("root rotation", lambda x: 1 / (1 / 6.0 + 0.05 / x)),
    ("affine", lambda x: 1.0 + 9.0 * x), ("dead length", lambda x: 5.0 * (1 - 0.02 / x) ** 3),
])  # fmt: skip
def test_a_table_made_by_one_form_is_given_back_to_it(name: str, form: object) -> None:
    x = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3])
    found = modulus_forms(dict(zip(x.tolist(), (1e6 * form(x)).tolist(), strict=True)), 0.029)  # type: ignore[operator]
    assert found.fit(name).log_rms < 1e-6
    assert min(found.fits, key=lambda f: f.leave_one_out).law.name in (name, "shear and root rotation")


def test_too_few_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 5"):
        modulus_forms({0.1: 1e6, 0.2: 2e6}, 0.029)


# ------------------------------------------------------------------ A_eff
def test_volume_mixing_makes_most_of_the_growth_of_the_area_under_both_readings(area: AreaFindings) -> None:
    ratio, slope = area.growth(area.published)
    assert ratio == pytest.approx(1.60) and slope == pytest.approx(0.307, abs=0.001)
    for reading in area.readings:
        after_ratio, after_slope = area.growth(reading.needed)
        assert after_ratio < 1.2 and after_slope < 0.3 * slope
        assert reading.rms_area < 0.45 * reading.rms_volume
        assert reading.rms_credit < reading.rms_area
        assert 0.3 < reading.credit < 0.45
    assert area.predicted_credit == pytest.approx(0.38, abs=0.005)


def test_the_millimetres_depend_on_the_reading_of_the_pressure_load(area: AreaFindings) -> None:
    printed, moment = area.readings
    assert (printed.name, moment.name) == READINGS
    assert printed.rms_volume == pytest.approx(30.7e-3, abs=0.1e-3) and printed.rms_area == pytest.approx(12.7e-3, abs=0.1e-3)
    assert moment.rms_volume == pytest.approx(7.3e-3, abs=0.3e-3) and moment.rms_area < 3e-3
    text = " ".join(area.sentences())
    assert "Robust" in text and text.count("Depends on the reading") == 2 and "not its cause" in text


def test_without_spine_both_ways_of_mixing_are_the_same(area: AreaFindings) -> None:
    assert area.stiffness_ratio[0] == 1.0 and all(r.needed[0] == pytest.approx(1.5, abs=1e-4) for r in area.readings)
    assert area.stiffness_ratio[1] < 1 < area.stiffness_ratio[2]


# ------------------------------------------------------------------ Table III
def test_the_step_s_own_error_is_a_part_of_the_published_one(report: PaperReport) -> None:
    step = report.findings.step
    assert step.worst == pytest.approx(max(r.worst for r in report.integrator.rows))
    assert (step.share > 0).all() and (step.share < 0.5).all()
    assert step.after_calibration.max() < 2e-3 < step.worst


def test_the_verb_prints_and_writes_all_three(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(tmp_path, as_json=False) == 0
    shown = capsys.readouterr().out
    assert all(f"{i}. " in shown for i in (1, 2, 3)) and "leave one out" in shown
    said = json.loads((tmp_path / "paper.json").read_text())["findings"]
    assert set(said) == {"modulus", "area_factor", "euler_step"}
    assert len(list(tmp_path.glob("finding_*.png"))) == 3
