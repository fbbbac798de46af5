"""Bodies whose section is not the same all along, and bodies whose stiffness is given."""

from typing import Any

import numpy as np
import pytest

from model import body
from model.body import body_of
from model.condition import conditions
from model.errors import BadRobot
from model.prediction.campaign import predict_campaign
from model.prediction.predictor import Predictor
from model.robot import Robot
from model.rods import FINE, Rods, solve
from model.rotation import CONJUGATE, multiply, rotation_vector, to_base
from model.section import rods_of
from tests.model.effects.campaigns import Moved
from tests.model.rods.reference import REFERENCE

PRESSURES = np.outer([0.0, 60e3, 120e3], [0, 0, 0, 1, 1, 1, 0, 0, 0])
SPINES = np.array([0.0, 0.1, 0.25])


def tips(robot: Robot, method: Any = FINE, **more: Any) -> np.ndarray:
    """(3, 3) m, of the rods."""
    return solve(rods_of(robot, conditions(robot, SPINES, PRESSURES, **more)), method).trusted().tip


def predicted(robot: Robot, force: Any = 0.0) -> np.ndarray:
    """(3, 3) m, of the forward model of a campaign in the same states, which its predictor confirms."""
    force = np.zeros((3, 3)) + force
    columns = {"trial": np.arange(3), "spine_length": SPINES, **{c: np.zeros(3) for c in "xyz"}}
    columns |= {f"p{i + 1}": p for i, p in enumerate(PRESSURES.T)} | {
        f"force_{c}": f for c, f in zip("xyz", force.T, strict=True)
    }
    found = Moved(robot, columns, area="per_length", catalogue={}).still
    np.testing.assert_allclose(predict_campaign(robot, columns).tip, found, atol=1e-6)
    return found


def test_sections_that_are_all_alike_are_the_uniform_body(reference_robot: Robot) -> None:
    cut = reference_robot.replace(sections=[{"length": 0.1}, {"length": 0.25}, {"length": 0.05}])
    assert len(body_of(cut)) == 3
    np.testing.assert_allclose(tips(cut), tips(reference_robot), atol=2e-8)
    np.testing.assert_allclose(predicted(cut), predicted(reference_robot), atol=2e-6)


def test_a_rigid_last_section_carries_a_point_beyond_the_body(reference_robot: Robot) -> None:
    bare, rigid = reference_robot.replace(tip_mass=0.0, spine=None), {"bending_stiffness": 200.0, "mass_per_length": 0.0}
    longer = bare.replace(length=0.41, sections=[{"length": 0.4}, {"length": 0.01, "axial_stiffness": 1e6, **rigid}])
    found = solve(rods_of(bare, conditions(bare, 0.0, PRESSURES)), FINE)
    ahead = found.tip + to_base(found.orientation, np.array([0.0, 0.0, 0.01]))
    np.testing.assert_allclose(solve(rods_of(longer, conditions(longer, 0.0, PRESSURES)), FINE).tip, ahead, atol=2e-4)


def test_stiffness_and_mass_that_are_given_stand_for_radii_and_material(reference_robot: Robot) -> None:
    area = np.pi * (0.05**2 - 0.029**2)
    second = np.pi / 4 * (0.05**4 - 0.029**4)
    e = reference_robot.youngs_modulus
    given = reference_robot.replace(
        bending_stiffness=e * second, axial_stiffness=e * area, torsional_stiffness=2 * e * second,
        mass_per_length=reference_robot.density * area, outer_radius=0.06, inner_radius=0.03,
    )  # fmt: skip
    np.testing.assert_allclose(tips(given), tips(reference_robot), atol=1e-9)
    np.testing.assert_allclose(predicted(given), predicted(reference_robot), atol=1e-8)


SEGMENTED = {
    "sections": [
        {"length": 0.15, "bending_stiffness": 2.0, "mass_per_length": 6.0},
        {"length": 0.1, "youngs_modulus": 8e5, "chamber_radius": 0.004},
        {"length": 0.15, "outer_radius": (0.05, 0.045), "path_radius": (0.04, 0.038)},
    ]
}
NINE = {"path_radius": 0.04, "azimuths_deg": [40.0 * k for k in range(9)], "ends": [0.2, 0.4, 0.3] * 3}
PULLED = {"chambers": None, "area_factor": 0.9, "tendons": NINE}


@pytest.mark.parametrize("fields", [{}, SEGMENTED, PULLED], ids=["uniform", "of sections", "pulled by tendons"])
def test_the_forward_model_and_the_rods_agree_under_known_forces(reference_robot: Robot, fields: dict[str, Any]) -> None:
    robot, forces = reference_robot.replace(**fields), np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, -0.2, 0.1]])
    np.testing.assert_allclose(predicted(robot, forces), tips(robot, force=forces), atol=2e-6)
    assert np.abs(tips(robot, force=forces) - tips(robot)).max() > 3e-4
    assert not fields or np.abs(tips(robot) - tips(reference_robot)).max() > 3e-3


def test_a_mass_at_the_tip_is_a_force_along_gravity(reference_robot: Robot) -> None:
    weight = 0.1 * np.array(reference_robot.gravity)
    lifted, heavy = tips(reference_robot, tip_mass=0.0, force=weight), tips(reference_robot, tip_mass=0.1)
    np.testing.assert_allclose(lifted, heavy, atol=1e-9)


def test_a_taper_converges_with_its_pieces(reference_robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    taper = {"length": 0.4, "outer_radius": (0.05, 0.035), "inner_radius": (0.02, 0.014), "path_radius": (0.04, 0.026)}
    tapered = reference_robot.replace(sections=[taper], spine=None)
    states = conditions(tapered, 0.0, PRESSURES)
    found = solve(rods_of(tapered, states), FINE).trusted().tip
    monkeypatch.setattr(body, "PIECES", 200)
    exact = solve(rods_of(tapered, states), FINE).trusted().tip
    moved = np.linalg.norm(exact - exact[0], axis=1)
    assert np.linalg.norm(found - exact, axis=1).max() < 0.003 * moved.max()


def test_a_cantilever_of_two_sections_bends_as_beam_theory_says(reference_robot: Robot) -> None:
    soft, stiff = 0.2, 0.8
    two = reference_robot.replace(
        spine=None, gravity=[0.0, 0.0, 0.0], tip_mass=0.0,
        sections=[{"length": 0.15, "bending_stiffness": stiff}, {"length": 0.25, "bending_stiffness": soft}],
    )  # fmt: skip
    push = 1e-3
    tip = solve(rods_of(two, conditions(two, 0.0, np.zeros(9), force=[push, 0.0, 0.0])), FINE).tip[0]
    shear = 0.4 / (two.shear_modulus * np.pi * (0.05**2 - 0.029**2))
    bending = (0.4**3 - 0.25**3) / (3 * stiff) + 0.25**3 / (3 * soft)
    assert tip[0] == pytest.approx(push * (bending + shear), rel=1e-4)


FREE = {"spine": None, "gravity": [0.0, 0.0, 0.0], "tip_mass": 0.0, "area_factor": 1.0}


def ending(robot: Robot, *ends: float, **fields: Any) -> Robot:
    """Without weight and spine; `ends` (m) of the nine chambers, or of all."""
    return robot.replace(**FREE, chambers={**robot.chambers.model_dump(), "ends": ends * (9 // len(ends))}, **fields)


@pytest.mark.parametrize("thrust", ["cap", "walls"])
def test_all_chambers_stretch_a_straight_body_up_to_their_end(reference_robot: Robot, thrust: str) -> None:
    robot = ending(reference_robot, 0.3, thrust=thrust)
    found = solve(rods_of(robot, conditions(robot, 0.0, np.full(9, 60e3))), FINE).trusted().tip[0]
    push = 9 * 60e3 * robot.chambers.area
    np.testing.assert_allclose(found, [0.0, 0.0, 0.4 + 0.3 * push / (robot.youngs_modulus * body_of(robot).mean_area)], atol=1e-8)


@pytest.mark.parametrize("distances", [0.04, [0.036, 0.042, *[0.04] * 7]])
def test_a_moment_bends_the_body_to_a_circle_up_to_the_chambers_end(reference_robot: Robot, distances: Any) -> None:
    drawn = reference_robot.replace(chambers={**reference_robot.chambers.model_dump(), "path_radius": distances})
    robot = ending(drawn, 0.3, thrust="walls", axial_stiffness=1e9)
    found = solve(rods_of(robot, conditions(robot, 0.0, [90e3, *[0.0] * 8])), FINE).trusted().tip[0]
    moment = 90e3 * robot.chambers.area * np.ravel(distances)[0]
    curvature = moment / (robot.youngs_modulus * body_of(robot).mean_second)
    turn = 0.3 * curvature
    circle = [-(1 - np.cos(turn)) / curvature - 0.1 * np.sin(turn), 0.0, np.sin(turn) / curvature + 0.1 * np.cos(turn)]
    np.testing.assert_allclose(found, circle, atol=1e-6)


def test_a_force_across_a_body_that_its_walls_bend_twists_it(reference_robot: Robot) -> None:
    """F across an arc of curvature k makes the torque F k (L - s)^2 / 2 about it, and so turns the tip by F k L^3 / (6 GJ)."""
    weightless = reference_robot.replace(thrust="walls", gravity=[0.0, 0.0, 0.0], axial_stiffness=1e9)
    force, stiffness, pressures = 0.02, weightless.youngs_modulus * body_of(weightless).mean_second, [30e3, *[0.0] * 8]
    torsion = 2 * stiffness * weightless.shear_modulus / weightless.youngs_modulus
    soft, stiff = (
        solve(rods_of(robot, conditions(robot, 0.0, pressures, force=[0.0, force, 0.0])), FINE).trusted().orientation
        for robot in (weightless, weightless.replace(torsional_stiffness=1e6 * torsion))
    )
    push = 30e3 * weightless.chambers.area * float(weightless.area_factor_at([0.0])[0])
    curvature = push * weightless.chambers.path_radius / stiffness
    twist = rotation_vector(multiply(stiff * CONJUGATE, soft))[0, 2]
    assert abs(twist) == pytest.approx(force * curvature * weightless.length**3 / (6 * torsion), rel=0.02)


@pytest.mark.parametrize("path_radius", [None, [0.04, 0.036]])
def test_a_list_of_equal_distances_is_one_distance(reference_robot: Robot, path_radius: Any) -> None:
    sections = [{"length": 0.2}, {"length": 0.2, "path_radius": path_radius}]
    one = reference_robot.replace(sections=sections)
    each = one.replace(chambers={**one.chambers.model_dump(), "path_radius": [0.04] * 9})
    np.testing.assert_allclose(tips(each), tips(one), atol=1e-12)
    assert each == each.replace() != one and hash(each.chambers) == hash(each.replace().chambers)


@pytest.mark.parametrize("thrust", ["cap", "walls"])
def test_a_chamber_of_half_the_area_acts_as_half_its_pressure(reference_robot: Robot, thrust: str) -> None:
    one, halved = reference_robot.replace(thrust=thrust), [1.0, 0.5, 0.5] * 3
    radius = (0.005 * np.sqrt(halved)).tolist()
    two = one.replace(chambers={**one.chambers.model_dump(), "radius": radius})
    mean = two.replace(sections=[{"length": 0.4, "chamber_radius": float(np.sqrt(two.chambers.area / np.pi))}])
    expected = solve(rods_of(one, conditions(one, 0.0, np.multiply(PRESSURES, halved))), FINE).trusted().tip
    for robot in (two, mean):
        found = solve(rods_of(robot, conditions(robot, 0.0, PRESSURES)), FINE).trusted().tip
        np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(np.abs(two.bending_directions), np.divide(halved, np.mean(halved)))


@pytest.mark.parametrize("end", ["ends", "sections"])
def test_thrust_on_a_cap_inside_carries_the_rest_straight_on(reference_robot: Robot, end: str) -> None:
    short = ending(reference_robot, 0.3, length=0.3)
    tail = {"sections": [{"length": 0.3}, {"length": 0.1, "chamber_radius": 0.0}]}
    long = ending(reference_robot, 0.3) if end == "ends" else ending(reference_robot, 0.4, **tail)
    capped, found = (solve(rods_of(robot, conditions(robot, 0.0, PRESSURES[1:])), FINE).trusted() for robot in (short, long))
    straight_on = capped.tip + to_base(capped.orientation, np.array([0.0, 0.0, 0.1]))
    np.testing.assert_allclose(found.tip, straight_on, atol=1e-7)


@pytest.mark.parametrize("ends", [(0.3999,), (0.4, 0.4, 0.4, 0.4, 0.3999, 0.4, 0.4, 0.4, 0.4)])
def test_a_tenth_of_a_millimetre_before_the_tip_hardly_moves_it(reference_robot: Robot, ends: tuple[float, ...]) -> None:
    near, whole = (ending(reference_robot, *e, thrust="cap") for e in (ends, (0.4,)))
    tip, usual = (solve(rods_of(robot, conditions(robot, 0.0, PRESSURES)), FINE).trusted().tip for robot in (near, whole))
    np.testing.assert_allclose(tip, usual, atol=2e-4)
    assert not body_of(near).uncapped and body_of(ending(reference_robot, 0.2, 0.4, 0.4)).uncapped == [1, 4, 7]


def test_the_adaptive_method_solves_sections_alike(reference_robot: Robot) -> None:
    two = reference_robot.replace(sections=[{"length": 0.2}, {"length": 0.2, "path_radius": 0.036, "density": 900.0}])
    rods: Rods = rods_of(two, conditions(two, SPINES, PRESSURES))
    np.testing.assert_allclose(solve(rods, FINE).tip, solve(rods, REFERENCE).tip, atol=1e-7)


TENDONS = {"path_radius": 0.04, "azimuths_deg": [0.0, 120.0, 240.0]}


def test_a_tendon_bends_towards_itself_in_a_circle_and_shortens(pulled: Robot) -> None:
    light, tension = pulled.replace(gravity=[0, 0, 0], bending_stiffness=0.5, axial_stiffness=800.0, tip_mass=0.0), 3.0
    found = solve(rods_of(light, conditions(light, 0.0, [tension / 1e-4, 0.0, 0.0])), FINE, arc_lengths=[0.2, 0.4])
    curvature, stretch = tension * 0.04 / 0.5, 1 - tension / 800.0
    for s, place in zip((0.2, 0.4), found.shape[0], strict=True):
        circle = stretch / curvature * np.array([1 - np.cos(curvature * s), 0.0, np.sin(curvature * s)])
        np.testing.assert_allclose(place, circle, atol=1e-6)


@pytest.mark.parametrize("roll", [0.0, 0.7])
def test_a_marker_on_the_skin_is_on_a_circle_beside_that_of_the_axis(pulled: Robot, roll: float) -> None:
    """Of a weightless body bent by a moment M at its tip: p(s) + R(s) o with the curvature M / EI."""
    stiff = {"bending_stiffness": 0.5, "axial_stiffness": 1e9, "shear_modulus": 1e9}
    markers = [0.2, {"arc_length": 0.2, "offset": [0.036, 0.01]}]
    light = pulled.replace(gravity=[0, 0, 0], tip_mass=0.0, tip_moment=[0, 0.4, 0], markers=markers, **stiff)
    on_axis, beside = Predictor(light)(np.zeros(3), roll=roll).shape[0]
    x, y = 0.036 * np.cos(roll) - 0.01 * np.sin(roll), 0.036 * np.sin(roll) + 0.01 * np.cos(roll)
    turn = 0.2 * 0.4 / 0.5
    np.testing.assert_allclose(on_axis, 0.5 / 0.4 * np.array([1 - np.cos(turn), 0.0, np.sin(turn)]), atol=1e-9)
    np.testing.assert_allclose(beside - on_axis, [x * np.cos(turn), y, -x * np.sin(turn)], atol=1e-9)


def test_tendons_fastened_half_way_bend_the_first_half(pulled: Robot) -> None:
    ring = {"path_radius": 0.04, "azimuths_deg": [0.0, 90.0], "ends": [0.2, 0.4]}
    two = pulled.replace(gravity=[0, 0, 0], tendons=ring)
    np.testing.assert_allclose(body_of(two).chamber_area, [[-1e-4, -1e-4], [0.0, -1e-4]])
    found = solve(rods_of(two, conditions(two, 0.0, [60e3, 0.0])), FINE, arc_lengths=[0.2, 0.3, 0.4])
    first, second = np.diff(found.shape[0], axis=0)
    assert found.shape[0, 0, 0] > 1e-3 and np.linalg.norm(np.cross(first, second)) < 1e-9


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"sections": [{"length": 0.3}]}, "sections: lengths add up to 0.3 m, must be length 0.4 m"),
        ({"sections": [{"length": 0.4, "outer_radius": 0.02}]}, r"sections\[0\]: inner_radius 0.029 m"),
        ({"sections": [{"length": 0.4, "path_radius": [0.04, 0.047]}]}, r"sections\[0\]: chambers reach"),
        ({"chambers": {"radius": 0.005, "path_radius": [0.04, 0.046], "azimuths_deg": [0, 120]}}, "chambers reach from 35 to 51"),
        ({"chambers": {"radius": 0.005, "path_radius": [0.04], "azimuths_deg": [0, 120]}}, "chambers.path_radius: 1 values"),
        ({"chambers": {"radius": [0.005, 0.012], "path_radius": 0.04, "azimuths_deg": [0, 120]}}, "chambers reach from 28 to 52"),
        ({"chambers": {"radius": [0.005, 0.0], "path_radius": 0.04, "azimuths_deg": [0, 120]}}, "chambers.radius.1 = 0.0 m"),
        ({"chambers": {"radius": [0.005], "path_radius": 0.04, "azimuths_deg": [0, 120]}}, "chambers.radius: 1 values, must be"),
        ({"max_pressure": [100e3] * 8}, "max_pressure: 8 values, must be one for each of 9 azimuths_deg"),
        ({"max_pressure": [100e3] * 8 + [10.0]}, "max_pressure.8 = 10.0 Pa"),
        ({"sections": [{"length": 0.4, "inner_radius": 0.02}]}, r"sections\[0\]: spine.radius 0.029 m"),
        ({"tendons": TENDONS}, "either chambers or tendons"),
        ({"chambers": None}, "either chambers or tendons"),
        ({"chambers": None, "tendons": {**TENDONS, "ends": [0.4]}}, "tendons.ends: 1 values, must be one for each of 3"),
        ({"chambers": None, "tendons": {**TENDONS, "ends": [0.4, 0.4, 0.5]}}, "tendons.ends: 0.5 m is beyond"),
        ({"bending_stiffness": 0.0}, "bending_stiffness = 0.0 N m\\^2"),
        ({"density": 0.0, "mass_per_length": 1.0}, "mass_per_length: needs a density"),
    ],
)
def test_sections_that_do_not_fit_are_refused(reference_robot: Robot, fields: dict[str, Any], named: str) -> None:
    with pytest.raises(BadRobot, match=named):
        reference_robot.replace(**fields)
