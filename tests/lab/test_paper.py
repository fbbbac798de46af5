"""`lab paper`: the published numbers reproduced, and what it says of them, against values worked out independently."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from commands import Cli

from lab.console import PlainConsole
from lab.files.example import paper_robot
from lab.paper.area import READINGS, AreaFindings, area_findings
from lab.paper.moduli import modulus_forms
from lab.verbs.paper import PaperReport, bending_states, run
from model.robot import load_robot

pytestmark = pytest.mark.usefixtures("drawn")

ROBOT = load_robot(paper_robot())


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> PaperReport:
    return run(tmp_path_factory.mktemp("paper") / "new" / "folder")


@pytest.fixture(scope="module")
def area() -> AreaFindings:
    return area_findings(ROBOT, bending_states(ROBOT))


# ------------------------------------------------------------------ the verb
def test_figures_are_pictures_of_some_size_and_the_json_holds_the_numbers_of_the_report(report: PaperReport) -> None:
    assert len(report.figures) == 7 and len([p for p in report.figures if p.match("finding_*.png")]) == 3
    for path in report.figures:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000
    data = json.loads(report.figures[0].with_name("paper.json").read_text())
    assert data["schema"] == "paper/1" and set(data["findings"]) == {"modulus", "area_factor", "euler_step"}
    np.testing.assert_array_equal(data["tips_converged"], report.converged)
    assert [Path(p).name for p in data["figures"]] == [p.name for p in report.figures]


def test_the_tables_show_each_spine_length_with_published_and_computed_error(report: PaperReport) -> None:
    text = io.StringIO()
    report.print(PlainConsole(file=text, width=140))
    shown = text.getvalue()
    assert "239.5, 322.9" in shown and "13.2" in shown and "6.11" in shown
    assert all(f"{i}. " in shown for i in (1, 2, 3)) and "leave one out" in shown


def test_as_json_the_verb_prints_json_alone(report: PaperReport, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    monkeypatch.setattr("lab.verbs.paper.run", lambda *_, **__: report)
    assert cli("paper", "--out", report.figures[0].parent, "--json").json["euler_steps"] == 100
    assert "Model tips of Fig. 5" in cli("paper", "--out", report.figures[0].parent).out


def test_the_converged_tips_are_the_known_ones_and_end_the_backbones(report: PaperReport) -> None:
    np.testing.assert_allclose(report.converged[0, -1], [-0.239509465, 0, 0.322875895], atol=2e-9)
    np.testing.assert_allclose(report.shapes[:, -1], report.converged[:, -1], atol=1e-9)


def test_the_integrators_own_error_is_a_visible_part_of_the_published_one(report: PaperReport) -> None:
    rows = report.integrator.rows
    assert rows[0].worst == pytest.approx(6.11e-3, rel=1e-3)
    share = np.array([row.mean_abs_x for row in rows]) / report.published_error[:, 0]
    assert (share > 0.05).all() and (share < 0.3).all()
    assert max(row.worst for row in report.integrator_fine.rows) < 0.7e-3


def test_the_converged_rod_needs_slightly_larger_areas_for_the_same_curves(report: PaperReport) -> None:
    np.testing.assert_array_equal(report.published_factor, [1.5, 1.5, 1.7, 1.9, 2.0, 2.15, 2.4])
    excess = report.converged_factor / report.published_factor
    assert (excess > 1.0).all() and (excess < 1.02).all()


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
