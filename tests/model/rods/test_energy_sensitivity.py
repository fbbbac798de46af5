"""The derivative of the stored energy against converged differences of the energy."""

from __future__ import annotations

import numpy as np
import pytest

from model.effects.layout import UNIFORM
from model.errors import BadCondition
from model.rods import Fast, Rods, energy, energy_sensitivities, solve
from tests.model.rods.cases import robots
from tests.model.rods.test_sensitivity_outputs import rich_rods, sizes

TIGHT = Fast(divisions=24.0, close=1e-13)


def linear_rods() -> Rods:
    """Everything that rods can have but hyperelastic sections."""
    made = rich_rods()
    made.field("series")[:] = 0.0
    return made


def stored(made: Rods) -> np.ndarray:
    """(n,) J."""
    return energy(made, solve(made, TIGHT).trusted(), TIGHT)


def expected(made: Rods, along: np.ndarray, h: float = 3e-4) -> np.ndarray:
    """(n,) J: fourth-order difference along a direction."""
    at = {j: stored(Rods(made.form, made.values + j * h * along)) for j in (-2, -1, 1, 2)}
    return (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)


@pytest.mark.parametrize("name", [
    "tip_force", "tip_moment", "dead_force", "dead_moment", "base_turn", "base_compliance", "spring_stiffness", "length",
    "bend_stiffness", "stretch_stiffness", "rest_curvature", "rest_strain", "load", "curvature_rise",
])  # fmt: skip
def test_the_energy_changes_with_every_field_as_differences_say(name: str) -> None:
    made = linear_rods()
    along = np.zeros((1, 1, made.form.width))
    view = made.form.view(along, name)
    size = made.form.view(sizes(made), name)
    view[...] = size * np.random.default_rng(4).normal(size=view.shape)
    wanted = expected(made, along[:, 0])
    found = energy_sensitivities(made, solve(made, TIGHT), along, TIGHT)
    assert found.shape == (2, 1)
    assert np.abs(found[:, 0] - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_hyperelastic_terms_are_refused() -> None:
    made = robots(1, 100e3, 0.1, form=UNIFORM.form)
    along = np.zeros((1, 1, made.form.width))
    assert energy_sensitivities(made, solve(made), along)[0, 0] == 0.0
    made.form.view(along, "series")[...] = 1.0
    with pytest.raises(BadCondition, match="series: must be zero"):
        energy_sensitivities(made, solve(made), along)
