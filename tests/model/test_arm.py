"""A serial arm: its kinematics by another way, its causes, and what its description refuses."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.ur5 import fit, read
from diagnosis.any_model.diagnose import most_telling
from model.arm import Arm, ArmModel, arm_from_dict, gravity_torques, load_arm
from model.arm.kinematics import greatest_torques
from model.arrays import Array
from model.errors import BadArm, BadCondition, BadEffect
from tests.simulated.bench import raises

UR5 = load_arm(Path(__file__).parent.parent.parent / "examples" / "ur5" / "arm.yaml")
SKEW = {
    "name": "five skew joints",
    "links": [
        {"a": 0.1, "d": 0.3, "alpha_deg": -80, "offset_deg": 20},
        {"a": 0.5, "d": 0.02, "alpha_deg": 3},
        {"a": -0.4, "d": 0.1, "alpha_deg": 178},
        {"a": 0.03, "d": -0.2, "alpha_deg": 60, "offset_deg": -90},
        {"a": 0.01, "d": 0.1, "alpha_deg": 10},
    ],
    "tool": [0.02, -0.03, 0.15],
    "base_to_world": {"position": [1, -2, 0.5], "orientation": [0.5, 0.5, -0.5, 0.5]},
    "down": [0.6, 0, -0.8],
}
ARMS = (UR5, arm_from_dict(SKEW))


def poses(arm: Arm, count: int, seed: int = 0) -> pd.DataFrame:
    q = np.random.default_rng(seed).uniform(-2.5, 2.5, (count, len(arm.joints)))
    table = pd.DataFrame(q, columns=list(arm.joints))
    return table.join(table.shift().add_suffix("_before"))


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_tool_is_where_a_product_of_exponentials_puts_it(arm: Arm) -> None:
    base = arm.base_to_world
    frame = RigidTransform.from_components(base.position, Rotation.from_quat(base.orientation, scalar_first=True))
    screws = []
    for link in arm.links:  # the arm with every joint at zero: turns about its axes in the world, by one rad
        axis = frame.rotation.apply([0, 0, 1])
        screws.append(np.append(axis, np.cross(frame.translation, axis)))
        turn = Rotation.from_euler("ZX", [link.offset_deg, link.alpha_deg], degrees=True)
        along = Rotation.from_euler("Z", link.offset_deg, degrees=True).apply([link.a, 0, link.d])
        frame = frame * RigidTransform.from_components(along, turn)
    inputs = poses(arm, 5)
    positions = ArmModel(arm)({}, inputs)
    for q, position in zip(inputs[list(arm.joints)].to_numpy(), positions, strict=True):
        point = frame.apply(arm.tool)
        for screw, angle in reversed(list(zip(screws, q, strict=True))):
            point = RigidTransform.from_exp_coords(angle * screw).apply(point)
        assert position == pytest.approx(point, abs=1e-12)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_torques_of_gravity_are_the_slopes_of_the_potential_energy(arm: Arm) -> None:
    def energy(q: Array) -> Array:
        inputs, out = pd.DataFrame(q, columns=list(arm.joints)), np.zeros(len(q))
        for k, (mass, centre) in enumerate(zip(*arm.masses, strict=True), 1):  # the arm that ends at the link's centre of mass
            ended = arm.model_copy(update={"links": arm.links[:k], "tool": tuple(centre)})
            out -= 9.81 * mass * ArmModel(ended)({}, inputs) @ np.array(arm.down)
        return out

    q = poses(arm, 20)[list(arm.joints)].to_numpy()
    slopes = [(energy(q + e) - energy(q - e)) / 2e-5 for e in 1e-5 * np.eye(q.shape[1])]
    assert -np.transpose(slopes) == pytest.approx(gravity_torques(arm, q)[0], abs=1e-6)
    assert np.all(np.abs(gravity_torques(arm, q)[0]) <= greatest_torques(arm))


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_derivatives_are_those_of_differences_at_any_arm(arm: Arm) -> None:
    model, inputs, rng = ArmModel(arm), poses(arm, 4), np.random.default_rng(1)
    theta = {name: size * rng.normal() for name, (_, size, _) in model.parameters.items()}
    names = list(theta)
    slopes = np.stack([*model.derivatives(theta, inputs).values()], axis=-1)
    low, high = (np.array([model({**theta, n: theta[n] + step}, inputs) for n in names]) for step in (-1e-6, 1e-6))
    assert np.moveaxis(high - low, 0, -1) / 2e-6 == pytest.approx(slopes, abs=1e-8)


def test_a_cause_of_size_zero_does_nothing_and_every_other_one_moves_the_tool() -> None:
    model, inputs = ArmModel(UR5), poses(UR5, 6)
    nominal = model({}, inputs)
    assert np.array_equal(model(dict.fromkeys(model.parameters, 0.0), inputs), nominal)
    for cause in model.causes:
        sizes = {name: size for name, (_, size, _) in cause.parameters.items()}
        assert 1e-6 < np.abs(model(sizes, inputs) - nominal).max() < 0.1, cause.name


def test_the_tilt_of_a_parallel_axis_is_a_small_parameter() -> None:
    """Of Denavit and Hartenberg's numbers alone a and d jump by metres: the common normal moves along the axes."""
    model, inputs = ArmModel(UR5), poses(UR5, 50)
    names = [n for n in model.parameters if n.startswith(("alpha", "beta", "a_", "d_", "zero"))]
    assert {"beta_2", "beta_3"} < set(names) and not {"beta_1", "d_2", "d_3"} & set(names)
    nominal = model({}, inputs)
    moved = [np.abs(model({"beta_2": tilt}, inputs) - nominal).max() / tilt for tilt in (1e-8, 1e-5, 1e-3)]
    assert moved == pytest.approx([moved[0]] * 3, rel=1e-2)
    jac = np.transpose([d.ravel() for d in model.derivatives({}, inputs, [*names, "d_1"]).values()])
    tilted = jac[:, names.index("beta_2")]
    others = np.delete(jac, names.index("beta_2"), axis=1)
    assert np.linalg.norm(tilted - others @ np.linalg.lstsq(others, tilted)[0]) > 0.1 * np.linalg.norm(tilted)


def test_an_arm_of_hidden_errors_is_fitted_and_well_chosen_poses_say_more(tmp_path: Path) -> None:
    model, rng = ArmModel(UR5), np.random.default_rng(3)
    names = [
        n for c in model.causes if c.name in ("base_frame", "joint_zeros", "link_lengths", "axis_twists") for n in c.parameters
    ]
    truth = {n: model.parameters[n][1] * rng.normal() for n in names}
    inputs = poses(UR5, 120)
    target, at = (1e3 * model(theta, inputs) for theta in ({}, truth))
    measured = at + 0.02 * rng.normal(size=at.shape)
    table = {f"joint_{k}": np.degrees(inputs[f"q{k}"]) for k in range(1, 7)}
    table |= {f"{axis}_t": target[:, i] for i, axis in enumerate("xyz")}
    table |= {f"{axis}_dif": (measured - target)[:, i] for i, axis in enumerate("xyz")}
    pd.DataFrame(table).to_csv(tmp_path / "grid.csv")
    q, seen = read(tmp_path / "grid.csv")
    theta, noise = fit(model, names, q[:100], seen[:100])
    assert noise == pytest.approx(2e-5, rel=0.2)
    assert np.linalg.norm(model(theta, q[100:]) - at[100:] / 1e3, axis=1).max() < 3e-5
    jac = np.stack([d * model.parameters[n][1] for n, d in model.derivatives({}, q, names).items()], axis=-1)

    def predicted(rows: Any) -> float:
        own = jac[rows].reshape(-1, len(names))
        return float(np.einsum("nip,pq,niq->", jac, np.linalg.inv(own.T @ own / noise**2 + np.eye(len(names))), jac))

    told = most_telling(jac.reshape(-1, len(names)) / noise, {i: np.arange(360) // 3 == i for i in range(120)}, 12)
    assert predicted(told) < 0.9 * min(predicted(rng.choice(120, len(told), replace=False)) for _ in range(20))


LINK = {"a": 0.4, "d": 0.1, "alpha_deg": 90}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"links": [LINK, LINK | {"a": 425}]}, "links.1.a = 425 m: Input should be less than or equal to 10"),
        ({"links": [LINK | {"alpha_deg": 1.5708}]}, "alpha_deg: 1.5708 looks like rad"),
        ({"links": [LINK | {"mass": 2}, LINK]}, "links.1 state none, the others do"),
        ({"links": [{"a": 0, "d": 0, "alpha_deg": 0}]}, "every a and d is 0 m"),
        ({"links": [{"a": 0.4, "d": 0.1}]}, "links.0.alpha_deg: Field required"),
        ({"links": []}, "links: 0, must be 1 to 20"),
        ({"tool_mass": 2}, "says nothing without the mass of every link"),
        ({"down": [0, 0, 0]}, "is no direction"),
        ({"base_to_world": {"position": [0, 0, 0], "orientation": [1, 1, 0, 0]}}, "norm 1.41421"),
        ({"speed": 3}, "speed = 3: Extra inputs"),
    ],
)
def test_a_wrong_description_is_one_clear_error(change: dict[str, Any], message: str) -> None:
    told = raises(BadArm, None, arm_from_dict, {"name": "arm", "links": [LINK], **change})
    assert message in told and "\n" not in told


def test_poses_and_parameters_that_make_no_sense_are_refused() -> None:
    model, inputs = ArmModel(UR5), poses(UR5, 2)
    raises(BadEffect, "'sag2' is no parameter of UR5: did you mean sag_2?", model, {"sag2": 1e-3}, inputs)
    raises(BadCondition, "no column q3", model, {}, inputs.drop(columns="q3"))
    for value in (np.nan, 15.0):
        with pytest.raises(BadCondition, match=f"row 1, q4 = {value:g} rad: must be finite and at most 12.5664 rad"):
            model({}, inputs.assign(q4=[0, value]))
