"""Mistakes in robot.yaml or the table that make the rod far worse are named before the diagnosis; a right description stays."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.answer.sentences import stands_for
from diagnosis.data.campaign import Campaign
from diagnosis.data.case import campaign_of
from diagnosis.diagnose import Options, diagnose
from diagnosis.edits import listed, search
from diagnosis.edits.edit import Variants
from diagnosis.edits.listed import every_edit
from diagnosis.edits.misfit import _Problem, as_described, sample_of
from diagnosis.edits.of_table import of_table
from diagnosis.edits.reading import read as judge_table
from diagnosis.edits.search import edit_first
from diagnosis.fit_effects import fit_effects
from lab.files.inputs import case_of
from model.body import body_of
from model.condition import conditions
from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.effects.laws.actuation import orders
from model.effects.scales import scales
from model.errors import BadEffect
from model.prediction.predictor import Predictor
from model.robot import Robot, robot_from_dict
from model.rods import FINE, solve
from model.rotation import multiply
from model.section import rods_of
from recordings.trials import ORIENTATION, TIP, Table, TrialRow, marker_columns, pressure_columns
from tests.diagnosis.small_campaigns import FEW, Measured, measured, quick
from tests.diagnosis.test_case import ROBOT, states

ONE = {effect: spec for effect, spec in quick().catalogue.items() if effect in ("chamber_azimuth", "pressure_offset")}


def turned(robot: Robot, degrees: float) -> Robot:
    azimuths = tuple(a + degrees for a in robot.chambers.azimuths_deg)
    return robot.model_copy(update={"chambers": robot.chambers.model_copy(update={"azimuths_deg": azimuths})})


def moved(case: Measured, shift: tuple[float, float, float]) -> Measured:
    return replace(case, table=placed(case.table, lambda tip: tip + shift))


@pytest.fixture(scope="module")
def case() -> Measured:
    """Chambers 4 deg from where they should be."""
    return measured(2, 4, FEW, chamber_azimuth__angle=np.radians(4))


def test_a_robot_near_its_data_stays_as_it_is(case: Measured) -> None:
    own, _ = states(case)
    first = edit_first(ROBOT, own)
    assert first.robot is ROBOT and first.states is own and not first.changes
    for described in (ROBOT.with_modulus(0.8), ROBOT.with_modulus(1.4)):
        assert edit_first(described, own).robot is described


def test_chambers_counted_from_another_one_are_found_and_named(case: Measured) -> None:
    for degrees, said in ((-90, "all azimuths are 90 deg off (p"), (-180, "180 deg off, counted from the opposite direction (p")):
        first = edit_first(turned(ROBOT, degrees), states(case)[0])
        (change,) = first.changes
        assert change.values["found"] % 360 == pytest.approx(ROBOT.chambers.azimuths_deg[0] % 360, rel=0.1, abs=6)
        assert first.after_mm < 0.35 * first.before_mm and said in first.concerns[0].text
        assert f"write `azimuths_deg: {listed.listed(np.mod(ROBOT.chambers.azimuths_deg, 360))}` in robot.yaml" in change.text


def test_the_area_factor_beside_a_mistake_keeps_to_the_modulus_that_is_not_taken_over(case: Measured) -> None:
    """Alone it may bend a limp body over to another equilibrium."""
    first = edit_first(turned(ROBOT, -90).with_modulus(0.85), states(case)[0])
    area, modulus = np.exp(first.fit.theta[:2])  # type: ignore[union-attr]
    assert first.robot.youngs_modulus == ROBOT.with_modulus(0.85).youngs_modulus
    assert first.robot.area_factor_at(0.0) / ROBOT.area_factor_at(0.0) == pytest.approx(area / modulus)


def test_the_slope_of_the_misfit_is_its_slope(case: Measured) -> None:
    own, _ = states(case)
    sample = sample_of(ROBOT, own)
    assert sample is not None
    near = sample.fitted([((), np.zeros(8))], 1)[0]
    edits = tuple(e for e in listed.every_edit(sample, near) if e.kind in ("length", "tilt"))
    theta = np.array([0.1, -0.2, 0.1, 0.05, -0.04, 0.02, -0.01, 0.02, 0.2, -0.1, 0.05])
    problem = _Problem(sample, edits, theta, alone=False)
    problem.missed, beside = (sample.missed([(edits, x)])[0] for x in (theta[None], problem.beside))
    problem.missed, steps = problem.missed[0], 1e-4 * np.eye(11)
    above, below = (sample.missed([(edits, theta + sign * steps)])[0].reshape(11, -1) for sign in (1, -1))
    assert problem.slope(beside) == pytest.approx((above - below).T / 2e-4 / (0.01 * ROBOT.length), rel=0.02, abs=0.5)
    assert np.array_equal(problem.x, theta) and problem.missed.shape == (len(sample.table), 3)


def by_groups(case: Measured, told: Robot) -> Measured:
    """Three groups of chambers, one after the other, by the rod of ROBOT; robot.yaml says something else."""
    groups = ((0, 1, 8), (2, 3, 4), (5, 6, 7))
    rows = []
    for k, r in enumerate(case.table.rows):
        own = tuple(max(r.pressures) if i in groups[(k // 5) % 3] else 0.0 for i in range(9))
        at = conditions(ROBOT, r.spine_length, own)
        (x, y, z), *_ = solve(rods_of(ROBOT.replace(area_factor=1.5), at), FINE).tip.tolist()
        rows.append(replace(r, pressures=own, tip=(x, y, z)))
    return replace(case, robot=told, table=Table.of(rows))


def test_chambers_counted_the_other_way_round_are_found(case: Measured) -> None:
    mirrored = ROBOT.chambers.model_copy(update={"azimuths_deg": tuple(-a for a in ROBOT.chambers.azimuths_deg)})
    told = by_groups(case, ROBOT.model_copy(update={"chambers": mirrored}))
    first = edit_first(told.robot, states(told)[0])
    line = ", ".join(f"{azimuth:g}" for azimuth in ROBOT.chambers.azimuths_deg)
    assert len(first.changes) == 1 and "the other way round" in first.changes[0].text
    assert f"write `azimuths_deg: [{line}]` in robot.yaml" in first.changes[0].text
    assert first.robot.chambers.azimuths_deg == pytest.approx(ROBOT.chambers.azimuths_deg, abs=0.5)


def exchanged(case: Measured, place: int) -> Measured:
    """The same with hoses connected in another order than the robot.yaml of ROBOT says."""
    made = by_groups(case, ROBOT)
    order = np.argsort(orders(ROBOT.chambers.azimuths_deg)[place])
    rows = [replace(r, pressures=tuple(r.pressures[i] for i in order)) for r in made.table.rows]
    return replace(made, table=Table.of(rows))


@pytest.mark.parametrize("place", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))])
def test_chambers_in_another_order_are_an_effect_of_the_robot_where_it_is_weighed(case: Measured, place: int) -> None:
    told = exchanged(case, place)
    first = edit_first(told.robot, states(told)[0], ("chamber_order",))
    assert first.robot.effects["chamber_order"]["which"].value == place - 2 and not first.numbers
    assert "receive the pressures of" in first.headline and first.changes[0].values["p"] > 0.5
    assert first.robot.chambers == ROBOT.chambers
    as_azimuth = edit_first(told.robot, states(told)[0])
    assert not as_azimuth.with_order and as_azimuth.numbers
    assert first.headline == as_azimuth.headline  # nothing tells the order from azimuths that are off


def test_chambers_in_another_order_are_named_and_those_in_order_are_no_hypothesis(case: Measured) -> None:
    options = replace(quick(), catalogue={id: CATALOGUE[id] for id in ("chamber_order", "chamber_azimuth")})
    found = diagnose(exchanged(case, 1), options)
    assert found.attribute.verdict == "effect" and found.attribute.effects[0] == "chamber_order"
    assert all(r.effects[0] == "chamber_order" for r in found.attribute.ranking)
    assert "order" in found.detail["first_calibration"] and "receive the pressures of" in found.statement
    assert not any("chamber_order" in r.effects for r in diagnose(by_groups(case, ROBOT), options).attribute.ranking)


def test_an_order_that_was_found_is_written_into_the_robot(case: Measured) -> None:
    told = exchanged(case, 1)
    fitted = fit_effects(replace(told, robot=told.robot.replace(thrust="cap")), ["chamber_order"])
    assert fitted.effects == ("chamber_order",) and fitted.robot.effects["chamber_order"]["which"].value == -1.0
    assert fitted.left_mm < 1.0
    with pytest.raises(BadEffect, match="no other order"):
        fit_effects(by_groups(case, ROBOT), ["chamber_order"])


def test_an_origin_elsewhere_is_taken_off_all_positions(case: Measured) -> None:
    first = edit_first(ROBOT, states(moved(case, (0.03, 0.0, -0.02)))[0])
    assert first.states.tip == pytest.approx(states(case)[0].tip, abs=5e-3)
    (change,) = first.changes
    assert [change.values[a] for a in "xyz"] == pytest.approx([30, 0, -20], abs=5)
    assert first.headline.startswith("All places are displaced by [")
    assert first.moved(states(moved(case, (0.03, 0.0, -0.02)))[0]).tip == pytest.approx(first.states.tip)


@pytest.mark.parametrize("factor", [0.07, *(pytest.param(f, marks=pytest.mark.long) for f in (0.2, 6.0))])
def test_a_modulus_of_another_unit_is_found_even_where_no_rod_stands(case: Measured, factor: float) -> None:
    first = edit_first(ROBOT.with_modulus(factor), states(case)[0])
    (change,) = first.changes
    assert change.code == "refitted" and change.values["name"] == "youngs_modulus"
    assert change.values["found"] == pytest.approx(ROBOT.youngs_modulus / 1e3, rel=0.15)
    assert first.robot.youngs_modulus == pytest.approx(ROBOT.youngs_modulus, rel=0.15)
    assert first.after_mm < 0.35 * first.before_mm and "youngs_modulus" in first.concerns[0].text


def test_the_cause_is_found_and_fitted_around_the_calibrated_robot(case: Measured) -> None:
    options = Options(experiments=False, catalogue=ONE)
    there = replace(case, robot=ROBOT.with_modulus(2.4))
    found = diagnose(there, options)
    assert found.attribute.effects == ("chamber_azimuth",)
    assert found.statement.startswith("Calibrated first: youngs_modulus") and found.findings[0].code == "refitted_first"
    told: Any = found.detail["first_calibration"]
    assert len(told["adjusted"]) == 1
    assert found.calibration is not None and found.calibration.modulus == pytest.approx(1 / 2.4, rel=0.15)
    assert "these data determine only the ratio of its stiffness to the area factor" in found.statement
    gap = found.waterfall
    assert gap is not None and gap.given_mm > 4 * gap.steps[0].left_mm  # as robot.yaml stands, not as it was calibrated
    fitted = fit_effects(there, ("chamber_azimuth",))
    assert fitted.robot.youngs_modulus == pytest.approx(ROBOT.youngs_modulus, rel=0.15)
    assert fitted.findings[0].code == "refitted_first"


def test_a_payload_on_an_arm_across_gravity_is_no_modulus(monkeypatch: pytest.MonkeyPatch) -> None:
    """It sags as a softer arm does; the diagnosis can name the payload, so nothing is taken over."""
    tendons = {"path_radius": 0.012, "azimuths_deg": [90.0, 210.0, 330.0]}
    values = {
        "length": 0.32, "outer_radius": 0.0011, "inner_radius": 0.0, "density": 2e3, "youngs_modulus": 43.5e9, "tip_mass": 0.0,
        "mass_per_length": 0.12, "shear_modulus": 16e9, "gravity": [0.0, -9.81, 0.0], "tendons": tendons, "area_factor": 1.0,
    }  # fmt: skip
    arm = robot_from_dict({"name": "arm", **values})
    plan = [tuple(p * (c == k) for c in range(3)) for k in range(3) for p in (0.0, 40e3, 80e3, 120e3)]
    rows = [
        TrialRow(1 + i // 4, 1 + i % 4, "bending", 1, "load", float(i), 0.0, p, tip=(0.0, 0.0, 0.32)) for i, p in enumerate(plan)
    ]
    at = conditions(arm, 0.0, plan)
    tip = solve(rods_of(arm, replace(at, tip_mass=at.tip_mass + 0.03)), FINE).trusted().tip
    seen = tuple(replace(r, tip=tuple(t)) for r, t in zip(rows, tip.tolist(), strict=True))
    own = states(Measured(arm, Table.of(seen)))[0]
    assert edit_first(arm, own).robot is arm
    monkeypatch.setattr(listed, "_left_to_the_diagnosis", lambda *_: iter(()))
    monkeypatch.setattr(search, "judged", search.judged.__wrapped__)
    assert edit_first(arm, own).changes


# ------------------------------------------------------------------ mistakes, each on a finger, in `long` on a tendon arm
FINGER = robot_from_dict({
    "name": "finger", "length": 0.18, "outer_radius": 0.015, "inner_radius": 0.0, "density": 1070.0, "youngs_modulus": 600e3,
    "shear_modulus": 200e3, "tip_mass": 0.008, "gravity": [-9.81, 0.0, 0.0], "area_factor": 1.0,
    "chambers": {"radius": 0.004, "path_radius": 0.009, "azimuths_deg": [0.0, 120.0, 240.0]},
})  # fmt: skip
"""Held horizontally."""
TENDON_ARM = robot_from_dict({
    "name": "cable arm", "length": 0.24, "outer_radius": 0.006, "inner_radius": 0.0, "density": 1100.0, "youngs_modulus": 9e6,
    "shear_modulus": 3e6, "tip_mass": 0.05, "gravity": [0.0, 0.0, 9.81], "area_factor": 1.0,
    "tendons": {"path_radius": 0.011, "azimuths_deg": [0.0, 90.0, 180.0, 270.0]},
})  # fmt: skip
PAPER = ROBOT.replace(area_factor=1.6)
GROUPS = {
    9: ((8, 0, 1), (2, 3, 4), (5, 6, 7), (3,), (0,), (8,), (1,)),
    3: ((0,), (1,), (2,), (0, 1)),
    4: ((0,), (1,), (2,), (3,), (0, 1)),
    5: ((0,), (1, 4), (2,), (3,)),
}
"""Chambers that are inflated together, by the number of chambers."""
TILT = Rotation.from_euler("y", 20, degrees=True)


def read(robot: Robot, acting: Any = None, turn: Rotation | None = None, repeats: int = 2) -> Table:
    """What the rod does, some times over, with 0.3 mm of noise; `acting` changes what the pressures (n, k) Pa do to the body."""
    count, rng = len(robot.actuators.azimuths_deg), np.random.default_rng(1)
    spines, top = ((0.0, 0.2), 200e3) if robot.spine else ((0.0,), 90e3)
    sweeps = [(repeat, spine, group) for repeat in range(1, 1 + repeats) for spine in spines for group in GROUPS[count]]
    plan = [
        (trial, step, repeat, branch, spine, tuple(top * level * (k in group) for k in range(count)))
        for trial, (repeat, spine, group) in enumerate(sweeps, 1)
        for step, (level, branch) in enumerate([(0, "load"), (0.5, "load"), (1, "load"), (0.5, "unload"), (0, "unload")], 1)
    ]
    pressures = np.array([p for *_, p in plan])
    at = conditions(robot, [p[4] for p in plan], pressures if acting is None else acting(pressures))
    rod = solve(rods_of(robot, at), FINE, arc_lengths=robot.markers).trusted()
    turn = Rotation.identity() if turn is None else turn
    tip = turn.apply(rod.tip) + rng.normal(0, 0.3e-3, rod.tip.shape)
    table = Table.of(
        TrialRow(trial, step, "bending", repeat, branch, 60.0 * trial + 9 * step, spine, p, hold=3.0, rate=25e3, tip=tuple(x))
        for (trial, step, repeat, branch, spine, p), x in zip(plan, tip.tolist(), strict=True)
    )
    turns = (turn * Rotation.from_quat(rod.orientation, scalar_first=True)).as_quat(scalar_first=True)
    markers = turn.apply(rod.shape.reshape(-1, 3)).reshape(len(tip), -1) + rng.normal(
        0, 0.3e-3, (len(tip), 3 * len(robot.markers))
    )
    return table.replaced({**columns(ORIENTATION, turns), **columns(sum(marker_columns(len(robot.markers)), ()), markers)})


def columns(names: tuple[str, ...], values: Any) -> dict[str, Any]:
    return dict(zip(names, values.T, strict=True))


def campaign(table: Table) -> Campaign:
    """All states, with what `states` refuses."""
    return campaign_of(table, np.arange(len(table)), np.arange(0))


def acted(factors: dict[int, float], order: tuple[int, ...] = ()) -> Any:
    """Pressures of some chambers times a factor, and two exchanged."""

    def change(pressures: Any) -> Any:
        out = pressures.copy()
        for k, factor in factors.items():
            out[:, k] *= factor
        out[:, list(order)] = out[:, list(order)[::-1]]
        return out

    return change


def with_pressures(table: Table, pressures: Any) -> Table:
    return table.replaced(columns(pressure_columns(pressures.shape[1]), pressures))


def placed(table: Table, change: Any) -> Table:
    return table.replaced(columns(TIP, change(table.tip)))


def attitudes(table: Table, change: Any) -> Table:
    return table.replaced(columns(ORIENTATION, change(table.orientation)))


QUARTER = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0])


def marked(robot: Robot, *shares: float) -> Robot:
    """With markers at these shares of the length."""
    return robot.model_copy(update={"markers": tuple(share * robot.length for share in shares)})


def longer(robot: Robot) -> Robot:
    return robot_from_dict({**robot.model_dump(), "length": 1.055 * robot.length})


SLIP = (3e-3, 2e-3, -1.7e-3)
MISTAKES: dict[str, tuple[Any, tuple[str, ...]]] = {
    "gravity reversed": (lambda r: (r.model_copy(update={"gravity": tuple(-g for g in r.gravity)}), read(r)), ("gravity [",)),
    "absolute pressures": (lambda r: (r, with_pressures(read(r), read(r).pressures + 101_325.0)), ("are absolute",)),
    "frame turned": (lambda r: (r, read(r, turn=Rotation.from_euler("x", 90, degrees=True))), ("turned by 90 deg about",)),
    "frame turned about the axis": (lambda r: (r, read(r, turn=Rotation.from_euler("z", 90, degrees=True))),
                                    ("frame is turned by 90 deg about [0, 0, 1]",)),
    "frame turned a little": (lambda _: (FINGER, read(FINGER, turn=Rotation.from_euler("z", 9, degrees=True))),
                              ("frame is turned by 9 deg about [0, 0, 1]", "hold what is now [0.988, 0.15")),
    "base tilted": (lambda r: (r, read(r.replace(gravity=TILT.inv().apply(r.gravity)), turn=TILT)),
                    ("tilted by", "20 deg about y")),
    "two exchanged": (lambda r: (r, read(r, acted({}, (0, len(r.actuators.azimuths_deg) // 3)))), ("1 and ", "are swapped")),
    "one dead": (lambda r: (r, read(r, acted({1: 0.0}))), (" 2 gets no ",)),
    "one column of pressures in psi": (lambda r: (r, read(r).replaced({"p1": read(r)["p1"] / 6894.757})), ("column p1", "psi")),
    "cameras moved": (lambda r: (r, placed(t := read(r, repeats=3), lambda tip: tip + np.outer(t.trial >= 8, SLIP))),
                      ("frame moved by 4.0 mm at trial 8",)),
    "length under pressure": (lambda r: (longer(r), read(r)), ("length ", "measure it without")),
    "marker elsewhere": (lambda r: (marked(r, 0.4, 0.62), read(marked(r, 0.4, 0.7))), ("marker 2 is at arc", "`markers: [")),
    "positions in cm": (lambda r: (r, placed(read(r), lambda tip: 100 * tip)), ("all positions hold cm read as m (p", "x 0.01)")),
    "cm read as mm": (lambda r: (r, placed(read(r), lambda tip: 0.1 * tip)), ("all positions hold cm read as mm (p", "x 10)")),
    "pressures in psi": (lambda r: (r, with_pressures(read(r), read(r).pressures / 6894.757)), ("6895 times as large", "psi")),
    "quaternions begin with x": (lambda r: (r, attitudes(read(r), lambda q: q[:, [1, 2, 3, 0]])), ("they hold x, y, z, w",)),
    "attitudes in another frame": (lambda r: (r, attitudes(read(r), lambda q: multiply(q, QUARTER))),
                                   ("from the right by [0.707, ",)),
    "dead and another length": (lambda r: (longer(r), read(r, acted({1: 0.0}))), (" 2 gets no ", "length ")),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("robot", [FINGER, pytest.param(TENDON_ARM, marks=pytest.mark.long)], ids=["finger", "tendons"])
def test_a_mistake_is_named_with_its_number_its_probability_and_the_line_to_change(robot: Robot, mistake: str) -> None:
    wrong, words = MISTAKES[mistake]
    described, table = wrong(robot if robot.tendons is None or "pressures" not in mistake else FINGER)
    first = edit_first(described, campaign(table))
    text = "; ".join(map(str, first.changes))
    assert all(word in text for word in words) and "(p = " in text, text
    assert first.robot.markers == pytest.approx([s * described.length for s in (0.4, 0.7)][: len(described.markers)], abs=2e-3)
    assert len(first.changes) == 1 + (" and " in mistake)
    assert first.after_mm < 0.4 * first.before_mm or "attitudes" in mistake or "quaternions" in mistake


def test_an_edit_acts_on_all_states_not_only_on_those_that_were_compared() -> None:
    robot = FINGER.model_copy(update={"markers": (0.09,)})
    once = read(robot)
    twice = once.take(np.tile(np.arange(len(once)), 2))
    sample = search.sample_of(robot, campaign(twice))
    assert sample is not None and len(sample.table) < len(twice)
    near = as_described(sample)[0]
    for edit in (*every_edit(sample, near), *of_table(sample, near)):
        if not edit.left:
            made = edit.apply(Variants.of(robot, twice), np.zeros((1, len(edit.bounds))))
            assert made.tip.shape == (1, len(twice), 3) and made.markers.shape == (1, len(twice), 1, 3)


HANGING = robot_from_dict({
    "name": "soft and heavy", "length": 0.5, "outer_radius": 0.047, "inner_radius": 0.0, "density": 1080.0, "tip_mass": 0.93,
    "youngs_modulus": 315e3, "shear_modulus": 105e3, "gravity": [0.0, 0.0, 9.81], "area_factor": 1.7,
    "chambers": {"radius": 0.01, "path_radius": 0.029, "azimuths_deg": [0.0, 90.0, 180.0, 270.0]},
})  # fmt: skip


@pytest.mark.parametrize(
    ("true", "told", "found"),
    [((0.0, 0.0, 9.81), (0.0, 0.0, -9.81), "[0, 0, 9.81]"), ((-8.89, 0.0, 4.15), (8.89, 0.0, 4.15), "[-8.89, 0, 4.15]")],
)
def test_gravity_reversed_is_named_of_a_robot_that_its_weight_pulls_straight_from_a_strong_bend(
    true: tuple[float, ...], told: tuple[float, ...], found: str
) -> None:
    robot = HANGING.model_copy(update={"gravity": true})
    described, states = robot.model_copy(update={"gravity": told}), campaign(read(robot))
    judged, (change,) = search.judged(sample_of(described, states)), edit_first(described, states).changes
    assert judged.chosen is not None
    assert (change.code, change.values["found"]) == ("gravity_elsewhere", found)
    assert f"gravity {found}" in change.text and judged.probability("gravity") > 0.99
    assert np.abs(judged.chosen.missed).max() < 0.05 * HANGING.length


@pytest.mark.parametrize(("robot", "told"), [(FINGER, (0, 0, 9.81)), (HANGING, (0, 0, 9.81)), (HANGING, (-9.81, 0, 0))])
def test_gravity_along_no_axis_is_offered_along_no_axis(robot: Robot, told: tuple[float, ...]) -> None:
    true = np.array([-7.51, 0.0, 6.31])
    (change, *_) = edit_first(robot.replace(gravity=told), campaign(read(robot.replace(gravity=true)))).changes
    found = np.array(json.loads(change.values["found"]))
    assert change.code == "gravity_elsewhere" and found @ true > np.cos(np.radians(6)) * 9.81**2, change.text


def test_an_edit_that_stiffens_all_motion_away_is_no_mistake() -> None:
    told, table = HANGING.model_copy(update={"gravity": (0.0, 0.0, -9.81)}), read(HANGING)
    aside = 0.2 * np.random.default_rng(3).uniform(-1, 1, (len(table) // 2, 3))
    odd = placed(table, lambda tip: tip.mean(axis=0) + np.tile(aside, (2, 1)))
    judged = search.judged(sample_of(told, campaign(attitudes(odd, lambda q: np.nan * q))))
    assert len(judged.fits) > 1 and judged.chosen is None


def test_an_effect_of_the_catalogue_is_no_mistake() -> None:
    """Chambers 18 deg from where they should be: without their signature the azimuth would be a mistake."""
    effect, table = "chamber_azimuth", read(FINGER)
    forward = ForwardModel(FINGER, design_from_columns(FINGER, table.values, TIP), "one", {effect: CATALOGUE[effect]})
    theta = np.zeros(len(forward.parameters))
    theta[forward.index(effect)] = 0.31
    tips = forward.predict(theta).reshape(-1, 3) + np.random.default_rng(2).normal(0, 0.2e-3, (len(table), 3))
    judged = search.judged(sample_of(FINGER, campaign(placed(table, lambda _: tips))))
    assert judged.chosen is None


def test_rods_that_do_not_stand_are_not_taken_for_readings_that_repeat() -> None:
    sample = sample_of(FINGER, campaign(read(FINGER)))
    assert sample is not None
    assert min(sample.between_and_within(np.full((2 * len(sample.table), 3), FINGER.length))) > 0.1 * FINGER.length


def test_a_marker_off_the_body_s_axis_is_named_and_left_out() -> None:
    for robot in (marked(FINGER, 0.4, 0.7), marked(TENDON_ARM, 0.4, 0.7)):
        right = read(robot)
        pin = Rotation.from_quat(right.orientation, scalar_first=True).apply([0.0, 1.5 * robot.outer_radius + 0.01, 0.0])
        off = right.replaced(columns(marker_columns(2)[1], right.markers[:, 1] + pin))
        for turn in (Rotation.identity(), Rotation.from_euler("y", 1, degrees=True)):
            used = case_of(robot, [("cameras", in_frame(off, turn.as_matrix()))], "robot").table
            assert re.findall(r"marker \d is at rest", str(used.warnings)) == ["marker 2 is at rest"]
            assert np.isnan(used.markers[:, 1]).all() and np.isfinite(used.markers[:, 0]).all()
        (far,) = judge_table(robot, right.replaced(columns(marker_columns(2)[1], 100 * right.markers[:, 1]))).asked
        assert "marker 2 is" in far and "the unit of the marker's columns is probably wrong" in far and "axis" not in far
        wrong = np.eye(3), 1000 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.eye(3)[[2, 1, 0]]
        for axes in wrong:  # what concerns the whole file is not blamed on a marker
            found = judge_table(robot, in_frame(right, axes))
            assert "mm from where" not in str(found) and np.isfinite(found.table.markers).all(), found
            assert axes is wrong[0] or found.refused, axes


@pytest.mark.parametrize("roll", [0.0, 90.0])
def test_a_marker_on_the_skin_is_named_with_its_entry_and_kept_once_that_is_written(roll: float) -> None:
    glued = (0.3, -1.2)  # outer radii
    for robot in (marked(FINGER, 0.4, 0.7), marked(TENDON_ARM, 0.4, 0.7)):
        offset, along = [share * robot.outer_radius for share in glued], robot.markers[1]
        stated = robot.replace(markers=[robot.markers[0], {"arc_length": along, "offset": offset}])
        right = read(robot)
        seen = Predictor(stated)(right.pressures, right.spine_length, roll=np.radians(roll))
        places = np.concatenate([seen.tip[:, None], seen.shape], axis=1).reshape(len(right), -1)
        table = right.replaced(columns([*TIP, *sum(marker_columns(2), ())], places) | columns(ORIENTATION, seen.orientation))
        table = table.replaced({"roll_deg": np.full(len(right), roll)})
        assert judge_table(stated, table).asked == () and np.isfinite(judge_table(stated, table).table.markers).all()
        (said,) = judge_table(robot, table).asked
        entry = re.findall(r"`{arc_length: (\S+) mm, offset: \[(\S+) mm, (\S+) mm\]}`", said)
        np.testing.assert_allclose(np.array(entry, float)[0], 1e3 * np.array([along, *offset]), atol=1.0)
        unturned = table.replaced(columns(ORIENTATION, np.full((len(table), 4), np.nan)))
        found = judge_table(stated, in_frame(unturned, np.diag([-1.0, -1.0, 1.0])))  # beside the axis, the marker tells which
        assert re.match("the cameras' frame is turned by 180 deg about .*1] .p = 1.00", found.asked[0]) and len(found.asked) == 1
        assert np.isfinite(found.table.markers).all()


def in_frame(table: Table, axes: Any) -> Table:
    """Places along other axes of the file, or in another unit."""
    markers = (table.markers @ axes.T).reshape(len(table), -1)
    return placed(table, lambda tip: tip @ axes.T).replaced(columns(sum(marker_columns(2), ()), markers))


def test_markers_along_the_body_tell_a_length_from_an_origin() -> None:
    p, two = {}, marked(FINGER, 1 / 3, 2 / 3)
    for robot, described in ((FINGER, longer(FINGER)), (two, longer(two))):
        p[len(robot.markers)] = search.judged(sample_of(described, campaign(read(robot)))).probability("length")
    assert p[2] > 0.99 and p[2] >= p[0]
    assert len(search.judged(sample_of(two, campaign(read(two)))).fits) == 1  # near its data: no edit is tried


@pytest.mark.parametrize("robot", [FINGER, PAPER, pytest.param(TENDON_ARM, marks=pytest.mark.long)])
def test_a_right_description_and_small_errors_that_effects_can_be_stay(robot: Robot) -> None:
    heavier = robot.model_copy(update={"tip_mass": robot.tip_mass + 0.04})
    for table in (read(robot), read(heavier), read(robot, lambda p: p / 1.1), read(robot, acted({0: 0.85}))):
        assert not edit_first(robot, campaign(table)).changes


def test_one_area_factor_for_all_lengths_is_weighed_with_chambers_turned_before_a_softer_body() -> None:
    assert not edit_first(ROBOT.replace(area_factor={0.0: 1.5, 0.2: 2.2}), campaign(read(turned(PAPER, 11)))).changes


def test_two_that_are_swapped_are_named_as_such_also_where_they_are_an_effect_or_counted_the_other_way() -> None:
    swap = campaign(read(FINGER, acted({}, (1, 2))))
    for effects in ((), ("chamber_order",)):
        assert edit_first(FINGER, swap, effects).headline.startswith("Chambers 2 and 3 are swapped (p = ")


def test_chambers_that_differ_change_places_by_pressures_or_by_azimuths_and_one_remedy_is_no_other() -> None:
    drive = {"radius": 0.004, "path_radius": [0.0105, 0.009, 0.0105, 0.0075], "azimuths_deg": [0.0, 90.0, 180.0, 270.0]}
    four = FINGER.replace(chambers=drive, gravity=[0.0, 0.0, 9.81])
    off = r"(?!.* receive ).*all azimuths are 90 deg off .*write `azimuths_deg: \[0, 90, 180, "
    swap = r"chambers 1 and 2 are swapped .* in the table or in its map(;|$)"
    for described, table, said in ((turned(four, -90), read(four), off), (four, read(four, acted({}, (0, 1))), swap)):
        first = edit_first(described, campaign(table), ("chamber_order",))
        assert re.match(said, str(first.changes[0])) and not first.with_order and first.after_mm < 1, first.changes


def test_another_order_that_these_states_cannot_tell_from_the_one_that_is_made_is_stated_beside_it() -> None:
    five = FINGER.model_copy(update={"chambers": FINGER.chambers.model_copy(update={"azimuths_deg": (0, 72, 144, 216, 288)})})
    (change,) = edit_first(five, campaign(read(five, acted({}, (2, 3))))).changes
    assert {"chambers counted the other way round", "chambers 3 and 4 are swapped"} <= {
        *re.findall(r"chambers [a-z0-9 ]*(?:swapped|round)", change.text)
    }
    assert "; or instead, included in this p, " in change.text


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_a_bending_stiffness_with_a_digit_too_many_is_named(factor: float) -> None:
    stiffness = FINGER.youngs_modulus * body_of(FINGER).mean_second
    first = edit_first(FINGER.replace(bending_stiffness=factor * stiffness), campaign(read(FINGER)))
    assert re.fullmatch(r"bending_stiffness \S+ N m\^2 instead of \S+ N m\^2 \(p = (0.9\d|1.00)\).*", str(first.changes[0]))
    assert first.robot.bending_stiffness == pytest.approx(stiffness, rel=0.2)


def test_a_weight_in_the_place_of_numbers_beyond_their_tolerance_is_stated_with_them_and_each_number_once() -> None:
    known = {"youngs_modulus": 0.01, "area_factor": 0.5, "frame_shift": 5e-3, "length": 5e-3, "tilt": 0.05, "frame_turn": 0.05}
    hanging = FINGER.replace(gravity=[0.0, 0.0, 9.81], uncertainty=known, thrust="cap")
    some = {id: CATALOGUE[id] for id in ("tip_payload", "chamber_azimuth")}
    heavier = read(hanging.replace(tip_mass=hanging.tip_mass + 0.01))
    found = diagnose(Measured(hanging, heavier), Options(experiments=False, catalogue=some))
    (first,) = (str(f) for f in found.findings if f.code == "beyond_tolerance")
    weight = re.search(r"or load at the tip .tip_payload. .(\S+) g, with which all of these would stay within", first)
    assert weight is not None and 8 < float(weight[1]) < 12
    (softer,) = re.findall(r"youngs_modulus (\S+) % below robot.yaml", first)
    assert f"a body {softer} % softer" in found.headline and f"with {1 - float(softer) / 100:.2f} times" in found.statement
    assert stands_for(found.calibration, found.words) == ""
    most = FINGER.replace(tip_mass=0.09, thrust="cap")  # all that is stated to hang there may be too much
    assert some["tip_payload"].parameters[0].of(scales(most)).low == -most.tip_mass
    lighter = diagnose(Measured(most, read(FINGER)), Options(experiments=False, catalogue=some))
    assert re.match(r"The tip carries 8\d g less than stated", lighter.headline), lighter.headline
