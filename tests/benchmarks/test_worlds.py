"""Worlds: another solver that agrees with the model, and forms of effects that vanish with their size."""

import pickle
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.worlds.campaign import STEPS, Jamming, WalkedSweep, WorldRobot, read, respond
from benchmarks.blind.worlds.carried import carried
from benchmarks.blind.worlds.forms import EFFECTS, FORMS, ON_REQUEST, physics
from benchmarks.blind.worlds.forms_held_out import FORMS_HELD_OUT
from benchmarks.blind.worlds.outside import OUTSIDE, Cause
from benchmarks.blind.worlds.outside_held_out import HELD_OUT
from benchmarks.blind.worlds.robot import NOMINAL_VACUUM, Places, lanes
from benchmarks.blind.worlds.table import BENCH, World, world
from benchmarks.blind.worlds.walk import Leg, walk
from model import rods
from model.arrays import Array
from model.condition import conditions
from model.effects.catalogue import CATALOGUE
from model.robot import load_robot
from model.section import rods_of
from tests.model.rods.reference import REFERENCE

PAPER = Path(__file__).parents[2] / "examples" / "paper" / "robot.yaml"
SPINES = np.array([0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30])
PLACES = Places(0.5, 0.3, 0.4, 1.0, 0.8, (0.6, 0.64, 0.48))
NOT_OF_A_SWEEP = {"force_bias", "arm_compliance", "contact_offset", "tendon_friction", "tendon_slack", "pressure_lag"}
"""Effects of pushes and of robots with tendons."""
UNDRAWN = {"rest_shape"}
"""Of the catalogue, without a form in any world."""


def bent(kilopascal: float) -> tuple[float, ...]:
    return tuple(kilopascal * 1e3 if i in (8, 0, 1) else 0.0 for i in range(9))


UP_AND_DOWN = tuple(Leg(bent(p), 5e3, 5.0 if p == 0 else 0.0) for p in (0, 100, 200, 100, 0))


@cache
def tips(effect: str = "", form: str = "", size: float = 0.9) -> Array:
    """(5, 3, 3) of three spine lengths, on a coarse mesh, with one effect or outside cause."""
    spines = np.array([0.0, 0.1, 0.3])
    known = {**OUTSIDE, **HELD_OUT, **ON_REQUEST}
    causes = {effect: known[effect]} if effect in known else {}
    made = lanes(spines, {effect: np.full(3, size)} if effect else {}, PLACES)
    return walk(made, physics({effect: form} if form else {}, causes), UP_AND_DOWN, segments=8).tip


def moves(effect: str, form: str = "") -> Array:
    return tips(effect, form) - tips()


def millimetres(moved: Array) -> float:
    return float(1e3 * np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


# ------------------------------------------------------------------ the solver
def test_with_no_effect_on_the_tip_agrees_with_the_model_to_a_hundredth_of_a_millimetre() -> None:
    levels = (0.0, 50.0, 100.0, 150.0, 200.0, 250.0)
    robot = load_robot(PAPER).replace(area_factor=1.6)
    states = conditions(robot, np.repeat(SPINES, 6), np.tile([bent(p) for p in levels], (7, 1)))
    expected = rods.solve(rods_of(robot, states), REFERENCE).trusted().tip.reshape(7, 6, 3)
    legs = tuple(Leg(bent(p), 5e3, 0.0) for p in levels)
    found = {n: walk(lanes(SPINES, {}, PLACES), physics({}), legs, segments=n).tip.swapaxes(0, 1) for n in (10, 20)}
    assert np.abs(found[20] - expected).max() < 0.01e-3
    # of fourth order, so that two meshes say what a finer one would
    assert np.abs((16 * found[20] - found[10]) / 15 - expected).max() < 0.005e-3


# ------------------------------------------------------------------ forms
def test_every_effect_that_a_sweep_shows_has_three_forms_or_more() -> None:
    assert set(FORMS) == set(EFFECTS) == set(CATALOGUE) - NOT_OF_A_SWEEP - UNDRAWN - set(ON_REQUEST)
    assert all(len(forms) >= 3 for forms in FORMS.values())


@pytest.mark.parametrize("effect", FORMS)
def test_forms_of_an_effect_move_the_tip_about_alike_and_yet_no_two_do_the_same(effect: str) -> None:
    moved = [moves(effect, name) for name in (*FORMS[effect], *FORMS_HELD_OUT[effect])]
    for one in moved:
        # three spine lengths and five states are no base sweep
        assert EFFECTS[effect].moves / 5 < millimetres(one) < EFFECTS[effect].moves * 5
    for a, b in combinations(moved, 2):
        size = float(np.sum(a * b) / np.sum(a * a))
        assert np.abs(size * a - b).max() > 0.003 * np.abs(b).max()


def test_friction_and_creep_leave_a_loop_and_nothing_else_does() -> None:
    for effect in ("spine_slip", "viscoelastic"):
        for name in FORMS[effect]:
            assert np.abs(tips(effect, name)[3] - tips(effect, name)[1]).max() > 0.1e-3, name
    assert np.abs(tips()[3] - tips()[1]).max() < 1e-8


# ------------------------------------------------------------------ outside the catalogue
def test_outside_causes_are_many_of_every_stage_and_half_are_held_out() -> None:
    assert len(OUTSIDE) >= 8 and len(HELD_OUT) >= 8 and not set(OUTSIDE) & set(HELD_OUT)
    assert not (set(OUTSIDE) | set(HELD_OUT)) & set(EFFECTS)
    stages = {c.stage for c in (*OUTSIDE.values(), *HELD_OUT.values())}
    assert stages == {"actuation", "structure", "material", "load", "boundary", "measurement"}


@pytest.mark.parametrize("cause", [*OUTSIDE.values(), *HELD_OUT.values()], ids=lambda c: c.id)
def test_each_outside_cause_moves_the_tip_by_more_than_a_floor(cause: Cause) -> None:
    assert 0.9 < millimetres(moves(cause.id)) < 60


# ------------------------------------------------------------------ worlds
def test_worlds_name_a_form_of_every_effect_and_drawn_ones_repeat_themselves() -> None:
    for w in (BENCH, world("drawn:3"), world("new:3")):
        physics(w.forms)
        assert set(w.forms) == set(FORMS) and 1 <= w.tolerance <= 3 and 0 <= w.clutter <= 0.2 and 0 <= w.drift <= 0.025
    assert world("drawn:3") == world("drawn:3") != world("drawn:4")
    with pytest.raises(ValueError, match=r"world 'moon': must be bench, drawn:SEED or new:SEED"):
        world("moon")


def test_a_truth_with_an_outside_cause_goes_from_process_to_process() -> None:
    for cause in (*OUTSIDE.values(), *HELD_OUT.values()):
        assert pickle.loads(pickle.dumps(cause)) == cause


def a_robot(sizes: dict[str, float], outside: dict[str, float] | None = None, of: World = BENCH) -> WorldRobot:
    return WorldRobot(of, sizes, outside or {}, {e: OUTSIDE[e] for e in outside or {}}, PLACES, 1.6, 0.4, (0.0, 0.0, 0.0), 0.0)


def a_sweep(repeats: int = 2) -> WalkedSweep:
    trials = tuple(
        Jamming(spine, NOMINAL_VACUUM, repeat, 300.0 * (2 * (repeat - 1) + i))
        for repeat in range(1, repeats + 1)
        for i, spine in enumerate((0.0, 0.2))
    )
    return WalkedSweep(trials, UP_AND_DOWN, 0.053, 0.0, 600.0 * repeats)


def test_what_an_effect_moves_is_what_the_tip_loses_without_it() -> None:
    robot, sweep = a_robot({"base_tilt": 0.5, "chamber_ballooning": 0.5}), a_sweep()
    response = respond(robot, sweep, ("base_tilt", "chamber_ballooning"))
    without = respond(a_robot({"chamber_ballooning": 0.5}), sweep)
    assert np.allclose(response.by["base_tilt"][0], response.tip - without.tip, atol=1e-8)
    found = carried(robot, sweep, response)
    # one area factor takes up most of an area that grows with pressure, and next to nothing of a tilt
    assert found.calibrated["base_tilt"] > 0.7 * found.moves["base_tilt"]
    assert found.calibrated["chamber_ballooning"] < 0.4 * found.moves["chamber_ballooning"]


def test_readings_scatter_as_the_world_says_and_repeat_with_their_seed() -> None:
    still = World("still", BENCH.forms, spread=0.0, camera=0.1)
    robot, sweep = a_robot({}, of=still), a_sweep(40)
    response = respond(robot, sweep)
    found = read(robot, sweep, response, np.random.default_rng(1))
    assert np.array_equal(found.tip, read(robot, sweep, response, np.random.default_rng(1)).tip)
    assert 1e3 * found.tip[::2].std(axis=0).mean() == pytest.approx(0.1, rel=0.1)
    assert set(STEPS) >= set(response.by)
