"""At the stiffness stand the bare spine gives back the moduli of Table II, and the contact is honest."""

import math

import numpy as np
import pytest

from sim_fakes.plant import Plant
from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualRobot, walk
from sim_fakes.virtual_robot.truth import TABLE_II

TRUTH = RobotTruth()
INERTIA = math.pi / 4 * TRUTH.spine_radius**4


def slope(robot: VirtualRobot, mount: str, length: float, depth: float) -> float:
    """Stiffness between two small deflections, N/m."""
    a, b = walk(robot, [Condition(length, mount=mount, deflection=d, hold=10) for d in (depth, 2 * depth)])
    return (b.force - a.force) / depth


def at_stand(mount: str, length: float, effects: dict[str, float] | None = None) -> tuple[Plant, VirtualRobot]:
    """A plant with a jammed spine and the probe clear of the specimen."""
    plant, robot = Plant(mount=mount), VirtualRobot(TRUTH, effects or {})
    plant.spine_drive = length
    place(plant, -0.05, length or TRUTH.length)
    for _ in range(10):
        robot.advance(plant, 0.5)
    plant.valve_on = True
    for _ in range(40):
        robot.advance(plant, 0.5)
    return plant, robot


def place(plant: Plant, deflection: float, z: float, y: float = 0.0) -> None:
    """Put the probe where it deflects a rigid-clamped specimen by so much (m); the stand hangs at (0.5, 0, 0.7) m."""
    radius = TRUTH.spine_radius if plant.mount == "spine" else TRUTH.outer_radius
    plant.probe_position = np.array([0.5 - radius + deflection, -y, 0.7 - z])


@pytest.mark.parametrize(("shear", "rel"), [(0.0, 2e-3), (1.0, 0.13)])
@pytest.mark.parametrize(("length", "modulus"), TABLE_II.items())
def test_cantilever_formula_gives_the_modulus_of_table_ii_back(length: float, modulus: float, shear: float, rel: float) -> None:
    stiffness = slope(VirtualRobot(TRUTH, {"spine_shear": shear}), "spine", length, 0.005 * length)
    assert stiffness * length**3 / (3 * INERTIA) == pytest.approx(modulus, rel=rel)


def test_force_at_part_of_the_length_follows_the_cantilever_formula() -> None:
    plant, robot = at_stand("spine", 0.3)
    forces = []
    for deflection in (0.0005, 0.001):
        place(plant, deflection, 0.2)
        for _ in range(5):
            robot.advance(plant, 0.5)
        forces.append(-plant.probe_force[0])
    expected = 3 * TABLE_II[0.3] * INERTIA / 0.2**3
    assert (forces[1] - forces[0]) / 0.0005 == pytest.approx(expected, rel=5e-3)


def test_body_is_stiffer_than_its_modulus_says_because_it_hangs() -> None:
    weightless = RobotTruth(stand_gravity=(0.0, 0.0, 0.0))
    inertia = math.pi / 4 * (TRUTH.outer_radius**4 - TRUTH.inner_radius**4)
    modulus = [slope(VirtualRobot(t), "body", 0.0, 0.002) * 0.4**3 / (3 * inertia) for t in (weightless, TRUTH)]
    shear = 1 + 9 * inertia / (TRUTH.area * 0.4**2)
    assert modulus[0] == pytest.approx(TRUTH.youngs_modulus / shear, rel=5e-3)
    assert 1.1 < modulus[1] / modulus[0] < 1.5


@pytest.mark.parametrize(("mount", "length"), [("spine", 0.05), ("spine", 0.1), ("spine", 0.3), ("body", 0.0)])
@pytest.mark.parametrize("dt", [0.01, 1.0])
def test_contact_pushes_back_and_returns_to_zero_even_in_coarse_steps(mount: str, length: float, dt: float) -> None:
    plant, robot = at_stand(mount, length)
    reach = length or TRUTH.length
    forces = []
    for deflection in (-0.001, 0.02, 0.006, 0.02, -0.03, -0.001):
        place(plant, deflection, reach)
        for _ in range(max(3, round(1 / dt))):
            robot.advance(plant, dt)
        forces.append(float(plant.probe_force[0]))
        assert np.abs(plant.probe_force[1:]).max() == 0
    assert robot.failures == 0
    assert forces[0] == forces[4] == forces[5] == 0
    assert forces[1] < forces[2] < -0.5
    assert forces[3] == pytest.approx(forces[1], rel=1e-3)


def test_a_probe_that_misses_feels_nothing() -> None:
    plant, robot = at_stand("spine", 0.1)
    for z, y in ((0.13, 0.0), (0.1, 0.03), (-0.01, 0.0)):
        place(plant, 0.01, z, y)
        robot.advance(plant, 0.5)
        assert np.array_equal(plant.probe_force, np.zeros(3))
    plant.mount = "robot"
    place(plant, 0.01, 0.1)
    robot.advance(plant, 0.5)
    assert np.array_equal(plant.probe_force, np.zeros(3))


def test_an_unjammed_spine_and_a_missing_one_are_limp() -> None:
    limp, jammed = (
        walk(VirtualRobot(TRUTH), [Condition(0.2, mount="spine", deflection=0.01, vacuum=v)])[0].force for v in (0.0, 80e3)
    )
    assert 0 < limp < 0.01 * jammed
    assert walk(VirtualRobot(TRUTH), [Condition(0.0, mount="spine", deflection=0.01)])[0].force == 0


def test_stand_pose_turns_the_force_into_the_arm_frame() -> None:
    turned = ((0.0, -1.0, 0.0, 0.3), (1.0, 0.0, 0.0, 0.1), (0.0, 0.0, 1.0, 0.2), (0.0, 0.0, 0.0, 1.0))
    robot = VirtualRobot(RobotTruth(stand=turned))
    plant = Plant(mount="body", probe_position=np.array([0.3, 0.1 - TRUTH.outer_radius + 0.01, 0.2 + 0.4]))
    for _ in range(5):
        robot.advance(plant, 0.5)
    assert plant.probe_force[1] < -0.5
    assert plant.probe_force[[0, 2]] == pytest.approx(0.0, abs=1e-12)


def test_giving_arm_hides_stiffness_most_of_all_that_of_a_stiff_specimen() -> None:
    giving, rigid = (
        [slope(VirtualRobot(TRUTH, e), "spine", n, 0.005 * n) for n in (0.05, 0.3)] for e in ({"arm_compliance": 5e-5}, {})
    )
    short, long = (a / b for a, b in zip(giving, rigid, strict=True))
    assert short == pytest.approx(1 / (1 + 5e-5 * 3 * TABLE_II[0.05] * INERTIA / 0.05**3), rel=5e-3)
    assert short < long < 1


def test_soft_layer_delays_the_rise_and_bias_shifts_the_zero_under_load() -> None:
    states = [Condition(0.2, mount="spine", deflection=d, hold=5) for d in (0.0005, 0.004)]
    plain, late, biased = (
        [r.force for r in walk(VirtualRobot(TRUTH, e), states)] for e in ({}, {"contact_offset": 1e-3}, {"force_bias": 0.1})
    )
    assert late[0] < 0.5 * plain[0]
    assert late[1] == pytest.approx(plain[1] * 3 / 4, rel=0.02)
    assert biased == pytest.approx([f + 0.1 for f in plain], abs=1e-3)


def test_bias_fades_after_the_load_is_gone() -> None:
    plant, robot = at_stand("spine", 0.2, {"force_bias": 0.1})
    place(plant, 0.005, 0.2)
    for _ in range(20):
        robot.advance(plant, 0.1)
    place(plant, -0.02, 0.2)
    robot.advance(plant, 0.1)
    after = float(plant.probe_force[0])
    for _ in range(200):
        robot.advance(plant, 1.0)
    assert after == pytest.approx(-0.1, rel=0.05)
    assert plant.probe_force[0] == pytest.approx(0.0, abs=1e-3)
