"""The virtual robot without effects is the robot of the paper, and it moves like a plant."""

import os
from pathlib import Path

import numpy as np
import pytest

from sim_fakes.plant import AMBIENT, Plant
from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualRobot, walk
from sim_fakes.virtual_robot.blocks import forget_stale_cache
from tests.model.rods.cases import PRESSURES, REFERENCE
from tests.simulated.bench import raises

PUBLISHED = RobotTruth(area_factor=1.5, spine_modulus={0.05: 0.318e6, 0.30: 4.389e6})


def bend(pressure: float) -> tuple[float, ...]:
    """Chambers 9, 1 and 2 at a pressure in Pa."""
    return tuple(pressure if i in (8, 0, 1) else 0.0 for i in range(9))


def run(robot: VirtualRobot, plant: Plant, duration: float, dt: float = 0.02) -> None:
    for _ in range(round(duration / dt)):
        robot.advance(plant, dt)


def test_tip_agrees_with_the_converged_continuous_rod_at_all_twenty_points() -> None:
    states = [Condition(length, bend(p)) for length in REFERENCE for p in PRESSURES]
    tips = np.array([r.position for r in walk(VirtualRobot(PUBLISHED), states)]) * 1e3
    assert np.abs(tips[:, [0, 2]] - np.concatenate(list(REFERENCE.values()))).max() < 0.04
    assert np.abs(tips[:, 1]).max() < 1e-6


def test_tip_varies_smoothly_with_spine_length() -> None:
    lengths = np.arange(0.101, 0.149, 0.0005)
    robot = VirtualRobot()
    x = np.array([r.position[0] for r in walk(robot, [Condition(float(n), bend(200e3), hold=20) for n in lengths])])
    steps = np.diff(x)
    assert np.all(steps > 0)
    assert np.abs(np.diff(steps)).max() < 0.02 * steps.mean()


def test_same_seed_gives_the_same_readings_to_the_last_bit() -> None:
    truth = RobotTruth(scatter_length=0.001, scatter_stiffness=0.02)
    states = [Condition(0.2, bend(p), rejam=p == 0) for p in (0.0, 150e3, 0.0, 150e3)]
    first, again, other = (VirtualRobot(truth, {"spine_slip": 0.1}, seed) for seed in (3, 3, 4))
    a, b, c = (np.array([r.position for r in walk(robot, states)]) for robot in (first, again, other))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    first.reset()
    assert np.array_equal(a, np.array([r.position for r in walk(first, states)]))


@pytest.mark.parametrize("scatter", [{"scatter_length": 0.001}, {"scatter_stiffness": 0.02}])
def test_scatter_is_drawn_anew_at_each_jamming_only(scatter: dict[str, float]) -> None:
    robot = VirtualRobot(RobotTruth(**scatter), seed=1)
    states = [Condition(0.2, bend(p), rejam=r, hold=20) for p, r in ((2e5, True), (0.0, False), (2e5, False), (2e5, True))]
    x = [r.position[0] for r in walk(robot, states)]
    assert x[2] == pytest.approx(x[0], abs=1e-7)
    assert 5e-5 < abs(x[3] - x[0]) < 5e-3


def test_equal_pressures_only_lengthen_and_markers_lie_along_the_body() -> None:
    hanging, long = walk(VirtualRobot(), [Condition(0.0), Condition(0.0, (100e3,) * 9)])
    assert np.abs(long.position[:2]).max() < 1e-9
    assert 0.01 < long.position[2] - hanging.position[2] < 0.03
    assert hanging.markers[:, 2] == pytest.approx([0.1, 0.2, 0.3], abs=2e-3)
    assert np.all(long.markers[:, 2] > hanging.markers[:, 2])


def test_markers_lie_on_the_bent_centre_line() -> None:
    coarse, fine = (walk(VirtualRobot(RobotTruth(segments=n)), [Condition(0.1, bend(200e3), hold=20)])[0] for n in (40, 160))
    assert coarse.markers == pytest.approx(fine.markers, abs=5e-5)


def test_chambers_fill_with_their_time_constant_whatever_the_step() -> None:
    for dt in (0.01, 0.05, 0.25):
        plant, robot = Plant(), VirtualRobot()
        plant.regulator[:3] = 100e3
        run(robot, plant, 0.25, dt)
        assert plant.chamber_pressure[:3] == pytest.approx(100e3 * (1 - np.exp(-1)), rel=1e-9)
        assert plant.time == pytest.approx(0.25)


def test_vacuum_pumps_down_and_releases_with_its_own_times() -> None:
    plant, robot = Plant(), VirtualRobot()
    plant.valve_on = True
    run(robot, plant, 1.5)
    assert AMBIENT - plant.vacuum_absolute == pytest.approx(80e3 * (1 - np.exp(-1)), rel=1e-6)
    run(robot, plant, 20.0, 0.1)
    plant.valve_on = False
    run(robot, plant, 0.7)
    assert AMBIENT - plant.vacuum_absolute == pytest.approx(80e3 * np.exp(-1), rel=1e-3)


def test_jammed_spine_blocks_the_unit_and_lets_go_when_vented() -> None:
    plant, robot = Plant(), VirtualRobot()
    for valve, drive, reached in ((False, 0.1, (0.1, False)), (True, 0.15, (0.1, True)), (False, 0.15, (0.15, False))):
        plant.valve_on = valve
        run(robot, plant, 5.0)
        plant.spine_drive = drive
        run(robot, plant, 2.0)
        assert (plant.spine_length, plant.spine_blocked) == reached


def test_unjammed_spine_hardly_changes_the_bending() -> None:
    bare, loose, jammed = (
        walk(VirtualRobot(), [Condition(n, bend(150e3), vacuum=v)])[0].position[0]
        for n, v in ((0.0, 0.0), (0.3, 0.0), (0.3, 80e3))
    )
    assert loose == pytest.approx(bare, rel=1e-3)
    assert jammed / bare < 0.4


def test_driving_by_the_plant_ends_where_settling_ends() -> None:
    plant, robot = Plant(), VirtualRobot()
    plant.spine_drive = 0.2
    run(robot, plant, 3.0)
    plant.valve_on = True
    run(robot, plant, 30.0, 0.1)
    plant.regulator[:] = bend(200e3)
    run(robot, plant, 10.0)
    (reading,) = walk(VirtualRobot(), [Condition(0.2, bend(200e3), hold=10)])
    assert plant.tip_position == pytest.approx(reading.position, abs=1e-5)
    assert plant.markers == pytest.approx(reading.markers, abs=1e-5)
    assert plant.tip_rotation == pytest.approx(reading.rotation, abs=1e-4)


def test_path_does_not_depend_on_the_step_once_pressures_rest() -> None:
    tips = []
    for dt in (0.005, 0.1, 1.0):
        plant, robot = Plant(), VirtualRobot()
        plant.regulator[:] = bend(220e3)
        run(robot, plant, 6.0, dt)
        assert robot.failures == 0
        tips.append(plant.tip_position)
    assert tips[1] == pytest.approx(tips[0], abs=1e-5)
    assert tips[2] == pytest.approx(tips[0], abs=1e-5)


def test_rod_settles_with_its_time_constant_in_small_steps_and_in_one() -> None:
    # without weight, which would pull it straight beside its own stiffness
    truth = RobotTruth(fill_time=1e-4, settling_time=0.06, gravity=(0.0, 0.0, 0.0))
    final = walk(VirtualRobot(truth), [Condition(0.0, bend(5e3), hold=10)])[0].position[0]
    for dt in (0.005, 0.06):
        plant, robot = Plant(), VirtualRobot(truth)
        plant.regulator[:] = bend(5e3)
        run(robot, plant, 0.06, dt)
        assert plant.tip_position[0] / final == pytest.approx(1 - np.exp(-1), rel=0.02)


def test_compile_cache_is_dropped_when_any_source_is_newer(tmp_path: Path) -> None:
    (tmp_path / "__pycache__").mkdir()
    source, index = tmp_path / "a.py", tmp_path / "__pycache__" / "b.nbi"
    for age_of_source, kept in ((100, True), (300, False)):
        source.touch()
        index.touch()
        os.utime(source, (age_of_source, age_of_source))
        os.utime(index, (200, 200))
        forget_stale_cache(tmp_path)
        assert index.exists() is kept


def test_unknown_mount_and_bad_states_are_refused() -> None:
    raises(ValueError, "mount 'table'", VirtualRobot().advance, Plant(mount="table"), 0.1)
    raises(ValueError, "none below 0", Condition, 0.1, (1e5, -1.0, 0.0))
    raises(ValueError, "give 9 in every state", walk, VirtualRobot(), [Condition(0.1, (1e5,))])
    raises(ValueError, "rate", Condition, 0.1, rate=0.0)
    raises(ValueError, "area", RobotTruth.model_validate, {"area": 1.8})
