"""The fast rod solver against reference values, against the slow converged solver, and against itself; other methods agree with
it where they must, and refuse what they do not know."""

import numba
import numpy as np
import pytest

from benchmarks.rod_cases import LENGTH, wild_rods
from model.arrays import Array
from model.errors import BadCondition, SolveFailed
from model.rods import FAST, FINE, PAPER, Fast, Form, Method, Paper, Rods, Status, rods, solve, stations
from model.rods.beam import bending_compliance, shear_compliance
from model.rods.fast.compiler import fused
from model.rods.fast.direct import COARSE_DIVISIONS
from model.rods.fast.group import ROD, SECTION, RodGroup, cut, gather
from model.rods.fast.lanes import LANES
from model.rods.fast.newton import first_guess
from model.rotation import to_base
from tests.model.rods.cases import robots
from tests.model.rods.reference import REFERENCE
from tests.simulated.bench import raises

SECOND_MODE = 2.4674
"""pi^2 / 4: P L^2 / EI at which a cantilever buckles under a dead load."""


def test_random_robots_agree_with_the_slow_converged_solver() -> None:
    found = wild_rods(96, seed=7)
    fast, slow = solve(found), solve(found, REFERENCE)
    both = fast.converged & slow.converged
    assert both.sum() > 90
    assert np.linalg.norm(fast.tip - slow.tip, axis=1)[both].max() < 1e-5
    assert not (fast.converged & (slow.status == Status.OTHER_BRANCH)).any()
    assert np.abs(np.abs(np.sum(fast.orientation * slow.orientation, axis=1))[both] - 1).max() < 1e-8
    assert np.abs(fast.base_moment - slow.base_moment)[both].max() < 5e-4


def test_default_stays_within_a_hundredth_of_a_millimetre_of_fine_over_many_random_robots() -> None:
    found = wild_rods(4000, seed=11)
    coarse, fine = solve(found), solve(found, FINE)
    both = coarse.converged & fine.converged
    assert np.linalg.norm(coarse.tip - fine.tip, axis=1)[both].max() < 1e-5
    assert (coarse.converged == fine.converged).mean() > 0.999


def test_a_single_rod_and_a_batch_give_the_same() -> None:
    found = robots(20, np.linspace(50e3, 250e3, 20), np.linspace(0.0, 0.3, 20))
    batch = solve(found, FINE).tip
    assert np.abs(batch - np.concatenate([solve(found[i : i + 1], FINE).tip for i in range(len(found))])).max() < 1e-10


def test_a_linear_rod_has_the_same_bits_among_hyperelastic_ones() -> None:
    rods = robots(8, np.linspace(50e3, 250e3, 8), 0.1)
    mixed = Rods(rods.form, rods.values.copy())
    mixed.field("series")[1] = (0.02, -2.0, -1.0)
    alone, among = solve(rods, FINE).values, solve(mixed, FINE).values
    assert np.array_equal(np.delete(alone, 1, axis=0), np.delete(among, 1, axis=0)) and not np.array_equal(alone[1], among[1])


def test_two_threads_give_what_one_gives() -> None:
    found = wild_rods(200, seed=3)
    assert np.array_equal(solve(found).tip, solve(found, Fast(cores=2)).tip, equal_nan=True)


def test_a_warm_start_lands_on_the_same_tip() -> None:
    found = robots(40, np.linspace(50e3, 250e3, 40), 0.1)
    cold = solve(found, Fast(remember=True))
    found.field("tip_force")[:] *= 1.02
    found.field("tip_moment")[:] *= 1.02
    assert np.abs(solve(found, start=cold).tip - solve(found, FINE).tip).max() < 1e-5


def test_a_pushed_column_is_flagged_beyond_its_buckling_load_and_only_there() -> None:
    found = robots(3, 0.0, 0.0)
    stiffness = found.field("bend_stiffness")[0, 1, 0]
    critical = SECOND_MODE * stiffness / LENGTH**2
    found.field("load")[:] = 0.0
    found.field("tip_moment")[:] = (0.0, 1e-7, 0.0)
    found.field("dead_force")[:] = np.outer([-0.5, -0.85, -1.3], (0.0, 0.0, critical))
    solution = solve(found, arc_lengths=[0.2])
    assert solution.status[0] <= Status.SOLVED_IN_STEPS
    assert solution.status[1] == Status.SOLVED_IN_STEPS
    assert solution.status[2] in (Status.OTHER_BRANCH, Status.FAILED)
    assert all(np.isnan(values[2]).all() for values in (solution.tip, solution.orientation, solution.base_moment, solution.shape))
    # A stretchable column buckles a little off Euler's load.
    assert solution.load_reached[2] * 1.3 == pytest.approx(1.0, abs=0.08)
    raises(SolveFailed, r"1 of 3 rods .* 2 \(", solution.trusted)


def test_a_bent_rod_that_hangs_stands_where_growing_loads_lead_and_not_where_it_is_curled_up() -> None:
    """Weights that could buckle it hold a soft rod in either of two shapes; pulled straight, it is solved at once."""
    heavy = {"length": 0.504, "bend_stiffness": [1.247, 1.247, 2.494], "stretch_stiffness": [762.0, 762.0, 2286.0],
             "dead_force": [0.0, 0.0, 9.152], "load": [0.0, 0.0, 72.64]}  # fmt: skip
    level = np.linspace(0.0, 1.0, 120)[:, None]
    found = rods(Form(elements=1), 120, tip_moment=level * [0.0, 16.0, 0.0], tip_force=level * [0.0, 0.0, 300.0], **heavy)
    direct, followed = solve(found, FINE), solve(found, Fast(divisions=20.0, close=1e-11, least_margin=1e3))
    assert np.array_equal(direct.converged, followed.converged) and 90 < direct.converged.sum() < 120
    assert np.nanmax(np.linalg.norm(direct.tip - followed.tip, axis=1)) < 1e-8
    assert direct.status[0] == Status.SOLVED


def test_the_ends_of_a_rod_are_its_base_and_its_tip() -> None:
    found = robots(3, np.array([50e3, 150e3, 250e3]), 0.1)
    solution = solve(found, FINE)
    at = stations(found, solution, [0.0, LENGTH], FINE)
    assert np.abs(at.position[:, 0]).max() < 1e-9
    assert np.abs(at.position[:, 1] - solution.tip).max() < 1e-12
    assert np.abs(at.orientation[:, 0] - (1, 0, 0, 0)).max() < 1e-8
    assert np.abs(at.moment[:, 0] - solution.base_moment).max() < 1e-8
    assert np.abs(at.force[:, 0] - solution.base_force).max() < 1e-8


def test_places_along_a_rod_agree_with_the_slow_converged_solver() -> None:
    found = robots(3, np.array([50e3, 150e3, 250e3]), np.array([0.0, 0.1, 0.3]), roll=0.5)
    arcs = np.array([0.05, 0.1, 0.2, 0.33])
    slow = solve(found, REFERENCE, arc_lengths=arcs).shape
    assert np.abs(stations(found, solve(found, FINE), arcs, FINE).position - slow).max() < 1e-9
    assert np.abs(stations(found, solve(found), arcs).position - slow).max() < 1e-5


def test_springs_at_the_tip_pull_as_the_same_forces_would() -> None:
    held = robots(2, 200e3, 0.1, form=Form(elements=2, springs=2))
    held.field("spring_direction")[:] = [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]
    held.field("spring_stiffness")[:] = [[50.0, 20.0], [500.0, 300.0]]
    held.field("spring_origin")[:] = [-0.05, 0.1]
    held.field("spring_softness")[:] = [0.0, 1e-3]
    held.field("spring_arm")[:] = [[0.0, 0.0, 0.0], [0.01, 0.02, 0.06]]
    found = solve(held.check(), FINE).trusted()
    tip = found.tip
    free = robots(2, 200e3, 0.1)
    for j, softness in enumerate((0.0, 1e-3)):
        e = held.field("spring_direction")[:, j]
        arm = to_base(found.orientation, held.field("spring_arm")[:, j])
        stretch = np.sum(e * (tip - arm), axis=1) - held.field("spring_origin")[:, j]
        if softness:
            stretch = 0.5 * (stretch + np.sqrt(stretch**2 + softness**2))
        force = -(held.field("spring_stiffness")[:, j] * stretch)[:, None] * e
        free.field("dead_force")[:] += force
        free.field("dead_moment")[:] -= np.cross(arm, force)
    assert np.abs(solve(free, FINE).tip - tip).max() < 1e-9
    assert np.abs(solve(held).tip - tip).max() < 1e-5


def test_a_curvature_that_grows_along_an_element_equals_many_elements() -> None:
    graded = robots(1, 150e3, 0.1, form=Form(elements=2))
    rest = np.array([[0.3, 0.1, 0.2], [0.5, -0.2, 0.0]])
    rise = np.array([[0.4, 0.0, 0.1, -0.3, 0.2, 0.0, 0.1, 0.0, 0.3], [0.1, 0.5, 0.0, 0.2, 0.2, 0.2, -0.6, 0.1, 0.1]])
    graded.field("rest_curvature")[0], graded.field("curvature_rise")[0] = rest, rise
    parts = 32
    z = (np.arange(parts) + 0.5)[:, None] / parts
    pieces = [rest[e] + z * rise[e, :3] + z**2 * rise[e, 3:6] + z**3 * rise[e, 6:] for e in (0, 1)]
    plain = {name: np.repeat(graded.field(name), parts, axis=1) for name in ("bend_stiffness", "stretch_stiffness", "load")}
    many = rods(
        Form(elements=2 * parts),
        1,
        length=np.repeat(graded.field("length"), parts, axis=1) / parts,
        rest_curvature=np.concatenate(pieces),
        **plain,
        **{name: graded.field(name) for name in ("tip_force", "tip_moment", "dead_force")},
    )
    assert np.abs(solve(graded).tip - solve(many, FINE).tip).max() < 6e-5


def test_a_section_softens_by_the_sum_of_what_acts_on_it_and_what_actuators_within_make() -> None:
    """In a plane, a moment of actuators in every section bends the rod as the same moment at its tip does."""
    of_tip = robots(2, np.array([200e3, 300e3]), 0.0)
    of_tip.field("series")[:] = [[(0.03, -2.0, -1.0)], [(-0.03, 0.5, 1.0)]]
    of_tip.field("tip_force")[:], of_tip.field("dead_force")[:] = 0.0, (1.0, 0.0, -0.5)
    bent = of_tip.field("tip_moment")[:, None, :] / of_tip.field("bend_stiffness")
    assert not bent[..., (0, 2)].any() and (np.abs(bent[..., 1]) > 1.0).all()
    active = np.concatenate([bent, np.zeros((*bent.shape[:2], 9))], axis=-1)
    within, kept = (of_tip.changed(tip_moment=0.0, rest_curvature=bent, active=a) for a in (active, 0.0))
    tip = solve(of_tip, FINE).tip
    assert np.abs(solve(within, FINE).tip - tip).max() < 1e-7
    assert (np.linalg.norm(solve(kept, FINE).tip - tip, axis=1) > 1e-4).all()


def test_the_base_turns_with_its_tilt_and_gives_with_its_moment() -> None:
    found = robots(2, 150e3, 0.1)
    found.field("base_turn")[1] = (0.0, 0.03, 0.0)
    found.field("base_compliance")[1] = 0.02
    solution = solve(found, FINE)
    # Turning the base is turning all dead loads the other way.
    angle = 0.03 + 4 * np.arctan(0.02 * solution.base_moment[1, 1] / 4)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    seen = robots(1, 150e3, 0.1)
    seen.field("dead_force")[:] = seen.field("dead_force") @ turn
    seen.field("load")[:] = seen.field("load") @ turn
    assert np.abs(turn @ solve(seen, FINE).tip[0] - solution.tip[1]).max() < 1e-9


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("bend_stiffness", 0.0, "bend_stiffness.*must be positive"),
        ("stretch_stiffness", -1.0, "stretch_stiffness.*must be positive"),
        ("tip_force", np.nan, "tip_force.*must be finite"),
        ("length", [[0.5, -0.1]], "length.*must not be negative"),
        ("base_compliance", -1e-3, "base_compliance"),
        ("load", np.zeros((3, 3, 3)), "load: shape"),
        ("colour", 1.0, "colour: no such field"),
    ],
)
def test_bad_input_is_refused_by_the_name_of_its_field(field: str, value: object, said: str) -> None:
    given = {"length": [[0.1, 0.3]], "bend_stiffness": 2.0, "stretch_stiffness": 900.0} | {field: value}
    raises(BadCondition, said, rods, Form(elements=2), 2, **given)


def test_a_form_without_elements_is_refused() -> None:
    raises(BadCondition, "elements: 0", Form, elements=0)


# -- the same numbers wherever arrays lie


def test_a_fused_operation_rounds_once() -> None:
    @numba.njit
    def call(a: float, b: float, c: float) -> float:
        return fused(a, b, c)

    small = 2.0**-30
    # (1 + s)(1 - s) - 1 is -s^2, of which rounding the product first would leave nothing.
    assert call(1.0 + small, 1.0 - small, -1.0) == -(small**2)
    assert call(2.0, 3.0, 4.0) == 10.0


@numba.njit  # type: ignore[untyped-decorator]
def first_pass(rods: Array, springs: int, work: Array, elements: Array) -> None:
    """The first pass of one group whose arrays are these."""
    parts = np.empty(elements.size // (SECTION * LANES), np.int64)
    group = RodGroup(work, elements, parts, springs, True, LANES)
    gather(rods, group, 0)
    cut(group, COARSE_DIVISIONS)
    first_guess(group)


def test_arrays_side_by_side_give_the_same_bits_as_arrays_far_apart() -> None:
    # Compiled code takes another way where it cannot exclude that arrays overlap.
    robots = wild_rods(LANES, 3)
    size, found = robots.form.elements * SECTION * LANES, []
    for between in (0, 64, 10 * size):
        memory = np.zeros(2 * (size + ROD * LANES) + between)
        elements, work = memory[:size], memory[size + between : size + between + ROD * LANES]
        first_pass(robots.values, robots.form.springs, work, elements)
        found.append(work.copy())
        work, elements = memory[: ROD * LANES], memory[ROD * LANES + between : ROD * LANES + between + size]
        memory[:] = 0.0
        first_pass(robots.values, robots.form.springs, work, elements)
        found.append(work.copy())
    assert np.ptp(found[0]) > 0.0
    assert all(np.array_equal(one, found[0]) for one in found[1:])


# -- one call, several methods
EDGES, BEND, SHEAR = (0.0, 0.1, 0.25, 0.4), (3.0, 2.0, 1.5), (900.0, 700.0, 500.0)
EVERY = pytest.mark.parametrize("method", [FAST, REFERENCE, PAPER], ids=lambda m: type(m).__name__)


def three_parts(**loads: object) -> Rods:
    """A rod of three parts."""
    bend = [(k, k, 2 * k) for k in BEND]
    stretch = [(k, k, 3 * k) for k in SHEAR]
    return rods(Form(3), 1, length=np.diff(EDGES), bend_stiffness=bend, stretch_stiffness=stretch, **loads)  # type: ignore[arg-type]


@EVERY
def test_under_small_loads_every_method_finds_the_same_rod_of_three_elements(method: Method) -> None:
    small = three_parts(
        dead_force=[2e-3, 1e-3, 0.0], tip_moment=[1e-4, -2e-4, 1e-4], dead_moment=[-1e-4, 3e-4, 0.0], tip_force=[1e-3, 0.0, 5e-3],
        load=1e-3 * np.diag([1.0, 2.0, 3.0]), rest_curvature=1e-3 * np.diag([1.0, 1.0, 1.0]),
    )  # fmt: skip
    arcs = [0.0, 0.05, 0.1, 0.3, 0.4]
    exact, found = solve(small, FINE, arc_lengths=arcs), solve(small, method, arc_lengths=arcs)
    assert found.converged.all()
    # Euler's own error at 100 steps is a hundredth of the deflection.
    near = 2e-6 if isinstance(method, Paper) else 2e-7
    assert np.abs(found.tip - exact.tip).max() < near
    assert np.abs(found.shape - exact.shape).max() < near
    assert np.abs(found.orientation - exact.orientation).max() < 20 * near
    assert np.abs(found.base_force - exact.base_force).max() < 1e-5
    assert np.abs(found.base_moment - exact.base_moment).max() < 1e-5


def test_a_cantilever_pushed_at_its_end_gives_by_bending_and_shear() -> None:
    pushed = solve(three_parts(dead_force=[1e-3, 0.0, 0.0]), FINE)
    assert pushed.tip[0, 0] == pytest.approx(1e-3 * (bending_compliance(EDGES, BEND) + shear_compliance(EDGES, SHEAR)), rel=1e-6)
    assert bending_compliance((0.0, 0.4), (2.0,)) == pytest.approx(0.4**3 / (3 * 2.0), rel=1e-14)


def test_a_push_short_of_the_end_is_equation_eight() -> None:
    # Up to x a force there is the same as one at the tip with a couple that takes the longer lever back.
    x, push = 0.25, [1e-3, 0.0, 0.0]
    couple = [0.0, -1e-3 * (0.4 - x), 0.0]
    bar = rods(Form(1), 1, length=0.4, bend_stiffness=2.0, stretch_stiffness=1e9, dead_force=push, dead_moment=couple)
    inner = solve(bar, FINE, arc_lengths=[x])
    assert inner.shape[0, 0, 0] == pytest.approx(1e-3 * x**3 / 6, rel=1e-6)
    slope = 1e-3 * x**2 / 4  # beyond x the bar is straight
    assert inner.shape[0, 0, 0] + slope * (0.4 - x) == pytest.approx(1e-3 * (3 * 0.4 - x) * x**2 / (6 * 2.0), rel=1e-6)


@pytest.mark.parametrize("method", [REFERENCE, PAPER], ids=lambda m: type(m).__name__)
def test_a_term_or_a_start_that_a_method_does_not_know_is_refused_by_name(method: Method) -> None:
    tilted = robots(1, 100e3, 0.1)
    tilted.field("base_turn")[:] = (0.0, 0.01, 0.0)
    raises(BadCondition, f"base_turn: .* {type(method).__name__}", solve, tilted, method)
    plain = robots(1, 100e3, 0.1)
    raises(BadCondition, "start", solve, plain, method, start=solve(plain, Fast(remember=True)))


@EVERY
def test_of_no_rods_every_method_finds_nothing(method: Method) -> None:
    found = solve(robots(2, 100e3, 0.1)[np.zeros(2, bool)], method, arc_lengths=[0.1, 0.2])
    assert found.tip.shape == (0, 3) and found.shape.shape == (0, 2, 3) and found.trusted() is found


@EVERY
def test_arc_lengths_beyond_the_rod_are_refused(method: Method) -> None:
    raises(BadCondition, "arc_lengths: 0.5 m of rod 0", solve, robots(1, 100e3, 0.1), method, arc_lengths=[0.5])


def test_what_did_not_converge_holds_nan_and_says_why() -> None:
    found = solve(wild_rods(4, 1).changed(dead_force=[0.0, 0.0, -400.0], load=0.0, tip_moment=0.0), FAST)
    assert not found.converged.any() and np.isnan(found.tip).all()
    assert set(found.status) <= {Status.OTHER_BRANCH, Status.FAILED}
    raises(SolveFailed, "of the load", found.trusted)
