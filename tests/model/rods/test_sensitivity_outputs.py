"""Sensitivities of what a rod does between its ends, and of everything at once, against converged differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from model.rods import Fast, Form, Rods, Solution, gauss_points, sensitivities, solve, stations
from tests.model.rods.cases import LENGTH, robots

TIGHT = Fast(divisions=16.0, close=1e-13)
ARCS = np.array([0.0, 0.07, 0.16, 0.33, LENGTH])
FIXED = replace(TIGHT, steps=np.full((2, 2), 12))
"""Fixed, so that differences are of one smooth function."""
Array = np.ndarray


def rich_rods() -> Rods:
    """Two rods with everything there is: three springs, softening, graded curvature, a base that gives and is tilted."""
    rods = robots(2, np.array([120e3, 200e3]), 0.15, roll=0.4, form=Form(2, springs=3, full=True))
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
    return rods.check()


def sizes(rods: Rods) -> Array:
    """(width,) by how much each number is changed in a difference, before it is scaled down."""
    size = np.zeros(rods.form.width)
    per_field = {
        "bend_stiffness": 2.0, "stretch_stiffness": 800.0, "length": 0.1, "load": 30.0, "series": 0.2,
        "spring_stiffness": 30.0, "spring_origin": 0.05, "spring_softness": 4e-3, "spring_arm": 0.05, "base_compliance": 0.02,
        "base_stiffening": 100.0,
    }  # fmt: skip
    for name in rods.form.fields():
        rods.form.view(size, name)[...] = per_field.get(name, 1.0)
    return size


def outputs(rods: Rods) -> dict[str, Array]:
    """What is differentiated; orientations as matrices."""
    solution = solve(rods, FIXED).trusted()
    found = stations(rods, solution, ARCS, FIXED)
    return {
        "tip": solution.tip, "base_force": solution.base_force, "base_moment": solution.base_moment,
        "strain": strains(rods, solution, FIXED), "position": found.position, "matrix": matrices(found.orientation),
    }  # fmt: skip


def strains(rods: Rods, solution: Solution, method: Fast) -> Array:
    """(n, elements) mean axial strain of each element, by Gauss's rule."""
    arcs, weights = gauss_points(rods)
    found = stations(rods, solution, arcs, method).strain
    return found.reshape(len(rods), rods.form.elements, len(weights)) @ weights


def matrices(q: Array) -> Array:
    """Rotation matrices of quaternions."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def skew(a: Array) -> Array:
    """[a]x."""
    x, y, z = np.moveaxis(a, -1, 0)
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), (0, 1), (-2, -1))


def moved(rods: Rods, by: Array) -> dict[str, Array]:
    return outputs(Rods(rods.form, rods.values + by))


@pytest.mark.parametrize("seed", range(3))
def test_every_output_agrees_with_converged_differences_along_random_directions(seed: int) -> None:
    rods = rich_rods()
    rng = np.random.default_rng(seed)
    along = sizes(rods) * rng.normal(size=(1, 3, rods.form.width))
    rods.form.view(along, "length")[...] -= rods.form.view(along, "length").mean(axis=-1, keepdims=True)
    # No softness is a spring that pulls both ways, any softness one that does not: only the last may change.
    rods.form.view(along, "spring_softness")[..., :2] = 0.0
    # A spring's direction stays a unit vector: it turns about an axis.
    e = rods.field("spring_direction")[0]
    for k in range(3):
        rods.form.view(along[0, k], "spring_direction")[...] = np.cross(rng.normal(size=(3, 3)), e)
    solution = solve(rods, FIXED)
    found = sensitivities(rods, solution, along, FIXED, arc_lengths=ARCS, strain=True)
    here = outputs(rods)
    h = 1e-4
    for k in range(3):
        at = {j: moved(rods, j * h * along[0, k]) for j in (-2, -1, 1, 2)}
        expected = {name: (8 * (at[1][name] - at[-1][name]) - (at[2][name] - at[-2][name])) / (12 * h) for name in here}
        by_turn = skew(found.turn[:, k]) @ here["matrix"]
        for name, value in (
            ("tip", found.tip[:, k]), ("base_force", found.base_force[:, k]), ("base_moment", found.base_moment[:, k]),
            ("strain", found.strain[:, k]), ("position", found.position[:, k]), ("matrix", by_turn),
        ):  # fmt: skip
            scale = np.abs(expected[name]).max()
            assert np.abs(value - expected[name]).max() < 1e-6 * scale, name
        assert found.turn[:, k, 0] == pytest.approx(found.base_rotation[:, k], abs=1e-8)
        assert found.turn[:, k, -1] == pytest.approx(found.rotation[:, k], abs=1e-8)


def stiffer_at_its_base() -> Rods:
    """A rod whose inner element is stiffer and has no length."""
    rods = robots(1, 150e3, 0.0, form=Form(2, full=True))
    rods.field("bend_stiffness")[:, 0] *= 3.0
    return rods


def test_a_rod_without_a_spine_knows_what_a_spine_would_do() -> None:
    none = stiffer_at_its_base()
    along = np.zeros((1, 1, none.form.width))
    none.form.view(along, "length")[0, 0] = (1.0, -1.0)
    found = sensitivities(none, solve(none, TIGHT), along, TIGHT).tip[0, 0]
    tips = []
    for size in (1e-4, 2e-4):
        longer = stiffer_at_its_base()
        longer.values[:] += size * along[0, 0]
        tips.append(solve(longer, TIGHT).tip[0])
    start = solve(none, TIGHT).tip[0]
    expected = (4 * (tips[0] - start) - (tips[1] - start)) / 2e-4
    assert np.linalg.norm(found - expected) < 1e-5 * np.linalg.norm(expected)
