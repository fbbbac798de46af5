"""Effects that robots of other laboratories asked for: chambers that differ or are exchanged, a payload, a shape that is kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from model import rods as rod
from model.condition import States
from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.effects import layout as at
from model.effects.history import DRIVES, History, loading_path
from model.effects.laws.actuation import orders
from model.effects.solver import METHOD, full_rods
from model.robot import Robot
from model.rods import columns as col
from model.rotation import to_base
from tests.model.effects.test_history import unchanged

Array = NDArray[np.float64]
Make = Callable[..., Any]
NEW = ("chamber_gain", "chamber_order", "tip_payload", "rest_shape")
GROUPS = ((9, 1, 2), (3, 4, 5), (6, 7, 8))


def joined(*parts: Any) -> Any:
    """Campaigns one after another."""
    out, trials, time = [], 0, 0.0
    for part in parts:
        out.append(dict(part) | {"trial": part["trial"] + trials, "t": part["t"] + time})
        trials, time = int(out[-1]["trial"].max()), float(out[-1]["t"].max())
    return {name: np.concatenate([part[name] for part in out]) for name in out[0]}


@pytest.fixture(scope="module")
def three_sides(make_campaign: Make) -> Any:
    return joined(*(make_campaign(lengths=(0.0, 0.2), levels=(80e3, 160e3), chambers=c) for c in GROUPS))


def forward_of(robot: Robot, columns: Any, **options: Any) -> ForwardModel:
    return ForwardModel(robot, design_from_columns(robot, columns, ("x", "y", "z")), **options)


def at_values(forward: ForwardModel, **values: float) -> Array:
    theta = np.zeros(len(forward.parameters))
    names = [p.name for p in forward.parameters]
    for name, value in values.items():
        theta[names.index(name.replace("__", "."))] = value
    return theta


def shown(robot: Robot, id: str, columns: Any) -> bool:
    spec = CATALOGUE[id]
    assert spec.shown is not None
    return spec.shown(robot, design_from_columns(robot, columns))


SIZES = {
    "chamber_gain": {"x": 0.08, "y": -0.05, "peak": 0.7},
    "chamber_order": {"blend": 0.6, "which": 1.4},
    "tip_payload": {"mass": 0.15, "x": 0.02, "y": -0.01, "z": 0.04},
    "rest_shape": {"kept": 0.04, "recovery": 8e-4},
}


@pytest.mark.parametrize("id", NEW)
def test_derivatives_are_those_of_differences(paper_robot: Robot, three_sides: Any, id: str) -> None:
    forward = forward_of(paper_robot, three_sides, catalogue={id: CATALOGUE[id]})
    theta = at_values(forward, **{f"{id}__{name}": value for name, value in SIZES[id].items()})
    own = forward.index(id)
    _, slope = forward.linearise(theta, own)
    for k, column in zip(own, slope.T, strict=True):
        step = np.zeros(len(theta))
        step[k] = 2e-4 * forward.parameters[k].sd
        difference = (forward.predict(theta + step) - forward.predict(theta - step)) / (2 * step[k])
        assert np.abs(difference).max() > 0
        assert column == pytest.approx(difference, abs=2e-3 * float(np.abs(difference).max()))


def left_by_calibration(forward: ForwardModel, id: str) -> float:
    """Share of what the effect does that the area factor and a turned pattern do not do as well."""
    _, slope = forward.linearise(np.zeros(len(forward.parameters)))
    own = slope[:, forward.index(id)[:2]]
    others = slope[:, [*forward.index("area"), *forward.index("chamber_azimuth")]]
    rest = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    return float(np.linalg.norm(rest) / np.linalg.norm(own))


def test_a_gain_is_no_area_factor_where_several_sides_are_inflated_and_nothing_else_with_one(
    paper_robot: Robot, make_campaign: Make, three_sides: Any
) -> None:
    one = make_campaign(lengths=(0.0, 0.2), levels=(80e3, 160e3))
    assert left_by_calibration(forward_of(paper_robot, three_sides), "chamber_gain") > 0.5
    assert left_by_calibration(forward_of(paper_robot, one), "chamber_gain") < 0.05
    assert shown(paper_robot, "chamber_gain", three_sides) and not shown(paper_robot, "chamber_gain", one)
    all_at_once = joined(one, make_campaign(lengths=(0.0,), levels=(80e3,), chambers=range(1, 10)))
    assert shown(paper_robot, "chamber_gain", all_at_once) and not shown(paper_robot, "chamber_order", all_at_once)


def areas(robot: Robot, design: States, **values: float) -> Array:
    q = unchanged(robot, design)
    given = {name: np.full((1, 1), values.get(name, 0.0)) for name in ("x", "y", "peak")}
    before = CATALOGUE["chamber_gain"].law.before
    assert before is not None
    before(q, given)
    return q.area_factor[0, 0]


def test_gains_leave_the_mean_and_range_over_twice_their_size(paper_robot: Robot, three_sides: Any) -> None:
    design = design_from_columns(paper_robot, three_sides)
    for peak in (-3.0, 0.0, 3.0):
        area = areas(paper_robot, design, x=0.1, peak=peak)
        assert area.mean() == pytest.approx(1.0) and 0.16 < np.ptp(area) < 0.2001
    strong = np.sort(areas(paper_robot, design, x=0.1, peak=3.0))
    weak = np.sort(areas(paper_robot, design, x=0.1, peak=-3.0))
    assert np.argmax(areas(paper_robot, design, y=0.1, peak=3.0)) in (2, 3)
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
def test_exchanged_chambers_are_a_table_with_exchanged_columns(paper_robot: Robot, three_sides: Any, place: int) -> None:
    order = orders(paper_robot.chambers.azimuths_deg)[place]
    assert sorted(order.tolist()) == list(range(9)) and (order != np.arange(9)).any()
    exchanged = dict(three_sides) | {f"p{i + 1}": three_sides[f"p{order[i] + 1}"] for i in range(9)}
    forward = forward_of(paper_robot, three_sides)
    there = forward.predict(at_values(forward, chamber_order__blend=1.0, chamber_order__which=place - 2.0))
    other = forward_of(paper_robot, exchanged)
    assert there == pytest.approx(other.predict(np.zeros(len(other.parameters))), abs=1e-5)
    assert np.abs(there - forward.predict(np.zeros(len(forward.parameters)))).max() > 0.1


@pytest.mark.parametrize(("count", "ways"), [(1, 0), (2, 1), (3, 5), (4, 5), (9, 5)])
def test_orders_of_a_ring_are_different_ones(count: int, ways: int) -> None:
    found = {tuple(o) for o in orders(np.linspace(0, 360, count, endpoint=False).tolist()).tolist()}
    assert len(found - {tuple(range(count))}) == ways


def test_an_order_is_asked_for_where_chambers_of_several_sides_were_inflated(
    paper_robot: Robot, make_campaign: Make, three_sides: Any
) -> None:
    assert shown(paper_robot, "chamber_order", three_sides)
    assert not shown(paper_robot, "chamber_order", make_campaign(lengths=(0.0, 0.2)))


def test_a_payload_at_the_tip_itself_is_a_tip_mass(paper_robot: Robot, make_campaign: Make) -> None:
    columns = make_campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3), unload=False)
    light = forward_of(paper_robot, columns | {"tip_mass": np.full(len(columns["trial"]), 0.05)})
    heavy = forward_of(paper_robot, columns | {"tip_mass": np.full(len(columns["trial"]), 0.15)})
    found = light.predict(at_values(light, tip_payload__mass=0.1))
    assert found == pytest.approx(heavy.predict(np.zeros(len(heavy.parameters))), abs=2e-6)


def test_the_moment_of_a_payload_is_its_weight_at_a_lever_that_turns_with_the_tip(
    paper_robot: Robot, make_campaign: Make
) -> None:
    columns = make_campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3), unload=False)
    forward = forward_of(paper_robot, columns)
    lever, mass = np.array([0.03, -0.02, 0.05]), 0.3
    theta = at_values(forward, tip_payload__mass=mass, tip_payload__x=0.03, tip_payload__y=-0.02, tip_payload__z=0.05)
    final = forward._solved(theta).final
    spring = at.SPRINGS + 3 * at.SPRING_WIDTH
    plain = final.rows.copy()
    plain[:, spring + col.SPRING_STIFFNESS] = 0.0
    weight = mass * np.array(paper_robot.gravity)
    plain[:, col.DEAD_FORCE : col.DEAD_FORCE + 3] += weight
    held = full_rods(final.layout, plain)
    turned = to_base(final.result[:, at.ORIENTATION : at.ORIENTATION + 4], np.broadcast_to(lever, (len(plain), 3)))
    held.field("dead_moment")[:] = np.cross(turned, weight)
    again = rod.solve(held, METHOD)
    assert again.tip == pytest.approx(final.result[:, :3], abs=1e-5)
    held.field("dead_moment")[:] = 0.0
    assert np.abs(rod.solve(held, METHOD).tip - again.tip).max() > 2e-3


def test_a_payload_is_rolled_with_the_robot_it_sits_on(paper_robot: Robot, make_campaign: Make) -> None:
    moved = []
    for roll in (0.0, 90.0):
        forward = forward_of(paper_robot, make_campaign(lengths=(0.0,), levels=(), unload=False, roll_deg=roll))
        theta = at_values(forward, tip_payload__mass=0.2, tip_payload__x=0.05)
        moved.append(forward.predict(theta) - forward.predict(np.zeros(len(theta))))
    (x, y, _), (u, v, _) = moved
    assert abs(x) > 1e-3 and abs(y) < 1e-6
    assert [u, v] == pytest.approx([0.0, x], abs=1e-6)


def remembered(robot: Robot, columns: Any, inner: Any, outer: Any, rate: float) -> Array:
    """(n, DRIVES) extremes where the first curvature of both parts is given (n,)."""
    design = design_from_columns(robot, columns)
    n = len(design)
    drive = np.zeros((1, n, DRIVES))
    drive[0, :, 0], drive[0, :, 4] = inner, outer
    firsts = np.array([np.flatnonzero(design.trial == k)[0] for k in range(len(design.trial_id))])
    h = History(
        unchanged(robot, design), loading_path(design, firsts), drive,
        np.ones((1, n, 2)), np.ones((1, n, 2)), np.ones((1, n, DRIVES)), np.zeros((1, n, DRIVES)),
        np.zeros((1, n, 2, 2)),
    )  # fmt: skip
    return h.extremes(np.full((1, 1), rate))[0]


def test_extremes_stay_fade_and_are_kept_by_place(paper_robot: Robot, make_campaign: Make) -> None:
    columns = make_campaign(lengths=(0.0, 0.2), levels=(100e3,))
    bent, inner = [0.0, 3.0, -1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.5, 0.0]
    for_good = remembered(paper_robot, columns, inner, bent, 0.0)
    # The largest and the least add; the part with spine remembers what it was bent to when there was none.
    assert for_good[:, 4] == pytest.approx([0.0, 3.0, 2.0, 2.0, 2.0, 2.0])
    assert for_good[3:, 0] == pytest.approx([2.0, 2.0, 2.0])
    fading = remembered(paper_robot, columns, inner, bent, 1e-2)
    t = columns["t"]
    assert fading[3, 4] == pytest.approx(3.0 * np.exp(-(t[3] - t[1]) / 100) - np.exp(-(t[3] - t[2]) / 100), rel=1e-6)


def test_a_body_that_was_held_bent_hangs_bent_and_stays_so_in_later_trials(paper_robot: Robot, make_campaign: Make) -> None:
    columns = make_campaign(lengths=(0.0, 0.2), levels=(100e3, 200e3))
    forward = forward_of(paper_robot, columns)
    still = forward.predict(np.zeros(len(forward.parameters))).reshape(-1, 3)
    kept = forward.predict(at_values(forward, rest_shape__kept=0.03)).reshape(-1, 3) - still
    fading = forward.predict(at_values(forward, rest_shape__kept=0.03, rest_shape__recovery=5e-3)).reshape(-1, 3) - still
    vented = np.flatnonzero(forward.design.pressure.max(axis=1) == 0)
    before, after, later = vented[0], vented[1], vented[2]
    assert np.abs(kept[before]).max() < 1e-4
    # Chambers 9, 1 and 2 bend towards -x.
    assert kept[after, 0] < -3e-3 and kept[later, 0] < -1e-3
    assert abs(fading[later, 0]) < 0.8 * abs(kept[later, 0])
    assert shown(paper_robot, "rest_shape", columns)
    assert not shown(paper_robot, "rest_shape", make_campaign(lengths=(0.0,), levels=(50e3, 100e3), unload=False))
