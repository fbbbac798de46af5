"""Each effect leaves its own signature, and none at all at size zero."""

from __future__ import annotations

import numpy as np
import pytest

from sim_fakes.plant import Plant
from sim_fakes.virtual_robot import (
    Condition,
    Effect,
    Reading,
    RobotTruth,
    VirtualRobot,
    draw_effect,
    list_effects,
    walk,
)

ALONG_X = RobotTruth(canonical_directions=True)
SCALES = {info.id: info.scale for info in list_effects()}


def bend(pressure: float) -> tuple[float, ...]:
    """Chambers 9, 1 and 2 at a pressure in Pa."""
    return tuple(pressure if i in (8, 0, 1) else 0.0 for i in range(9))


def up(length: float = 0.2, hold: float = 5.0, rate: float = 20e3) -> list[Condition]:
    return [Condition(length, bend(p), hold=hold, rate=rate) for p in (0.0, 50e3, 100e3, 150e3, 200e3, 250e3)]


def there_and_back(length: float = 0.2, hold: float = 5.0, rate: float = 20e3) -> list[Condition]:
    rising = up(length, hold, rate)
    return rising + rising[-2::-1]


def tips(readings: list[Reading]) -> np.ndarray:
    return np.array([r.position for r in readings]) * 1e3


def change(states: list[Condition], truth: RobotTruth = ALONG_X, **effects: float) -> np.ndarray:
    """Tip of a robot with these effects minus tip without, mm, (states, 3)."""
    return tips(walk(VirtualRobot(truth, effects), states)) - tips(walk(VirtualRobot(truth), states))


def loop(readings: list[Reading]) -> float:
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


@pytest.mark.parametrize("effect", sorted(SCALES))
def test_effect_of_size_zero_is_the_baseline_to_the_last_bit(effect: str) -> None:
    with_zero = walk(VirtualRobot(RobotTruth(), {effect: 0.0}, seed=5), EVERYWHERE)
    baseline = walk(VirtualRobot(RobotTruth(), seed=5), EVERYWHERE)
    for a, b in zip(with_zero, baseline, strict=True):
        assert np.array_equal(a.position, b.position) and np.array_equal(a.rotation, b.rotation)
        assert np.array_equal(a.markers, b.markers)
        assert (a.force, a.pressures, a.vacuum) == (b.force, b.pressures, b.vacuum)


SEEN_ELSEWHERE = {
    "time_offset",
    "force_bias",
    "arm_compliance",
    "contact_offset",
    "drift",
    "temperature_step",
    "chamber_order",
    "tendon_friction",
}


@pytest.mark.parametrize("effect", sorted(set(SCALES) - SEEN_ELSEWHERE))
def test_effect_of_plausible_size_moves_the_tip_by_millimetres(effect: str) -> None:
    # the second jamming is the bad one; it takes a second jamming to see it
    states = [*up(0.1), *up(0.3), *up(0.0)]
    moved = np.abs(change(states, **{effect: SCALES[effect]})).max()
    assert 0.5 < moved < 150


def test_slip_makes_a_loop_that_does_not_care_about_the_rate() -> None:
    fast, slow = (
        walk(VirtualRobot(effects={"spine_slip": 0.15}), there_and_back(0.3, rate=rate)) for rate in (50e3, 5e3)
    )
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


def test_slip_grows_with_its_size() -> None:
    small, large = (loop(walk(VirtualRobot(effects={"spine_slip": s}), there_and_back(0.3))) for s in (0.05, 0.2))
    assert 2.5 < large / small < 5


def test_creep_makes_a_loop_that_depends_on_rate_and_hold() -> None:
    quick, slow = (
        walk(VirtualRobot(effects={"viscoelastic": 0.05}), there_and_back(0.0, hold, rate))
        for hold, rate in ((1.0, 50e3), (300.0, 1e3))
    )
    assert loop(quick) > 1.0
    assert loop(slow) < 0.3 * loop(quick)


def test_creep_goes_on_while_a_pressure_is_held() -> None:
    robot = VirtualRobot(effects={"viscoelastic": 0.05})
    x = [r.position[0] for r in walk(robot, [Condition(0.0, bend(150e3), hold=h) for h in (0.5, 5.0, 20.0, 200.0)])]
    assert x[0] > x[1] > x[2] > x[3]
    assert 0.03 < (x[3] - x[0]) / x[0] < 0.08


def test_hyperelastic_softens_more_the_more_it_bends() -> None:
    dx = change(up(0.0), hyperelastic=1.0)[:, 0]
    assert abs(dx[1]) < 1.0
    assert dx[5] < 3 * dx[3] < 0


def test_ballooning_is_felt_at_high_pressure() -> None:
    dx = change(up(0.0), chamber_ballooning=0.15)[:, 0]
    assert -1.0 < dx[1] < 0 and dx[5] < -20
    assert change(up(0.0), chamber_ballooning=-0.15)[5, 0] > 20


def test_deadband_takes_a_fixed_pressure_away() -> None:
    shifted = tips(walk(VirtualRobot(ALONG_X, {"pressure_deadband": 10e3}), [Condition(0.1, bend(150e3))]))
    lower = tips(walk(VirtualRobot(ALONG_X), [Condition(0.1, bend(140e3))]))
    assert shifted == pytest.approx(lower, abs=0.05)


def test_pressure_offset_lengthens_a_robot_whose_sensors_read_zero() -> None:
    robot = VirtualRobot(ALONG_X, {"pressure_offset": 5e3})
    (reading,) = walk(robot, [Condition(0.0)])
    assert reading.pressures == (0.0,) * 9
    assert 0.5 < change([Condition(0.0)], pressure_offset=5e3)[0, 2] < 1.5


def test_area_moment_asks_for_a_softer_long_spine() -> None:
    assert change(up(0.0), area_moment=1.0) == pytest.approx(0.0, abs=1e-9)
    assert change(up(0.2), area_moment=1.0)[5, 0] < -10


def test_one_spine_modulus_stiffens_most_where_the_table_is_lowest() -> None:
    short, long = (change(up(n), spine_shear=1.0)[4, 0] for n in (0.1, 0.3))
    assert short > long > 0


def test_leak_softens_and_the_gauge_sees_most_of_it() -> None:
    robot = VirtualRobot(ALONG_X, {"vacuum_leak": 0.3})
    (reading,) = walk(robot, [Condition(0.15, bend(200e3))])
    assert 1 - reading.vacuum / 80e3 == pytest.approx(0.8 * 0.3, abs=0.02)
    assert change([Condition(0.15, bend(200e3))], vacuum_leak=0.3)[0, 0] < -3


def test_length_offset_acts_like_a_longer_spine_that_reads_the_same() -> None:
    robot = VirtualRobot(ALONG_X, {"spine_length_offset": 0.012})
    (reading,) = walk(robot, [Condition(0.2, bend(200e3))])
    (longer,) = walk(VirtualRobot(ALONG_X), [Condition(0.212, bend(200e3))])
    assert reading.spine_length == 0.2
    assert reading.position == pytest.approx(longer.position, abs=1e-6)


def test_weight_and_modulus_show_in_the_length_under_load() -> None:
    assert change([Condition(0.0)], self_weight=0.12)[0, 2] > 0.1
    assert change([Condition(0.0)], body_modulus=0.12)[0, 2] < -0.1


def test_tilt_stays_and_precurvature_turns_when_the_robot_is_rolled() -> None:
    states = [Condition(0.0), Condition(0.0, roll=np.radians(90))]
    tilt, curve = change(states, base_tilt=0.026), change(states, precurvature=0.12)
    assert tilt[1] == pytest.approx(tilt[0], abs=1e-6)
    assert tilt[0, 0] > 5
    assert curve[1, :2] == pytest.approx([-curve[0, 1], curve[0, 0]], abs=1e-6)
    assert curve[0, 0] > 3


def test_tether_pulls_the_same_way_whatever_the_roll() -> None:
    pulled = change([Condition(0.0), Condition(0.0, roll=np.radians(90))], tether_load=0.35)
    assert pulled[0, 0] > 2
    assert pulled[1] == pytest.approx(pulled[0], abs=1e-6)


def test_soft_base_gives_under_moment_only() -> None:
    given = change([Condition(0.0), Condition(0.0, bend(200e3))], base_compliance=0.025)
    assert given[0] == pytest.approx(0.0, abs=1e-6)
    assert given[1, 0] < -5


def test_turned_chambers_bend_out_of_the_plane_and_twisted_ones_the_more() -> None:
    azimuth, twist = (change(up(0.1), **e)[:, 1] for e in ({"chamber_azimuth": 0.105}, {"chamber_twist": 0.35}))
    assert azimuth[5] < -3 and twist[5] < -3
    assert change(up(0.1), chamber_azimuth=-0.105)[5, 1] == pytest.approx(-azimuth[5], rel=1e-6)


def test_obstacle_is_felt_only_beyond_its_place() -> None:
    held = change(up(0.0), contact=300.0)[:, 0]
    assert held[:2] == pytest.approx(0.0, abs=1e-9)
    assert held[5] > 20


def test_camera_frame_turns_everything_and_marker_offset_turns_with_the_tip() -> None:
    states = [Condition(0.0), Condition(0.0, bend(200e3))]
    plain = walk(VirtualRobot(ALONG_X), states)
    turned = walk(VirtualRobot(ALONG_X, {"frame_misalignment": 0.02}), states)
    c, s = np.cos(0.02), np.sin(0.02)
    frame = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    offset = walk(VirtualRobot(ALONG_X, {"marker_offset": 0.006}), states)
    for p, t, o in zip(plain, turned, offset, strict=True):
        assert t.position == pytest.approx(frame @ p.position, abs=1e-9)
        assert t.rotation == pytest.approx(frame @ p.rotation, abs=1e-9)
        assert t.markers == pytest.approx(p.markers @ frame.T, abs=1e-9)
        assert o.position - p.position == pytest.approx(p.rotation @ [0.006, 0, 0], abs=1e-9)


@pytest.mark.parametrize("offset", [0.4, -0.4])
def test_time_offset_shifts_the_tip_against_the_pressure_while_ramping(offset: float) -> None:
    rate = 20e3
    states = [Condition(0.0, bend(150e3), hold=0.0, rate=rate), Condition(0.0, bend(200e3), hold=10.0, rate=rate)]
    ramping, settled = walk(VirtualRobot(ALONG_X, {"time_offset": offset}), states)
    plain_ramping, plain = walk(VirtualRobot(ALONG_X), states)
    assert settled.position == pytest.approx(plain.position, abs=1e-6)
    assert settled.pressures == pytest.approx(plain.pressures)
    if offset > 0:
        (earlier,) = walk(VirtualRobot(ALONG_X), [Condition(0.0, bend(150e3 - rate * offset), hold=0.0, rate=rate)])
        assert ramping.position == pytest.approx(earlier.position, abs=3e-4)
    else:
        assert ramping.pressures[0] == pytest.approx(150e3 + rate * offset, abs=300)
        assert ramping.position == pytest.approx(plain_ramping.position, abs=3e-4)


def test_published_tip_lags_behind_the_plant() -> None:
    late, prompt = (Plant(), VirtualRobot(ALONG_X, {"time_offset": 0.4})), (Plant(), VirtualRobot(ALONG_X))
    seen: list[list[float]] = [[], []]
    for i in range(200):
        for k, (plant, robot) in enumerate((late, prompt)):
            plant.regulator[:] = bend(100e3 if i > 20 else 0.0)
            robot.advance(plant, 0.02)
            seen[k].append(float(plant.tip_position[0]))
    assert seen[0][40:] == pytest.approx(seen[1][20:-20], abs=1e-5)


def test_drift_and_temperature_soften_as_the_campaign_goes_on() -> None:
    for effect in ("drift", "temperature_step"):
        robot = VirtualRobot(ALONG_X, {effect: SCALES[effect]})
        states = [Condition(0.0, bend(150e3), hold=10), Condition(0.0, bend(150e3), hold=3600)]
        early, late = walk(robot, states)
        assert late.position[0] < early.position[0] - 2e-3


def test_effects_add_up_and_any_subset_may_be_on() -> None:
    robot = VirtualRobot(RobotTruth(), [Effect(i, 0.3 * s) for i, s in SCALES.items()], seed=2)
    readings = walk(robot, EVERYWHERE)
    assert all(np.all(np.isfinite(r.position)) for r in readings)


def test_effects_that_do_not_exist_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="unknown effect 'slip'"):
        VirtualRobot(effects={"slip": 1.0})
    with pytest.raises(ValueError, match="given twice"):
        VirtualRobot(effects=[Effect("drift", 0.1), Effect("drift", 0.2)])
    with pytest.raises(ValueError, match="finite"):
        VirtualRobot(effects={"drift": float("nan")})


def test_drawn_sizes_stay_within_half_and_one_and_a_half_of_the_scale() -> None:
    rng = np.random.default_rng(0)
    infos = {info.id: info for info in list_effects()}
    seen = set()
    for _ in range(600):
        name, size = draw_effect(rng)
        info = infos[name]
        seen.add((name, size > 0))
        assert info.catalogue
        low, high = (0.6, 1.0) if info.sign == "blend" else (0.5, 1.5)
        assert low <= abs(size) / info.scale <= high
        assert size > 0 or info.sign == "both"
    assert {name for name, _ in seen} == {i.id for i in infos.values() if i.catalogue and not i.on_request}
    assert draw_effect(rng, ["drift"])[0] == "drift"


def group(chambers: tuple[int, ...], pressure: float = 150e3) -> list[Condition]:
    return [Condition(0.0, tuple(pressure if i + 1 in chambers else 0.0 for i in range(9)))]


def test_exchanged_hoses_bend_to_another_side_from_half_on() -> None:
    second, third = (3, 4, 5), (6, 7, 8)
    wrong, right = (tips(walk(VirtualRobot(ALONG_X, {"chamber_order": size}), group(second))) for size in (1.0, 0.4))
    assert right == pytest.approx(tips(walk(VirtualRobot(ALONG_X), group(second))))
    assert wrong == pytest.approx(tips(walk(VirtualRobot(ALONG_X), group(third))), abs=1e-6)
    assert change(group((9, 1, 2)), chamber_order=1.0) == pytest.approx(0.0, abs=1e-9)


def test_chambers_of_unlike_cores_push_unlike() -> None:
    first, opposite = (np.linalg.norm(change(group(c), chamber_gain=0.1)) for c in ((9, 1, 2), (5, 6)))
    assert min(first, opposite) > 1.0
    robot = VirtualRobot(ALONG_X, {"chamber_gain": 0.1})
    robot.pneumatics.seen[:] = 100e3
    assert np.ptp(robot.pneumatics.forces()) > 0.15 * robot.pneumatics.forces().mean()


def test_a_payload_has_its_weight_and_a_lever_that_turns() -> None:
    aside = change([Condition(0.0)], tip_payload=0.1)[0]
    assert abs(aside[0]) > 0.5 and abs(aside[1]) < 1e-3 and aside[2] > 0.1
    rolled = change([Condition(0.0, roll=np.radians(90))], tip_payload=0.1)[0]
    assert rolled[1] == pytest.approx(aside[0], rel=1e-3)


def test_a_rest_shape_comes_of_being_bent_and_recovers_half() -> None:
    rest = Condition(0.0, bend(0.0))
    first, after, late = change([rest, Condition(0.0, bend(250e3)), rest, Condition(0.0, hold=1e4)], rest_shape=0.05)[
        [0, 2, 3], 0
    ]
    assert abs(first) < 0.1 and after < -2.0
    assert late == pytest.approx(after / 2, rel=0.15)
