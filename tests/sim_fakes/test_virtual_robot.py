"""The virtual robot without effects is the robot of the paper, and it moves like a plant; at the stiffness stand the bare spine
gives back the moduli of Table II, and the contact is honest. Each effect leaves its own signature, and none at all at size 0."""

import math
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sim_fakes.plant import AMBIENT, Plant
from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualReading, VirtualRobot, draw_effect, list_effects, walk
from sim_fakes.virtual_robot.blocks import forget_stale_cache
from sim_fakes.virtual_robot.truth import TABLE_II
from tests.model.rods.cases import PRESSURES, REFERENCE
from tests.simulated.bench import raises

PUBLISHED = RobotTruth(area_factor=1.5, spine_modulus={0.05: 0.318e6, 0.30: 4.389e6})
TRUTH = RobotTruth()
INERTIA = math.pi / 4 * TRUTH.spine_radius**4


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


# -- the stiffness stand
def slope(robot: VirtualRobot, mount: str, length: float, depth: float) -> float:
    """Stiffness between two small deflections, N/m."""
    a, b = walk(robot, [Condition(length, mount=mount, deflection=d, hold=10) for d in (depth, 2 * depth)])
    return (b.force - a.force) / depth


def at_stand(mount: str, length: float, effects: dict[str, float] | None = None) -> tuple[Plant, VirtualRobot]:
    """A plant with a jammed spine and the probe clear of the specimen."""
    plant, robot = Plant(mount=mount), VirtualRobot(TRUTH, effects or {})
    plant.spine_drive = length
    place(plant, -0.05, length or TRUTH.length)
    run(robot, plant, 5.0, 0.5)
    plant.valve_on = True
    run(robot, plant, 20.0, 0.5)
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
        run(robot, plant, 2.5, 0.5)
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
    run(robot, plant, 2.5, 0.5)
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
    run(robot, plant, 2.0, 0.1)
    place(plant, -0.02, 0.2)
    robot.advance(plant, 0.1)
    after = float(plant.probe_force[0])
    run(robot, plant, 200.0, 1.0)
    assert after == pytest.approx(-0.1, rel=0.05)
    assert plant.probe_force[0] == pytest.approx(0.0, abs=1e-3)


# ------------------------------------------------------------------ effects
ALONG_X = RobotTruth(canonical_directions=True)
SCALES = {info.id: info.scale for info in list_effects()}


def up(length: float = 0.2, hold: float = 5.0, rate: float = 20e3) -> list[Condition]:
    return [Condition(length, bend(p), hold=hold, rate=rate) for p in (0.0, 50e3, 100e3, 150e3, 200e3, 250e3)]


def there_and_back(length: float = 0.2, hold: float = 5.0, rate: float = 20e3) -> list[Condition]:
    rising = up(length, hold, rate)
    return rising + rising[-2::-1]


def tips(readings: list[VirtualReading]) -> np.ndarray:
    return np.array([r.position for r in readings]) * 1e3


def change(states: list[Condition], truth: RobotTruth = ALONG_X, **effects: float) -> np.ndarray:
    """Tip of a robot with these effects minus tip without, mm, (states, 3)."""
    return tips(walk(VirtualRobot(truth, effects), states)) - tips(walk(VirtualRobot(truth), states))


def loop(readings: list[VirtualReading]) -> float:
    """Largest gap in x between the way up and the way down at the same pressure, mm."""
    x = tips(readings)[:, 0]
    return float(np.abs(x - x[::-1]).max())


EVERYWHERE = [
    *there_and_back(),
    Condition(0.1, (60e3,) * 9, roll=1.0, hold=0.0),
    Condition(0.0, bend(200e3), tip_mass=0.2),
    Condition(0.3, mount="spine", deflection=0.01),
    Condition(0.0, mount="body", deflection=0.01),
]


@cache
def baseline() -> list[VirtualReading]:
    return walk(VirtualRobot(RobotTruth(), seed=5), EVERYWHERE)


@pytest.mark.parametrize("effect", sorted(SCALES))
def test_effect_of_size_zero_is_the_baseline_to_the_last_bit(effect: str) -> None:
    with_zero = walk(VirtualRobot(RobotTruth(), {effect: 0.0}, seed=5), EVERYWHERE)
    for a, b in zip(with_zero, baseline(), strict=True):
        assert np.array_equal(a.position, b.position) and np.array_equal(a.rotation, b.rotation)
        assert np.array_equal(a.markers, b.markers)
        assert (a.force, a.pressures, a.vacuum) == (b.force, b.pressures, b.vacuum)


# these three are seen in pushes only, as tested at the stiffness stand
@pytest.mark.parametrize("effect", sorted(set(SCALES) - {"force_bias", "arm_compliance", "contact_offset"}))
def test_effect_of_plausible_size_moves_the_tip_by_millimetres(effect: str) -> None:
    states = [*up(0.1), *up(0.3), *up(0.0)]
    moved = np.abs(change(states, **{effect: SCALES[effect]})).max()
    assert 0.5 < moved < 150


def test_slip_makes_a_loop_that_does_not_care_about_the_rate() -> None:
    fast, slow = (walk(VirtualRobot(effects={"spine_slip": 0.15}), there_and_back(0.3, rate=rate)) for rate in (50e3, 5e3))
    assert loop(fast) > 0.8
    assert loop(slow) == pytest.approx(loop(fast), rel=0.02)


def test_slip_needs_a_jammed_spine_and_lags_behind() -> None:
    assert loop(walk(VirtualRobot(effects={"spine_slip": 0.15}), there_and_back(0.0))) < 0.01
    back = change(there_and_back(0.3), spine_slip=0.15)[:, 0]
    assert back[4] > 0.3  # rising: held back, so less bent
    assert back[6] < -0.3  # falling: still more bent than it would be


def test_slip_is_the_same_in_every_direction() -> None:
    states = there_and_back(0.3)
    rolled = [Condition(0.3, s.pressures, roll=np.radians(90)) for s in states]
    flat, turned = (tips(walk(VirtualRobot(effects={"spine_slip": 0.15}), x)) for x in (states, rolled))
    assert turned[:, 1] == pytest.approx(flat[:, 0], abs=1e-6)
    assert turned[:, 0] == pytest.approx(-flat[:, 1], abs=1e-6)


def test_ballooning_is_felt_at_high_pressure() -> None:
    dx = change(up(0.0), chamber_ballooning=0.15)[:, 0]
    assert -1.0 < dx[1] < 0 and dx[5] < -20
    assert change(up(0.0), chamber_ballooning=-0.15)[5, 0] > 20


def test_area_moment_asks_for_a_softer_long_spine() -> None:
    assert change(up(0.0), area_moment=1.0) == pytest.approx(0.0, abs=1e-9)
    assert change(up(0.2), area_moment=1.0)[5, 0] < -10


def test_one_spine_modulus_stiffens_most_where_the_table_is_lowest() -> None:
    short, long = (change(up(n), spine_shear=1.0)[4, 0] for n in (0.1, 0.3))
    assert short > long > 0


def test_leak_softens_and_the_gauge_sees_most_of_it() -> None:
    (reading,) = walk(VirtualRobot(ALONG_X, {"vacuum_leak": 0.3}), [Condition(0.15, bend(200e3))])
    assert 1 - reading.vacuum / 80e3 == pytest.approx(0.8 * 0.3, abs=0.02)
    assert change([Condition(0.15, bend(200e3))], vacuum_leak=0.3)[0, 0] < -3


@pytest.mark.parametrize(("effect", "size", "moved"), [("base_tilt", 0.026, 5), ("tether_load", 0.35, 2)])
def test_what_is_fixed_to_the_room_pulls_the_same_way_whatever_the_roll(effect: str, size: float, moved: float) -> None:
    flat, rolled = change([Condition(0.0), Condition(0.0, roll=np.radians(90))], **{effect: size})
    assert rolled == pytest.approx(flat, abs=1e-6)
    assert flat[0] > moved


def test_turned_chambers_bend_out_of_the_plane_and_twisted_ones_the_more() -> None:
    azimuth, twist = (change(up(0.1), **e)[:, 1] for e in ({"chamber_azimuth": 0.105}, {"chamber_twist": 0.35}))
    assert azimuth[5] < -3 and twist[5] < -3
    assert change(up(0.1), chamber_azimuth=-0.105)[5, 1] == pytest.approx(-azimuth[5], rel=1e-6)


def test_effects_add_up_and_any_subset_may_be_on() -> None:
    readings = walk(VirtualRobot(RobotTruth(), {i: 0.3 * s for i, s in SCALES.items()}, seed=2), EVERYWHERE)
    assert all(np.all(np.isfinite(r.position)) for r in readings)


def test_effects_that_do_not_exist_are_refused_by_name() -> None:
    raises(ValueError, "unknown effect 'slip'", VirtualRobot, effects={"slip": 1.0})
    raises(ValueError, "finite", VirtualRobot, effects={"base_tilt": float("nan")})


def test_drawn_sizes_stay_within_half_and_one_and_a_half_of_the_scale() -> None:
    rng = np.random.default_rng(0)
    infos = {info.id: info for info in list_effects()}
    seen = set()
    for _ in range(600):
        name, size = draw_effect(rng, tuple(infos))
        info = infos[name]
        seen.add((name, size > 0))
        low, high = (0.6, 1.0) if info.sign == "blend" else (0.5, 1.5)
        assert low <= abs(size) / info.scale <= high
    both = {(e.id, False) for e in infos.values() if e.sign == "both"}
    assert seen == {(name, True) for name in infos} | both
    assert draw_effect(rng, ["base_tilt"])[0] == "base_tilt"
