"""Each effect: absent at zero, sign and rough size on the paper's sweep, what turns with the robot and what does not, what stays
when it is mounted anew, and where an obstacle touches."""

import copy
import math

import numpy as np
import pytest

from model.arrays import Array
from model.body import body_of
from model.effects import CATALOGUE
from model.effects import layout as at
from model.effects.solver import solve as solve_rows
from model.robot import Robot, robot_from_dict
from model.rods import columns as col
from model.rotation import to_base
from model.sections import Section
from tests.model.effects.campaigns import Moved, campaign, joined, pushes

ON_FORCE = {"force_bias", "arm_compliance", "contact_offset"}
ON_TENDONS = {"tendon_friction", "tendon_slack"}


@pytest.fixture(scope="module")
def sweep(paper_robot: Robot) -> Moved:
    return Moved(paper_robot, campaign(lengths=(0.0, 0.15, 0.30), levels=(50e3, 100e3, 150e3, 200e3)))


@pytest.mark.parametrize("id", sorted(set(CATALOGUE) - ON_FORCE - ON_TENDONS - {"time_offset"}))
def test_an_effect_at_its_scale_moves_the_tip_and_at_zero_does_not_at_all(sweep: Moved, id: str) -> None:
    spec = CATALOGUE[id]
    shapes = {f"{id}__{p.name}": 0.5 * (p.high if p.low == 0 else p.scale) for p in spec.parameters if p.role == "shape"}
    assert not sweep.by(**shapes).any()
    for p in spec.parameters:
        if p.role == "size":
            moved = np.linalg.norm(sweep.by(**shapes, **{f"{id}__{p.name}": p.scale}), axis=1)
            assert 2e-4 < moved.max() < (0.6 if id == "chamber_order" else 0.35), p.name


@pytest.mark.parametrize(
    ("parameter", "size", "bends_more"),
    [
        ("body_modulus__excess", 0.1, False),
        ("chamber_ballooning__growth", 0.1, True),
        ("pressure_deadband__band", 10e3, False),
        ("pressure_offset__offset", 5e3, True),
        ("area_moment__blend", 1.0, True),
        ("vacuum_leak__lost", 0.3, True),
        ("spine_shear__blend", 0.5, False),
        ("viscoelastic__slow", 0.05, False),
        ("hyperelastic__curvature", 20.0, False),
        ("hyperelastic__strain", -2.0, True),
        ("base_compliance__give", 0.01, True),
        ("contact__stiffness", 300.0, False),
        ("tether_load__spring", 5.0, False),
        ("spine_slip__moment", 0.15, False),
    ],
)
def test_an_effect_bends_the_robot_the_way_its_law_says(sweep: Moved, parameter: str, size: float, bends_more: bool) -> None:
    design = sweep.forward.design
    # Shortly before the top of the load branch, with a middle spine: every effect is at work there.
    row = int(np.flatnonzero((design.spine_length == 0.15) & (design.pressure.max(axis=1) == 200e3))[0])
    along = -sweep.by(**{parameter: size})[row, 0]
    assert (along > 1e-4) if bends_more else (along < -1e-4)


def test_effects_add_to_first_order_and_any_subset_works_together(sweep: Moved) -> None:
    one = sweep.by(base_tilt__x=0.002)
    two = sweep.by(chamber_azimuth__angle=0.005)
    both = sweep.by(base_tilt__x=0.002, chamber_azimuth__angle=0.005)
    assert both == pytest.approx(one + two, abs=0.05 * float(np.abs(both).max()))
    straight, winding = (sweep.by(hyperelastic__curvature=20.0, chamber_twist__winding=c) for c in (0.0, 1e-6))
    assert winding == pytest.approx(straight, abs=1e-6)
    everything = {f"{s.id}__{p.name}": 0.2 * p.scale for s in CATALOGUE.values() for p in s.parameters if s.id not in ON_FORCE}
    assert np.isfinite(sweep.by(**everything)).all()


@pytest.mark.parametrize(
    "sits_on_it", [{"precurvature.x": 0.1}, {"tip_payload.mass": 0.2, "tip_payload.x": 0.05}, {"marker_offset.x": 5e-3}]
)
def test_what_sits_on_the_robot_turns_with_it_and_a_tilted_base_does_not(
    paper_robot: Robot, sits_on_it: dict[str, float]
) -> None:
    straight, rolled = (
        Moved(paper_robot, campaign(lengths=(0.1,), levels=(), unload=False, roll_deg=angle)) for angle in (0.0, 90.0)
    )
    assert rolled.by(base_tilt__x=0.02) == pytest.approx(straight.by(base_tilt__x=0.02), abs=1e-9)
    x, y, z = straight.by(sits_on_it)[0]
    assert rolled.by(sits_on_it)[0] == pytest.approx([-y, x, z], abs=1e-6)
    assert math.hypot(x, y) > 1e-3


def test_friction_makes_a_loop_that_no_rate_changes_and_relaxation_one_that_it_does(paper_robot: Robot) -> None:
    def loop(parameter: str, size: float, rate: float) -> float:
        robot = paper_robot.model_copy(update={"quoted_time": 16.0})
        made = Moved(robot, campaign(lengths=(0.2,), levels=(60e3, 120e3, 180e3), rate=rate))
        moved = made.by(**{parameter: size})[:, 0]
        up, down = moved[2], moved[4]
        return float(up - down)

    assert loop("spine_slip__moment", 0.15, 25e3) > 3e-4
    assert loop("spine_slip__moment", 0.15, 25e3) == pytest.approx(loop("spine_slip__moment", 0.15, 2.5e3), rel=1e-6)
    assert loop("viscoelastic__fast", 0.05, 25e3) > 2 * loop("viscoelastic__fast", 0.05, 2.5e3) > 0


def test_a_late_clock_shifts_states_read_on_the_fly_and_turns_its_sign_on_the_way_down(paper_robot: Robot) -> None:
    levels = (60e3, 120e3, 180e3)
    settled = Moved(paper_robot, campaign(lengths=(0.1,), levels=levels))
    assert not settled.by(time_offset__delay=0.4).any()
    moved = Moved(paper_robot, campaign(lengths=(0.1,), levels=levels, hold=0.0)).by(time_offset__delay=0.4)[:, 0]
    assert moved[2] < -1e-3 and moved[4] > 1e-3
    faster = Moved(paper_robot, campaign(lengths=(0.1,), levels=levels, hold=0.0, rate=50e3))
    assert faster.by(time_offset__delay=0.2)[2, 0] == pytest.approx(moved[2], rel=1e-9)


def test_a_dead_band_and_an_offset_differ_below_the_band_only(paper_robot: Robot) -> None:
    made = Moved(paper_robot, campaign(lengths=(0.0,), levels=(5e3, 100e3, 200e3), unload=False))
    band, offset = made.by(pressure_deadband__band=10e3), made.by(pressure_offset__offset=-10e3)
    assert band[2:] == pytest.approx(offset[2:], abs=0.06 * float(np.abs(offset).max()))
    # Neither goes below ambient: below the band both leave nothing, but an offset the other way inflates what is vented.
    assert np.abs(band[0]).max() == pytest.approx(0.0, abs=1e-12)
    assert np.abs(made.by(pressure_offset__offset=10e3)[0]).max() > 1e-3


def test_play_of_a_dead_band_follows_late_on_the_way_down(paper_robot: Robot) -> None:
    made = Moved(paper_robot, campaign(lengths=(0.0,), levels=(0.0, 100e3, 150e3, 200e3)))
    unload, p = made.forward.design.unload, made.forward.design.pressure.max(axis=1)
    slack, play = (made.by(pressure_deadband__band=10e3, pressure_deadband__play=h) for h in (0.0, 1.0))
    assert np.array_equal(slack[~unload], play[~unload]) and np.abs(slack[~unload & (p == 200e3)]).max() > 1e-3
    down = np.abs(slack[unload & (p > 0)]).max()
    assert down > 1e-3 and np.abs(play[unload & (p > 0) & (p < 190e3)]).max() < 0.02 * down
    half = made.by(pressure_deadband__band=10e3, pressure_deadband__play=0.5)
    middle = unload & (p == 100e3)
    assert half[middle, 0] == pytest.approx(0.5 * slack[middle, 0], rel=0.05)


def test_less_vacuum_softens_the_spine_like_a_leak(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.2,), levels=(150e3,), unload=False)
    columns["vacuum"] = np.array([80e3, 56e3])
    columns["trial"] = np.array([1, 2])
    for name in [f"p{c}" for c in (9, 1, 2)]:
        columns[name][:] = 150e3
    full, less = Moved(paper_robot, columns).still
    leaking = Moved(paper_robot, columns).by(vacuum_leak__lost=0.3)[0]
    # The nominal vacuum is that of most states, the stronger one of equals.
    assert less[0] - full[0] == pytest.approx(leaking[0], rel=0.01)


@pytest.mark.parametrize(
    ("borne", "growth", "softening"), [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, -0.5, 0.0), (0.0, 0.0, 20.0), (0.0, 0.0, -2.0)],
    ids=["stretches", "stretches nothing", "grows along the arc", "stiffens", "softens"],
)  # fmt: skip
def test_thrust_that_the_side_walls_balance_bends_the_body_to_an_arc_or_as_it_grows_along_it(
    paper_robot: Robot, borne: float, growth: float, softening: float
) -> None:
    """Without weight each section feels P A along its own tangent and the chambers' moment: an arc of curvature M / (EI D), times
    1 + g (3 (s / L)^2 - 1) where the thrust grows, and stretched by what the walls do not bear; D of a hyperelastic body."""
    robot = paper_robot.model_copy(update={"gravity": (0.0, 0.0, 0.0)})
    moved = Moved(robot, campaign(lengths=(0.0,), levels=(150e3, 250e3)))
    walls = {"chamber_thrust__share": 1.0, "chamber_thrust__borne": borne, "chamber_thrust__growth": growth}
    tips = moved.by(**walls, hyperelastic__curvature=softening) + moved.still
    s = (np.arange(400) + 0.5) / 400
    for pressure, tip in zip(moved.forward.design.pressure, tips, strict=True):
        push, azimuth = pressure * moved.forward.area_factor[0] * robot.chambers.area, np.deg2rad(robot.chambers.azimuths_deg)
        moment = robot.chambers.path_radius * np.hypot((push * np.sin(azimuth)).sum(), (push * np.cos(azimuth)).sum())
        bend = moment / (robot.youngs_modulus * body_of(robot).mean_second) * robot.length
        long = robot.length * (1 + (1 - borne) * push.sum() / (robot.youngs_modulus * body_of(robot).mean_area))
        x, d = softening * (bend * robot.outer_radius / robot.length) ** 2, 1.0
        for _ in range(100):
            d = 1 + x / (d**2 - 2 * min(x, 0.0))
        turned = bend / d * (s + growth * (s**3 - s))
        assert np.hypot(*tip[:2]) == pytest.approx(long * np.sin(turned).mean(), abs=1e-5)
        assert abs(tip[2]) == pytest.approx(long * np.cos(turned).mean(), abs=1e-5)


def test_contact_kinks_the_sweep_where_the_plane_stands(sweep: Moved) -> None:
    moved = sweep.by(contact__stiffness=500.0, contact__distance=-0.01)
    reach = -sweep.still[:, 0]
    assert np.abs(moved[reach < 0.04]).max() < 1e-3
    assert (np.abs(moved[reach > 0.09, 0]) > 0.01).all()
    at_rest, near = (sweep.by(contact__stiffness=500.0, contact__distance=d) for d in (-0.07, -0.065))  # 0 and 5 mm off the axis
    assert np.abs(at_rest - near).max() > 1e-3


def test_a_force_reading_has_bias_arm_and_a_late_touch_that_may_be_a_soft_layer_squeezed_flat(paper_robot: Robot) -> None:
    y = np.array([0.0, 0.5e-3, 1e-3, 2e-3, 3e-3, 4e-3])
    made = Moved(paper_robot, pushes("spine", [0.1], y), None)
    stiffness, layer = 3 * 1.323e6 * math.pi / 4 * 0.029**4 / 0.1**3, 100.0

    def read(name: str, size: float, **more: float) -> Array:
        return made.forward.predict(made.vector({name: size}, **more))

    assert read("force_bias.bias", 0.0) == pytest.approx(stiffness * y)
    assert read("force_bias.bias", 0.2) == pytest.approx(stiffness * y + 0.2)
    assert read("arm_compliance.give", 1e-4) == pytest.approx(y / (1 / stiffness + 1e-4))
    assert read("contact_offset.offset", 1.5e-3) == pytest.approx(stiffness * np.maximum(y - 1.5e-3, 0))
    assert read("vacuum_leak.lost", 0.36)[-1] < 0.9 * stiffness * y[-1]
    assert read("touch.late[trial=1]", -1e-3) == pytest.approx(stiffness * (y + 1e-3))
    assert read("zero.force[trial=1]", 0.1) == pytest.approx(stiffness * y + 0.1)
    assert read("contact_offset.layer", layer) == pytest.approx(stiffness * y)
    squeezed = np.where(y <= 1e-3, y / (1 / stiffness + 1 / layer), stiffness * (y - 1e-3))
    assert read("contact_offset.offset", 1e-3, contact_offset__layer=layer) == pytest.approx(squeezed)


def test_a_shear_soft_spine_gives_the_papers_table_of_moduli(paper_robot: Robot) -> None:
    made = Moved(paper_robot, pushes("spine", sorted(paper_robot.spine.modulus), [1e-3]), None)
    table, soft = (made.forward.predict(made.vector(spine_shear__blend=w)) for w in (0.0, 1.0))
    assert 0 < np.sqrt(np.mean(np.log(soft / table) ** 2)) < 0.08


def test_a_robot_without_spine_or_with_other_chambers_has_the_same_catalogue(paper_robot: Robot) -> None:
    three = {**paper_robot.chambers.model_dump(), "azimuths_deg": (0.0, 120.0, 240.0)}
    plain = robot_from_dict({**paper_robot.model_dump(), "spine": None, "area_factor": 1.4, "chambers": three})
    columns = campaign(lengths=(0.0,), levels=(80e3,), chambers=(1,))
    for c in range(4, 10):
        del columns[f"p{c}"]
    made = Moved(plain, columns)
    assert made.still[1, 0] < -0.01
    assert np.abs(made.by(spine_slip__moment=0.1)).max() < 1e-12


def test_regulators_that_lag_follow_a_first_order_low_pass(paper_robot: Robot) -> None:
    tau, rate, hold = 1.5, 25e3, 1.0
    forward = Moved(paper_robot, campaign(lengths=(0.1,), levels=(50e3, 100e3, 150e3), rate=rate, hold=hold)).forward
    design, q = forward.design, copy.copy(forward._baseline)
    CATALOGUE["pressure_lag"].law.before(q, {"constant": np.array([[tau]])})  # type: ignore[misc]
    held, last, wanted = 0.0, 0.0, []
    for goal in design.pressure.max(axis=1):
        for start, end, duration in ((last, goal, abs(goal - last) / rate), (goal, goal, hold)):
            for t in np.arange(0.0, duration, 1e-3):
                asked = start + (end - start) * (t + 5e-4) / duration
                held += (asked - held) * -np.expm1(-1e-3 / tau)
        last = goal
        wanted.append(held)
    found = q.pressure[0, : len(design)].max(axis=1)
    assert found == pytest.approx(wanted, abs=60.0) and np.abs(found - design.pressure.max(axis=1)).max() > 8e3


# ------------------------------------------------------------------ mounted anew, and where an obstacle touches
LEVELS = (100e3, 200e3)


def test_each_further_mounting_has_tolerances_that_act_on_it_alone(paper_robot: Robot) -> None:
    rolls = ((0.0, (0.0, 0.1)), (90.0, (0.0,)))
    made = Moved(paper_robot, joined(*(campaign(lengths, levels=LEVELS, roll_deg=roll) for roll, lengths in rolls)))
    own = [p.name for p in made.forward.parameters if p.name.startswith("mount_")]
    assert len(own) == 6 and all(name.endswith("[roll=90 deg]") for name in own)
    moved = np.abs(made.by({"mount_turn.x[roll=90 deg]": 0.01})).max(axis=1)
    rolled = made.forward.design.roll > 1
    assert (moved[rolled] > 1e-3).all() and (moved[~rolled] < 1e-12).all()


def test_what_is_done_on_another_day_may_be_mounted_anew(paper_robot: Robot) -> None:
    def again(later: float, restart: bool = False) -> Moved:
        """The same twice, the second time begun `later` s after the first; with times of each trial's own."""
        columns = joined(*2 * [campaign((0.0, 0.1), LEVELS)])
        first, second = (columns["trial"] == k for k in (1, 3))
        columns["t"] = columns["t"] + (columns["trial"] > 2) * (later + columns["t"][first][0] - columns["t"][second][0])
        if restart:
            for trial in np.unique(columns["trial"]):
                columns["t"][columns["trial"] == trial] -= columns["t"][columns["trial"] == trial][0]
        return Moved(paper_robot, columns)

    def mountings(made: Moved) -> list[str]:
        return [p.name for p in made.forward.parameters if p.name.startswith("mount_turn")]

    other, long = again(1e5), float(campaign((0.0, 0.1), LEVELS)["t"].max())
    assert mountings(other) == mountings(again(0.0)) == [f"mount_turn.{a}[roll=0 deg, sitting 2]" for a in "xyz"]
    assert mountings(again(long + 60.0)) == mountings(again(1e5, restart=True)) == []
    moved = np.abs(other.by({"mount_turn.x[roll=0 deg, sitting 2]": 0.01})).max(axis=1)
    sitting = other.forward.design.sitting
    assert ((moved > 1e-3) == (sitting == 1)).all() and set(sitting) == {0, 1}


def test_each_repeat_of_the_sweep_may_be_mounted_anew(paper_robot: Robot) -> None:
    made, alone = (Moved(paper_robot, campaign((0.1,), LEVELS, repeats=n)) for n in (2, 1))
    own = [p for p in made.forward.parameters if p.name.startswith("repeat_")]
    assert len(own) == 12 and all(p.recurs for p in own)
    moved, again = np.abs(made.by({"repeat_shift.y[repeat=2]": 1e-3})), made.forward.design.repeat == 2
    assert moved[again, 1] == pytest.approx(1e-3) and (moved[~again] < 1e-12).all()
    assert not [p.name for p in alone.forward.parameters if p.name.startswith("repeat_")]


@pytest.mark.parametrize("timed", [True, False])
def test_the_modulus_drifts_from_the_first_state_to_the_last(paper_robot: Robot, timed: bool) -> None:
    columns = campaign(lengths=(0.0,), levels=LEVELS, repeats=3)
    if not timed:
        del columns["t"]
    made = Moved(paper_robot, columns)
    at_top = (made.forward.design.pressure.max(axis=1) == LEVELS[-1]) & ~made.forward.design.unload
    first, middle, last = made.by(drift__slope=-0.1)[at_top]
    assert abs(middle[0]) < 0.2 * abs(last[0]) and np.sign(first[0]) == -np.sign(last[0])
    stiff = made.still[at_top][-1]
    assert np.linalg.norm((stiff + last)[:2]) > np.linalg.norm(stiff[:2]) and np.linalg.norm(last) > 1e-3


def test_pressures_that_change_move_the_baseline_as_the_model_says(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0,), levels=LEVELS, unload=False)
    made = Moved(paper_robot, columns)
    change = np.where(made.forward.design.pressure > 0, 1e3, 0.0)
    more = Moved(paper_robot, columns | {f"p{i + 1}": columns[f"p{i + 1}"] + change[:, i] for i in range(9)})
    assert made.forward.respond(change).reshape(-1, 3) == pytest.approx(more.still - made.still, abs=1e-7)


@pytest.mark.parametrize("stiff_end", [1e-6, 0.03])
def test_an_obstacle_touches_the_body_where_its_lever_says(paper_robot: Robot, stiff_end: float) -> None:
    lever, soft_end = 0.06, Section(length=paper_robot.length - stiff_end)
    robot = paper_robot.model_copy(update={"sections": (soft_end, Section(length=stiff_end, bending_stiffness=50.0))})
    made = Moved(robot, campaign(lengths=(0.0,), levels=(100e3, 150e3), unload=False))
    here = made.forward._solved(made.vector(contact__stiffness=1e-3, contact__lever=lever)).final
    point = np.full((len(here.rows), 1, 3), [0.0, 0.0, paper_robot.length - lever])
    there = solve_rows(here.layout, here.rows, point, here.steps).result
    wall = at.SPRINGS + 2 * at.SPRING_WIDTH
    arm = to_base(there[:, at.ORIENTATION : at.ORIENTATION + 4], here.rows[:, wall + col.SPRING_ARM : wall + col.SPRING_ARM + 3])
    touched = there[:, :3] - arm
    assert np.abs(touched - there[:, at.MARKERS : at.MARKERS + 3]).max() < 2e-4


def test_an_obstacle_that_faces_away_pushes_sideways(paper_robot: Robot) -> None:
    made = Moved(paper_robot, campaign(lengths=(0.0,), levels=(150e3,), unload=False))
    straight, turned = (made.tips(contact__stiffness=200.0, contact__turn=turn)[-1] for turn in (0.0, 0.3))
    assert abs(turned[1] - straight[1]) > 2e-3
