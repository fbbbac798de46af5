"""Sensitivities against converged differences of fine solves: of the tip, of all else that a rod gives, and between its ends."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.rod_cases import LENGTH
from model.errors import BadCondition
from model.rods import FINE, Fast, Form, Rods, gauss_points, sensitivities, solve, stations
from tests.model.rods.cases import robots

Array = np.ndarray
TIGHT = Fast(divisions=16.0, close=1e-13)
FIXED = replace(TIGHT, steps=np.full((2, 2), 12))
"""Fixed, so that differences are of one smooth function."""
ARCS = np.array([0.0, 0.07, 0.16, 0.33, LENGTH])


def direction(rods: Rods, **changes: object) -> Array:
    """One direction, in which each of some fields changes by a value."""
    row = np.zeros((1, 1, rods.form.width))
    for name, value in changes.items():
        rods.form.view(row, name)[0, 0] = value
    return row


def test_each_rod_may_have_directions_of_its_own() -> None:
    rods = robots(20, np.linspace(60e3, 250e3, 20), 0.1)
    own = np.zeros((20, 1, rods.form.width))
    rods.form.view(own, "tip_force")[:, 0] = rods.field("tip_force")
    solution = solve(rods, FINE)
    found = sensitivities(rods, solution, own, FINE).tip
    shared = sensitivities(rods, solution, direction(rods, tip_force=(0.0, 0.0, 1.0)), FINE).tip
    assert np.allclose(found[:, 0], shared[:, 0] * rods.field("tip_force")[:, 2:], rtol=1e-6, atol=1e-12)


def test_directions_of_the_wrong_shape_are_refused() -> None:
    rods = robots(3, 100e3, 0.1)
    with pytest.raises(BadCondition, match=r"directions: shape \(3, 1, 7\)"):
        sensitivities(rods, solve(rods), np.zeros((3, 1, 7)))


def rich_rods() -> Rods:
    """Two rods with everything there is: three springs, softening, graded curvature, a base that gives and is tilted."""
    rods = robots(2, np.array([120e3, 200e3]), 0.15, roll=0.4, form=Form(2, springs=3))
    rods.field("spring_direction")[:] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.8]]
    rods.field("spring_stiffness")[:] = [20.0, 30.0, 60.0]
    rods.field("spring_origin")[:] = [0.01, 0.0, 0.3]
    rods.field("spring_softness")[:] = [0.0, 0.0, 5e-3]
    rods.field("spring_arm")[:] = [[0.0, 0.0, 0.0], [0.0, 0.01, 0.05], [0.02, -0.01, 0.08]]
    rods.field("series")[:] = [(0.02, 0.5, 1.0), (-0.01, -2.0, -1.0)]
    rods.field("base_compliance")[:], rods.field("base_relief")[:] = (0.02, 0.03, 0.01), 0.4
    rods.field("base_stiffening")[:] = 300.0
    rods.field("base_turn")[:] = (0.02, -0.03, 0.05)
    rods.field("rest_curvature")[:] = (0.3, -0.2, 0.4)
    rods.field("rest_strain")[..., :2] = (0.01, -0.02)
    rods.field("dead_moment")[:] = (0.02, 0.01, -0.03)
    rods.field("curvature_rise")[:] = 0.1 * np.arange(-4.0, 5.0)
    rods.field("active")[:] = 0.1 * np.array([4.0, 3.0, 0.2, -3.0, 1.0, 0.1, 2.0, -2.0, -0.1, 1.0, 3.0, 0.2])
    return rods.check()


SIZES = {
    "bend_stiffness": 2.0, "stretch_stiffness": 800.0, "length": 0.1, "load": 30.0, "series": 0.2, "spring_stiffness": 30.0,
    "spring_origin": 0.05, "spring_softness": 4e-3, "spring_arm": 0.05, "base_compliance": 0.02, "base_stiffening": 100.0,
}  # fmt: skip
"""By how much each field is changed in a difference, before it is scaled down; others by 1."""


def test_a_linear_section_knows_how_it_would_soften_by_what_actuators_make() -> None:
    made = robots(2, 150e3, 0.1)
    made.field("active")[..., :3] = (3.0, -2.0, 0.1)
    along = direction(made, series=[[0.05, -1.0, -0.5]] * 2)
    found = sensitivities(made, solve(made, TIGHT), along, TIGHT).tip[:, 0]
    once, back = (solve(Rods(made.form, made.values + size * along[0]), TIGHT).tip for size in (1e-5, -1e-5))
    np.testing.assert_allclose(found, (once - back) / 2e-5, rtol=1e-4, atol=1e-6)


def outputs(values: Array, form: Form) -> dict[str, Array]:
    """What is differentiated; orientations as matrices, strains as means of each element by Gauss's rule."""
    rods = Rods(form, values)
    solution = solve(rods, FIXED).trusted()
    found, (arcs, weights) = stations(rods, solution, ARCS, FIXED), gauss_points(rods)
    strain = stations(rods, solution, arcs, FIXED).strain.reshape(len(rods), form.elements, len(weights)) @ weights
    turn = Rotation.from_quat(found.orientation.reshape(-1, 4), scalar_first=True).as_matrix().reshape(len(rods), -1, 3, 3)
    ends = {name: getattr(solution, name) for name in ("tip", "base_force", "base_moment")}
    return {**ends, "strain": strain, "position": found.position, "matrix": turn}


@pytest.mark.parametrize("seed", range(3))
def test_every_output_agrees_with_converged_differences_along_random_directions(seed: int) -> None:
    rods, rng, h = rich_rods(), np.random.default_rng(seed), 1e-4
    size = np.zeros(rods.form.width)
    for name in rods.form.fields():
        rods.form.view(size, name)[...] = SIZES.get(name, 1.0)
    along = size * rng.normal(size=(1, 3, rods.form.width))
    rods.form.view(along, "length")[...] -= rods.form.view(along, "length").mean(axis=-1, keepdims=True)
    # No softness is a spring that pulls both ways, any softness one that does not: only the last may change.
    rods.form.view(along, "spring_softness")[..., :2] = 0.0
    # A spring's direction stays a unit vector: it turns about an axis.
    for k in range(3):
        rods.form.view(along[0, k], "spring_direction")[...] = np.cross(
            rng.normal(size=(3, 3)), rods.field("spring_direction")[0]
        )
    found = sensitivities(rods, solve(rods, FIXED), along, FIXED, arc_lengths=ARCS, strain=True)
    default = sensitivities(rods, solve(rods), along).tip
    assert (np.linalg.norm(default - found.tip, axis=-1) / np.linalg.norm(found.tip, axis=-1)).max() < 1e-4
    here = outputs(rods.values, rods.form)
    for k in range(3):
        at = {j: outputs(rods.values + j * h * along[0, k], rods.form) for j in (-2, -1, 1, 2)}
        for name in here:
            expected = (8 * (at[1][name] - at[-1][name]) - (at[2][name] - at[-2][name])) / (12 * h)
            if name == "matrix":
                value = np.cross(found.turn[:, k, :, None], np.swapaxes(here[name], -1, -2)).swapaxes(-1, -2)
            else:
                value = getattr(found, name)[:, k]
            assert np.abs(value - expected).max() < 1e-6 * np.abs(expected).max(), name
        assert found.turn[:, k, 0] == pytest.approx(found.base_rotation[:, k], abs=1e-8)
        assert found.turn[:, k, -1] == pytest.approx(found.rotation[:, k], abs=1e-8)


def test_a_rod_without_a_spine_knows_what_a_spine_would_do() -> None:
    none = robots(1, 150e3, 0.0)
    none.field("bend_stiffness")[:, 0] *= 3.0
    along = direction(none, length=(1.0, -1.0))
    found = sensitivities(none, solve(none, TIGHT), along, TIGHT).tip[0, 0]
    start, once, twice = (solve(Rods(none.form, none.values + size * along[0]), TIGHT).tip[0] for size in (0.0, 1e-4, 2e-4))
    expected = (4 * (once - start) - (twice - start)) / 2e-4
    assert np.linalg.norm(found - expected) < 1e-5 * np.linalg.norm(expected)
