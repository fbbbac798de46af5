"""Laws know no particular robot: similar robots, in similar states, do the same with every effect."""

from typing import Any

import numpy as np
import pytest

from diagnosis.criticism.relatives import RELATIVES
from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.effects.design import QUATERNION
from model.effects.scales import STANDARD, scales
from model.errors import BadRobot
from model.robot import Robot, robot_from_dict
from model.stated import Stated
from tests.model.effects.campaigns import Columns, campaign, joined, pushes
from tests.model.effects.test_tendons import TENSIONS, pulls

SCALINGS = ((0.3, 0.1), (3.0, 8.0), (0.3, 8.0))
"""Of length, and of modulus and pressure; gravity goes with both."""
EFFECTS = {**CATALOGUE, **RELATIVES}
LENGTHS = ("spine_length", "deflection")


def similar(robot: Robot, length: float, modulus: float) -> Robot:
    """The robot scaled, of the same density."""
    data = robot.model_dump()
    for name in ("length", "outer_radius", "inner_radius"):
        data[name] *= length
    for name in ("youngs_modulus", "shear_modulus"):
        data[name] *= modulus
    if robot.max_pressure is not None:
        data["max_pressure"] = robot.max_pressure * modulus
    data["tip_mass"] *= length**3
    data["markers"] = [s * length for s in robot.markers]
    for part in ("chambers", "tendons"):
        for name in ("radius", "path_radius"):
            if data[part] is not None and name in data[part]:
                data[part][name] *= length
    if robot.spine is not None:
        table = {s * length: e * modulus for s, e in robot.spine.modulus.items()}
        data["spine"] = {"radius": robot.spine.radius * length, "modulus": table}
    if isinstance(robot.area_factor, dict):
        data["area_factor"] = {s * length: a for s, a in robot.area_factor.items()}
    x, y, z = (g * modulus / length for g in robot.gravity)
    return robot_from_dict(data).model_copy(update={"gravity": (x, y, z)})  # beyond what a robot.yaml may hold


def scaled(columns: Columns, length: float, pressure: float, mass: float) -> Columns:
    """The same states of a similar robot, in the same time."""
    factor = {**dict.fromkeys(LENGTHS, length), "rate": pressure, "tip_mass": mass, **{f"p{k}": pressure for k in range(1, 10)}}
    return {name: column * factor.get(name, 1.0) if name in factor else column for name, column in columns.items()}


def readings(robot: Robot, columns: Columns, effects: dict[str, Any]) -> dict[str, np.ndarray]:
    """Tips (m) and forces (N) without effect, and with each at its plausible size, shapes where a fit begins."""
    without_attitudes = {name: column for name, column in columns.items() if name not in QUATERNION}
    forward = ForwardModel(robot, design_from_columns(robot, without_attitudes), "per_length", effects)
    out = {"": forward.predict(np.zeros(len(forward.parameters)))}
    for id in effects:
        theta = np.zeros(len(forward.parameters))
        for k in forward.index(id):
            info = forward.parameters[k]
            theta[k] = min(info.sd, info.high) if info.role == "size" else info.starts[-1]
        out[id] = forward.predict(theta)
    force = forward.observations.channel == "force"
    return {id: np.concatenate([x[~force], x[force]]) for id, x in out.items()}


@pytest.mark.parametrize(("length", "modulus"), SCALINGS)
def test_similar_robots_do_the_same_with_every_effect(paper_robot: Robot, length: float, modulus: float) -> None:
    bent = campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3, 250e3), hold=0.0)
    n = len(bent["t"])
    bent |= {"specimen": np.full(n, ""), "deflection": np.zeros(n), "force": np.full(n, np.nan)}
    pushed = {name: np.resize(column[:1], 2) for name, column in bent.items()} | pushes("body", 0.2, (0.005, 0.01))
    columns = joined(bent, pushed | {"step": np.arange(2), "t": np.array([900.0, 901.0])})
    effects = {id: spec for id, spec in EFFECTS.items() if not id.startswith("tendon")}
    given = readings(paper_robot, columns, effects)
    made = readings(similar(paper_robot, length, modulus), scaled(columns, length, modulus, length**3), effects)
    for id, tips in made.items():
        unit = np.where(np.arange(len(tips)) < len(tips) - 2, length, modulus * length**2)
        np.testing.assert_allclose(tips / unit, given[id], atol=2e-5, err_msg=id)


@pytest.mark.parametrize("slower", (0.1, 10.0))
def test_a_campaign_that_is_done_faster_or_slower_shows_the_same_of_every_effect(paper_robot: Robot, slower: float) -> None:
    columns = campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3, 250e3))
    columns["hold"][::2] = 0.0
    timed = {**columns, "t": slower * columns["t"], "hold": slower * columns["hold"], "rate": columns["rate"] / slower}
    given, made = (readings(paper_robot, own, EFFECTS) for own in (columns, timed))
    for id, tips in made.items():
        np.testing.assert_allclose(tips, given[id], atol=2e-5, err_msg=id)
    assert np.abs(given["viscoelastic"] - given[""]).max() > 1e-3 < np.abs(given["time_offset"] - given[""]).max()


@pytest.mark.parametrize(("length", "modulus"), SCALINGS)
def test_similar_robots_with_tendons_do_too(pulled: Robot, length: float, modulus: float) -> None:
    robot = pulled.replace(max_pressure=None)
    columns = pulls(0.1 * TENSIONS, rate=np.full(len(TENSIONS), 20e3), z=np.zeros(len(TENSIONS)))
    effects = {id: spec for id, spec in CATALOGUE.items() if id.startswith("tendon")}
    given = readings(robot, columns, effects)
    made = readings(similar(robot, length, modulus), scaled(columns, length, modulus * length**2, length**3), effects)
    for id, tips in made.items():
        np.testing.assert_allclose(tips / length, given[id], atol=2e-5, err_msg=id)


def test_a_robot_that_is_none_of_the_standard_has_its_own_sizes(paper_robot: Robot) -> None:
    own = scales(paper_robot, np.array([[0.0, 250e3]]))
    assert [own.of(u) / STANDARD.of(u) for u in ("Pa", "m", "N m", "kg", "rad")] == pytest.approx([1.0] * 5, rel=1e-9)
    low = scales(paper_robot, np.array([[0.0, 80.3e3]]))
    assert (low.pressure, STANDARD.pressure) == (80e3, 250e3)
    assert [CATALOGUE[id].of(low).parameters[0].scale for id in ("pressure_deadband", "tendon_slack")] == [3200.0, 0.32]


def test_a_size_that_is_quoted_at_a_pressure_needs_it(paper_robot: Robot) -> None:
    growth = {"chamber_ballooning": {"growth": Stated(value=0.2, unit="1")}}
    stated = paper_robot.model_copy(update={"effects": growth, "max_pressure": None})
    with pytest.raises(BadRobot, match="quoted_pressure"):
        scales(stated)
    assert scales(stated.model_copy(update={"quoted_pressure": 120e3})).pressure == 120e3
    assert scales(stated.model_copy(update={"max_pressure": 300e3})).pressure == 300e3


def test_relaxation_times_that_are_stated_are_those_of_the_campaign_they_were_fitted_to(paper_robot: Robot) -> None:
    creeps = paper_robot.model_copy(update={"effects": {"viscoelastic": {"slow": Stated(value=0.1, unit="1")}}})
    assert [scales(paper_robot, pace=t).time for t in (3.0, 12.0)] == pytest.approx([1.6, STANDARD.time])
    assert scales(creeps, pace=3.0).time == scales(paper_robot).time == STANDARD.time
    assert scales(creeps.model_copy(update={"quoted_time": 40.0}), pace=3.0).time == 40.0
