"""Each effect leaves its own signature, and none at all at size zero."""

from functools import cache

import numpy as np
import pytest

from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualReading, VirtualRobot, draw_effect, list_effects, walk
from tests.sim_fakes.test_virtual_robot import bend

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


STAND = {"force_bias", "arm_compliance", "contact_offset"}
"""Seen in pushes only, see test_virtual_robot.py."""


@pytest.mark.parametrize("effect", sorted(set(SCALES) - STAND))
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
    with pytest.raises(ValueError, match="unknown effect 'slip'"):
        VirtualRobot(effects={"slip": 1.0})
    with pytest.raises(ValueError, match="finite"):
        VirtualRobot(effects={"base_tilt": float("nan")})


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
