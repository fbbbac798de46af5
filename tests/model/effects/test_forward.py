"""The forward model of a campaign: baseline, derivatives, round trip."""

import math
from typing import Any

import numpy as np
import pytest

from model.body import body_of
from model.condition import conditions
from model.effects import ForwardModel, design_from_columns
from model.errors import BadCondition
from model.robot import Robot, robot_from_dict
from model.rotation import from_vector, multiply
from tests.model.effects.campaigns import Moved, campaign, pushes
from tests.model.rods.cases import solved
from tests.simulated.bench import raises


def at_some_values(forward: ForwardModel, seed: int, share: float = 0.4) -> Any:
    """A parameter vector with everything present at a share of its scale."""
    rng = np.random.default_rng(seed)
    low, high, sd = np.array([(p.low, p.high, p.sd) for p in forward.parameters]).T
    drawn = share * sd * rng.normal(size=sd.size)
    return np.clip(np.where(low == 0, np.abs(drawn), drawn), low, high)


def test_at_zero_parameters_the_tips_are_those_of_the_converged_rod(paper_robot: Robot) -> None:
    found = Moved(paper_robot, campaign(unload=False), area="per_length")
    design = found.forward.design
    expected = solved(paper_robot, conditions(paper_robot, design.spine_length, design.pressure)).trusted().tip
    assert found.still == pytest.approx(expected, abs=1e-5)


def test_derivatives_agree_with_differences_of_predictions(paper_robot: Robot) -> None:
    robot = paper_robot.replace(markers=[0.1, {"arc_length": 0.25, "offset": [0.036, -0.02]}])
    columns = campaign(lengths=(0.0, 0.12, 0.27), levels=(60e3, 180e3), roll_deg=30.0)
    columns |= {f"m{k}{axis}": np.zeros(len(columns["t"])) for k in (1, 2) for axis in "xyz"}
    forward = Moved(robot, columns, None).forward
    theta = at_some_values(forward, seed=3)
    theta[forward.index("contact")] = 0.0
    _, jacobian = forward.linearise(theta)
    for k, info in enumerate(forward.parameters):
        step = np.zeros(theta.size)
        step[k] = 3e-5 * info.sd  # wider, friction begins to slide on the way
        if theta[k] - step[k] < info.low or theta[k] + step[k] > info.high:
            continue
        expected = (forward.predict(theta + step) - forward.predict(theta - step)) / (2 * step[k])
        # m; the copies of a trial's parameter move together, so what one trial leaves in the silicone for the next counts as its
        assert jacobian[:, k] * info.sd == pytest.approx(expected * info.sd, abs=3e-7, rel=3e-4), info.name
    some = [*forward.index("spine_length")[::-1], *forward.index("spine_slip"), *forward.index("frame_shift")]
    assert forward.linearise(theta, some)[1] == pytest.approx(jacobian[:, some], rel=1e-9, abs=1e-12)


def test_where_all_effects_are_absent_derivatives_are_those_towards_each_of_them(paper_robot: Robot) -> None:
    forward = Moved(paper_robot, campaign(lengths=(0.0, 0.12, 0.27), levels=(60e3, 180e3)), None).forward
    for theta in (np.zeros(len(forward.parameters)), at_some_values(forward, seed=5)):
        sizes = [k for k, p in enumerate(forward.parameters) if p.role == "size" and p.group == "effect"]
        theta[sizes] = 0.0
        here, jacobian = forward.linearise(theta)
        assert here == pytest.approx(forward.predict(theta), abs=0)
        for k in sizes:
            step = np.zeros(theta.size)
            step[k] = 1e-4 * forward.parameters[k].sd
            moved = (forward.predict(theta + step) - here) / 1e-4
            name = forward.parameters[k].name
            assert jacobian[:, k] * forward.parameters[k].sd == pytest.approx(moved, abs=3e-6, rel=3e-3), name


def test_what_a_parameter_vector_predicts_is_observed_in_the_same_order(paper_robot: Robot) -> None:
    robot = robot_from_dict({**paper_robot.model_dump(), "markers": (0.1, 0.25)})
    columns = campaign(lengths=(0.0, 0.2), levels=(80e3, 160e3))
    columns |= {f"m{k}{axis}": np.zeros(10) for k in (1, 2) for axis in "xyz"}
    forward = Moved(robot, columns, None).forward
    theta = at_some_values(forward, seed=5, share=0.2)
    y = forward.predict(theta)
    rows, channels = forward.observations.row, forward.observations.channel
    turn = np.zeros((10, 3))
    for name in dict.fromkeys(channels.tolist()):
        own = channels == name
        if name.startswith("r"):
            turn[rows[own], "xyz".index(name[-1])] = y[own]
        else:
            columns[name] = np.full(10, np.nan)
            columns[name][rows[own]] = y[own]
    q = multiply(from_vector(turn), forward.observations.reference[:10])
    columns |= {name: q[:, k] for k, name in enumerate(("qw", "qx", "qy", "qz"))}
    columns["m1y"][3] = np.nan
    measured = forward.observe(columns)
    lost = (forward.observations.row == 3) & (forward.observations.channel == "m1y")
    assert np.isnan(measured[lost]).all() and np.isfinite(measured[~lost]).all()
    assert measured[~lost] == pytest.approx(y[~lost], abs=1e-9)


@pytest.mark.parametrize("thrust", [None, "walls"])
def test_markers_and_orientation_are_those_of_the_converged_rod(thrust: str | None, paper_robot: Robot) -> None:
    robot = robot_from_dict({**paper_robot.model_dump(), "markers": (0.12, 0.2, 0.4), "thrust": thrust})
    columns = campaign(lengths=(0.2,), levels=(150e3,), unload=False)
    columns |= {f"m{k}{axis}": np.zeros(2) for k in (1, 2, 3) for axis in "xyz"}
    forward = Moved(robot, columns, None, area="per_length").forward
    y = forward.predict(np.zeros(len(forward.parameters)))
    states = conditions(robot, forward.design.spine_length, forward.design.pressure)
    true = solved(robot, states, robot.markers).trusted()
    by_label = dict(zip(zip(forward.observations.row, forward.observations.channel, strict=True), y, strict=True))
    for k in range(3):
        expected = true.shape[1, k]
        found = [by_label[1, f"m{k + 1}{axis}"] for axis in "xyz"]
        assert found == pytest.approx(expected, abs=5e-6)
    assert forward.observations.reference[1] == pytest.approx(true.orientation[1], abs=1e-5)
    assert [by_label[1, name] for name in ("rx", "ry", "rz")] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_parameters_of_a_trial_reach_its_own_rows_only(paper_robot: Robot) -> None:
    forward = Moved(paper_robot, campaign(lengths=(0.0, 0.1, 0.2), levels=(100e3,)), None, area="per_length").forward
    _, jacobian = forward.linearise(np.zeros(len(forward.parameters)))
    names = [p.name for p in forward.parameters]
    trial = forward.design.trial_id[forward.design.trial][forward.observations.row]
    own = jacobian[:, names.index("spine_length.excess[trial=3]")] != 0
    assert set(trial[own]) == {3}
    assert "spine_length.excess[trial=1]" not in names
    length = forward.design.spine_length[forward.observations.row]
    own = jacobian[:, names.index("area.excess[spine_length=0.1]")] != 0
    assert set(length[own]) == {0.1}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"p1": np.full(5, 2.5e8)}, "pressure"),
        ({"spine_length": np.full(5, 30.0)}, "spine_length"),
        ({"spine_length": np.array([0.1, np.nan, 0.1, 0.1, 0.1])}, "spine_length"),
        ({"p10": np.zeros(5)}, "chambers"),
        ({"t": np.zeros(4)}, "t: shape"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_by_column(paper_robot: Robot, change: dict[str, Any], message: str) -> None:
    columns = campaign(lengths=(0.1,), levels=(60e3, 120e3))
    raises(BadCondition, message, design_from_columns, paper_robot, columns | change)


def test_parameters_beyond_their_bounds_are_refused_by_name(paper_robot: Robot) -> None:
    forward = Moved(paper_robot, campaign(lengths=(0.1,), levels=(60e3,))).forward
    theta = np.zeros(len(forward.parameters))
    theta[forward.index("vacuum_leak")[0]] = -0.1
    raises(BadCondition, r"vacuum_leak\.lost", forward.predict, theta)
    raises(BadCondition, "no_such", forward.index, "no_such")


def test_a_table_of_stiffness_trials_alone_needs_no_pressures(paper_robot: Robot) -> None:
    columns = pushes("body", [0.0, 0.2], [0.0, 2e-3, 4e-3])
    forward = Moved(paper_robot, columns, None).forward
    y, jacobian = forward.linearise(np.zeros(len(forward.parameters)))
    # Bending and shear in series; the weight holds the body up beside them, 3/8 of it over the length.
    second, long = body_of(paper_robot).mean_second, paper_robot.length
    area = math.pi * (paper_robot.outer_radius**2 - paper_robot.inner_radius**2)
    soft = long**3 / (3 * paper_robot.youngs_modulus * second) + long / (paper_robot.shear_modulus * area)
    held = (0.375 * paper_robot.density * area * long + 1.2 * paper_robot.tip_mass) * 9.81 / long
    stiffness = 1 / soft + held
    assert y[:3] == pytest.approx(stiffness * columns["deflection"][:3], rel=0.02)
    assert y[5] > 1.5 * y[2]
    assert 0.6 * y[2] < jacobian[2, forward.index("body_modulus")[0]] < y[2]
