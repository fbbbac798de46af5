"""The paper reproduced: its published numbers, and what the script says of them, against values worked out independently."""

import json
from pathlib import Path

import numpy as np
import pytest

from examples.paper import reproduce
from examples.paper.reproduce import PUBLISHED, ROBOT, SPINE_LENGTHS, Area, Curves, added_bending, mixed_bending, modulus_forms

MODULI = ROBOT.spine.modulus if ROBOT.spine else {}


@pytest.fixture(scope="module")
def curves() -> Curves:
    return reproduce.curves()


@pytest.fixture(scope="module")
def areas() -> dict[str, Area]:
    return reproduce.area_by_reading()


def test_tables_are_printed_figures_drawn_and_all_numbers_written(
    curves: Curves, areas: dict[str, Area], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(reproduce, "curves", lambda: curves)
    monkeypatch.setattr(reproduce, "area_by_reading", lambda: areas)
    reproduce.main(tmp_path / "new" / "folder")
    shown = capsys.readouterr().out
    for words in ("extends less with 20 cm, 25 cm, 30 cm only", "0.02 to 0.20 MPa at 30 cm", "3.3% in X; in Y 4.4 mm, 1.10%",
                  "239.5, 322.9", "13.20", "6.11", "left_out"):  # fmt: skip
        assert words in shown
    pictures = [Path(line) for line in shown.splitlines() if line.endswith(".png")]
    assert len(pictures) == 6
    for path in pictures:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000
    data = json.loads((tmp_path / "new" / "folder" / "paper.json").read_text())
    np.testing.assert_array_equal(data["converged"], curves.converged)
    assert [f["form"] for f in data["modulus_forms"]][0] == "shear-like" and len(data["area_factor"]) == 2


def test_the_converged_tips_are_the_known_ones_and_end_the_backbones(curves: Curves) -> None:
    np.testing.assert_allclose(curves.converged[0, -1], [-0.239509465, 0, 0.322875895], atol=2e-9)
    np.testing.assert_allclose(curves.backbones[:, -1], curves.converged[:, -1], atol=1e-9)


def test_the_integrators_own_error_is_a_visible_part_of_the_published_one(curves: Curves) -> None:
    assert curves.worst[0] == pytest.approx(6.11e-3, rel=1e-3) and curves.worst_fine < 0.7e-3
    share = curves.integrator / PUBLISHED
    assert (share[:, 0] > 0.05).all() and (share[:, 0] < 0.3).all() and (share[:, 1] < 0.5).all()
    assert curves.after_calibration.max() < 2e-3 < curves.worst.max()


def test_the_converged_rod_needs_slightly_larger_areas_for_the_same_curves(curves: Curves) -> None:
    excess = curves.factor / ROBOT.area_factor_at(SPINE_LENGTHS)
    assert (excess > 1.0).all() and (excess < 1.02).all()


def test_nine_chambers_lengthen_the_calibrated_model_most_with_a_spine_of_10_cm() -> None:
    assert 1e3 * reproduce.elongation()[:, -1] == pytest.approx([24.1, 24.5, 24.9, 24.7, 22.0, 19.8, 17.7], abs=0.06)


# ------------------------------------------------------------------ Table II
def test_weight_adds_to_the_modulus_of_a_hanging_beam_what_its_tension_does() -> None:
    length, radius, density, x = 0.3, 0.029, 700.0, np.linspace(0, 0.3, 4001)
    slope = (6 * length * x - 3 * x**2) / (2 * length**3)  # of the deflection of a unit load at the tip, which moves by 1
    tension = density * 9.81 * np.pi * radius**2 * (length - x)
    added = np.trapezoid(tension * slope**2, x) * length**3 / (3 * np.pi / 4 * radius**4)
    assert reproduce.of_weight(density, length, radius) == pytest.approx(added, rel=1e-4)


def test_table_two_is_shear_like_to_six_percent_and_constant_to_ninety() -> None:
    found = {f.form: f for f in modulus_forms(MODULI)}
    shear = found["shear-like"]
    assert shear.parameters == pytest.approx((6.60, 0.0070), rel=0.01)
    assert shear.log_rms == pytest.approx(0.061, abs=0.001) and shear.left_out == pytest.approx(0.097, abs=0.001)
    assert shear.aicc == pytest.approx(-15.6, abs=0.1)
    assert found["constant"].log_rms == pytest.approx(0.89, abs=0.01)
    assert found["root rotation"].log_rms == pytest.approx(0.31, abs=0.01)
    assert found["root translation"].log_rms == pytest.approx(0.15, abs=0.01)
    assert found["affine"].log_rms == pytest.approx(0.053, abs=0.001)
    assert found["affine"].parameters[1] == pytest.approx(0.032, abs=0.001)
    assert [f.form for f in found.values() if f.aicc < shear.aicc + 2] == ["shear-like", "affine"]


@pytest.mark.parametrize("name, form", [
    ("shear-like", lambda x: 1 / (1 / 6.0 + 0.005 / x**2)), ("root rotation", lambda x: 1 / (1 / 6.0 + 0.05 / x)),
    ("affine", lambda x: 9.0 * (x - 0.03)), ("dead length", lambda x: 5.0 * (1 - 0.02 / x) ** 3),
])  # fmt: skip
def test_a_table_made_by_one_form_is_given_back_to_it(name: str, form: object) -> None:
    x = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3])
    found = modulus_forms(dict(zip(x.tolist(), (1e6 * form(x)).tolist(), strict=True)))  # type: ignore[operator]
    assert {f.form: f.log_rms for f in found}[name] < 1e-6
    assert found[0].form in (name, "shear and root rotation")


def test_too_few_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 5"):
        modulus_forms({0.1: 1e6, 0.2: 2e6})


# ------------------------------------------------------------------ A_eff
def test_volume_mixing_makes_most_of_the_growth_of_the_area_under_both_readings(areas: dict[str, Area]) -> None:
    def slope(factors: np.ndarray) -> float:
        return float(np.polyfit(SPINE_LENGTHS, factors, 1)[0])

    for a in areas.values():
        assert a.needed.max() / a.needed.min() < 1.2 and slope(a.needed) < 0.3 * slope(ROBOT.area_factor_at(SPINE_LENGTHS))
        assert a.rms_added < 0.45 * a.rms_volume and a.rms_share < a.rms_added
        assert 0.3 < a.share < 0.45 and a.needed[0] == pytest.approx(1.5, abs=1e-4)


def test_the_millimetres_depend_on_the_reading_of_the_pressure_load(areas: dict[str, Area]) -> None:
    printed, moment = areas.values()
    assert printed.rms_volume == pytest.approx(30.7e-3, abs=0.1e-3) and printed.rms_added == pytest.approx(12.7e-3, abs=0.1e-3)
    assert moment.rms_volume == pytest.approx(7.3e-3, abs=0.3e-3) and moment.rms_added < 3e-3


def test_mixing_by_volume_softens_a_short_spine_and_stiffens_long_ones() -> None:
    ratio = mixed_bending(ROBOT, SPINE_LENGTHS) / added_bending(ROBOT, SPINE_LENGTHS)
    assert ratio[0] == 1.0 and ratio[1] < 1 < ratio[2]
