"""Effects that robots of other laboratories asked for: chambers that differ or are exchanged, a payload, a shape that is kept."""

from typing import Any

import numpy as np
import pytest

from model import rods as rod
from model.arrays import Array
from model.condition import States
from model.effects import CATALOGUE, design_from_columns
from model.effects import layout as at
from model.effects.laws.actuation import orders
from model.effects.solver import METHOD, rods_from
from model.robot import Robot
from model.rods import columns as col
from model.rotation import to_base
from tests.model.effects.campaigns import Moved, campaign, joined
from tests.model.effects.test_history import unchanged

GROUPS = ((9, 1, 2), (3, 4, 5), (6, 7, 8))

SHORT: dict[str, Any] = {"lengths": (0.0, 0.2), "levels": (80e3, 160e3)}
ONE_SIDE, THREE_SIDES = campaign(**SHORT), joined(*(campaign(**SHORT, chambers=c) for c in GROUPS))
ALL_AT_ONCE = joined(ONE_SIDE, campaign(lengths=(0.0,), levels=(80e3,), chambers=range(1, 10)))
FIRST_SWEEP, TIME = campaign(lengths=(0.0,), unload=False), campaign(lengths=(0.1, 0.2))
READ = TIME | {f"p{c}": TIME[f"p{c}"] + np.random.default_rng(c).normal(0, 50.0, len(TIME["p1"])) for c in range(1, 10)}


@pytest.mark.parametrize(
    ("id", "shows", "hides"),
    [
        ("chamber_gain", (THREE_SIDES, ALL_AT_ONCE), (ONE_SIDE,)),
        ("chamber_order", (THREE_SIDES,), (ONE_SIDE, ALL_AT_ONCE)),
        ("rest_shape", (ONE_SIDE,), (FIRST_SWEEP,)),
        ("pressure_lag", (TIME,), (READ,)),  # whether regulators lag is not asked of a table of readings
    ],
)
def test_an_effect_is_asked_for_where_a_campaign_can_show_it(paper_robot: Robot, id: str, shows: Any, hides: Any) -> None:
    shown = CATALOGUE[id].shown
    assert shown is not None
    assert all(shown(paper_robot, design_from_columns(paper_robot, columns)) for columns in shows)
    assert not any(shown(paper_robot, design_from_columns(paper_robot, columns)) for columns in hides)


@pytest.mark.parametrize(
    ("id", "sizes"),
    [
        ("chamber_gain", {"x": 0.08, "y": -0.05, "single": 0.1}),
        ("chamber_order", {"blend": 0.6, "which": 1.4}),
        ("tip_payload", {"mass": 0.15, "x": 0.02, "y": -0.01, "z": 0.04}),
        ("rest_shape", {"kept": 0.04, "recovery": 8e-4}),
    ],
)
def test_derivatives_are_those_of_differences_where_several_sides_are_inflated(
    paper_robot: Robot, id: str, sizes: dict[str, float]
) -> None:
    forward = Moved(paper_robot, THREE_SIDES, catalogue={id: CATALOGUE[id]}).forward
    own, theta = forward.index(id), np.zeros(len(forward.parameters))
    theta[own] = list(sizes.values())
    _, slope = forward.linearise(theta, own)
    for k, column in zip(own, slope.T, strict=True):
        step = 2e-4 * forward.parameters[k].sd * (np.arange(len(theta)) == k)
        difference = (forward.predict(theta + step) - forward.predict(theta - step)) / (2 * step[k])
        assert column == pytest.approx(difference, abs=2e-3 * float(np.abs(difference).max())) and np.abs(difference).max() > 0


def test_a_gain_is_no_area_factor_where_several_sides_are_inflated_and_nothing_else_with_one(paper_robot: Robot) -> None:
    left = []  # of what the effect does, by the area factor and a turned pattern
    for columns in (THREE_SIDES, ONE_SIDE):
        forward = Moved(paper_robot, columns).forward
        _, slope = forward.linearise(np.zeros(len(forward.parameters)))
        own = slope[:, forward.index("chamber_gain")[:2]]
        others = slope[:, [*forward.index("area"), *forward.index("chamber_azimuth")]]
        rest = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
        left.append(np.linalg.norm(rest) / np.linalg.norm(own))
    assert left[0] > 0.5 and left[1] < 0.05


def areas(robot: Robot, design: States, **values: float) -> Array:
    q = unchanged(robot, design)
    given = {name: np.full((1, 1), values.get(name, 0.0)) for name in ("x", "y", "single")}
    before = CATALOGUE["chamber_gain"].law.before
    assert before is not None
    before(q, given)
    return q.area_factor[0, 0]


def test_gains_leave_the_mean_and_range_over_twice_their_size(paper_robot: Robot) -> None:
    design = design_from_columns(paper_robot, THREE_SIDES)
    for x, single in ((-0.1, -1.0), (0.1, 0.0), (0.1, 1.0)):
        area = areas(paper_robot, design, x=x, single=single)
        assert area.mean() == pytest.approx(1.0) and 0.16 < np.ptp(area) < 0.2001
    strong = np.sort(areas(paper_robot, design, x=0.1, single=1.0))
    weak = np.sort(areas(paper_robot, design, x=0.1, single=-1.0))
    assert np.argmax(areas(paper_robot, design, y=0.1, single=1.0)) in (2, 3)
    assert np.median(strong) < 1 < np.median(weak)


def test_three_chambers_have_every_set_of_gains(paper_robot: Robot) -> None:
    chambers = paper_robot.chambers.model_copy(update={"azimuths_deg": (0.0, 120.0, 240.0)})
    robot = paper_robot.model_copy(update={"chambers": chambers})
    along = np.deg2rad(chambers.azimuths_deg)
    made = np.stack([np.ones(3), np.cos(along), np.sin(along)])
    design = design_from_columns(
        robot, {"trial": np.ones(1, int), "spine_length": np.zeros(1), "p1": np.full(1, 1e5), "x": np.zeros(1)}
    )
    assert areas(robot, design, x=0.1, y=0.03) == pytest.approx(np.array([1, 0.1, 0.03]) @ made)


@pytest.mark.parametrize("place", range(5))
def test_exchanged_chambers_are_a_table_with_exchanged_columns(paper_robot: Robot, place: int) -> None:
    order = orders(paper_robot.chambers.azimuths_deg)[place]
    assert sorted(order.tolist()) == list(range(9)) and (order != np.arange(9)).any()
    exchanged = THREE_SIDES | {f"p{i + 1}": THREE_SIDES[f"p{order[i] + 1}"] for i in range(9)}
    here = Moved(paper_robot, THREE_SIDES)
    there = here.tips(chamber_order__blend=1.0, chamber_order__which=place - 2.0)
    assert there == pytest.approx(Moved(paper_robot, exchanged).still, abs=1e-5)
    assert np.abs(there - here.still).max() > 0.1


@pytest.mark.parametrize(("count", "ways"), [(1, 0), (2, 1), (3, 5), (4, 5), (9, 5)])
def test_orders_of_a_ring_are_different_ones(count: int, ways: int) -> None:
    found = {tuple(o) for o in orders(np.linspace(0, 360, count, endpoint=False).tolist()).tolist()}
    assert len(found - {tuple(range(count))}) == ways


def test_a_payload_at_the_tip_itself_is_a_tip_mass(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3), unload=False)
    light, heavy = (Moved(paper_robot, columns | {"tip_mass": np.full(len(columns["t"]), mass)}) for mass in (0.05, 0.15))
    assert light.tips(tip_payload__mass=0.1) == pytest.approx(heavy.still, abs=2e-6)
    # 0.05 kg at the tip and 0.1 kg at 60 mm have their centre at 40 mm
    hanging = Moved(paper_robot.replace(tip_mass_place=0.04), columns | {"tip_mass": np.full(len(columns["t"]), 0.15)})
    assert light.tips(tip_payload__mass=0.1, tip_payload__z=0.06) == pytest.approx(hanging.still, abs=2e-6)
    assert np.abs(hanging.still - heavy.still).max() > 2e-4


def test_the_moment_of_a_payload_is_its_weight_at_a_lever_that_turns_with_the_tip(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3), unload=False)
    made, lever, mass = Moved(paper_robot, columns), np.array([0.03, -0.02, 0.05]), 0.3
    payload = dict(zip(("tip_payload.x", "tip_payload.y", "tip_payload.z"), lever, strict=True))
    final = made.forward._solved(made.vector(payload, tip_payload__mass=mass)).final
    spring = at.SPRINGS + 3 * at.SPRING_WIDTH
    plain = final.rows.copy()
    plain[:, spring + col.SPRING_STIFFNESS] = 0.0
    weight = mass * np.array(paper_robot.gravity)
    plain[:, col.DEAD_FORCE : col.DEAD_FORCE + 3] += weight
    held = rods_from(final.layout, plain)
    turned = to_base(final.result[:, at.ORIENTATION : at.ORIENTATION + 4], np.broadcast_to(lever, (len(plain), 3)))
    held.field("dead_moment")[:] = np.cross(turned, weight)
    again = rod.solve(held, METHOD)
    assert again.tip == pytest.approx(final.result[:, :3], abs=1e-5)
    held.field("dead_moment")[:] = 0.0
    assert np.abs(rod.solve(held, METHOD).tip - again.tip).max() > 2e-3


def test_a_body_that_was_held_bent_hangs_bent_and_stays_so_in_later_trials(paper_robot: Robot) -> None:
    made = Moved(paper_robot, campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3)))
    kept, fading = (made.by(rest_shape__kept=0.03, rest_shape__recovery=r) for r in (0.0, 5e-3))
    before, after, later, *_ = np.flatnonzero(made.forward.design.pressure.max(axis=1) == 0)
    assert np.abs(kept[before]).max() < 1e-4
    # Chambers 9, 1 and 2 bend towards -x.
    assert kept[after, 0] < -3e-3 and kept[later, 0] < -1e-3
    assert abs(fading[later, 0]) < 0.8 * abs(kept[later, 0])
