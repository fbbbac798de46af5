"""Stiffness trials in the diagnosis: simulated by the virtual robot, whose stand and spine have laws of their own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from diagnosis.answer.result import FACTORS, Diagnosis
from diagnosis.data.case import lacking, states
from diagnosis.diagnose import Options, diagnose
from diagnosis.errors import BadCase
from diagnosis.inference.prepare import prepare
from model.effects import CATALOGUE
from model.robot import Uncertainty
from recordings.trials import Table, TrialRow
from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualRobot, walk
from tests.diagnosis.test_case import ROBOT, Measured, case, sweep

LENGTHS = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
RIVALS = {e: CATALOGUE[e] for e in ("force_bias", "arm_compliance", "contact_offset", "spine_shear", "spine_slip", "area_moment")}
FORCE, ZERO = 0.01, 0.02
"""N, white noise of a reading and scatter of the sensor's zero."""


@cache
def pushes(effect: str = "", size: float = 0.0, seed: int = 1, repeats: int = 3, body: bool = False) -> tuple[TrialRow, ...]:
    """Three repeats of six deflections, up to 2 % of the length, at six spine lengths (and of the body at three)."""
    rng = np.random.default_rng(seed)
    truth = RobotTruth(scatter_length=1e-3, scatter_stiffness=0.02)
    robot = VirtualRobot(truth, {effect: size} if effect else {}, seed=seed)
    plan = [("spine", r, x) for r in range(1, repeats + 1) for x in LENGTHS]
    plan += [("body", r, x) for r in range(1, repeats + 1) for x in (0.0, 0.15, 0.30) if body]
    steps = [
        (trial, k, specimen, repeat, x, 0.02 * (x if specimen == "spine" else 0.4) * k / 6)
        for trial, (specimen, repeat, x) in enumerate(plan, 1)
        for k in range(1, 7)
    ]
    readings = walk(
        robot, [Condition(x, mount=specimen, deflection=y, hold=1.5, rejam=k == 1) for _, k, specimen, _, x, y in steps]
    )
    zero = ZERO * rng.normal(size=len(plan))
    noise = FORCE * rng.normal(size=len(steps))
    return tuple(
        TrialRow(
            trial, k, "stiffness", repeat, "load", reading.t, x, (0.0,) * 9, rate=0.0, hold=1.0, vacuum=reading.vacuum,
            specimen=specimen, force=reading.force + zero[trial - 1] + error, deflection=y,
        )
        for (trial, k, specimen, repeat, x, y), reading, error in zip(steps, readings, noise.tolist(), strict=True)
    )  # fmt: skip


@cache
def answer(effect: str = "", size: float = 0.0, seed: int = 1, body: bool = False) -> Diagnosis:
    wanted = Options(bool(effect), experiments=False, catalogue=RIVALS if effect or body else CATALOGUE)
    return diagnose(case(list(pushes(effect, size, seed, body=body))), wanted)


@pytest.mark.parametrize(("seed", "body"), [(1, False), pytest.param(2, False, marks=pytest.mark.long), (2, True)])
def test_nothing_is_named_where_nothing_is_wrong(seed: int, body: bool) -> None:
    d = answer(seed=seed, body=body)  # of a body, too, that hangs and shears
    assert d.attribute.verdict == "none"
    assert not d.locate.significant


@pytest.mark.parametrize(
    ("effect", "size", "parameter"),
    [
        ("force_bias", 0.15, "force_bias.bias"),
        pytest.param("arm_compliance", 1e-4, "arm_compliance.give", marks=pytest.mark.long),
        pytest.param("contact_offset", 1e-3, "contact_offset.offset", marks=pytest.mark.long),
        pytest.param("spine_shear", 1.0, "spine_shear.blend", marks=pytest.mark.long),
    ],
)
def test_an_effect_is_named_with_its_size(effect: str, size: float, parameter: str) -> None:
    d = answer(effect, size, seed=2)
    assert d.attribute.verdict == "effect" and d.attribute.effects == (effect,)
    found = d.attribute.ranking[0].parameters[parameter]
    assert found.value == pytest.approx(size, abs=max(3 * found.sd, 0.05 * size))
    assert d.shrink is not None and d.shrink.how == "leave one spine length out"
    assert d.shrink.after_mm < 0.75 * d.shrink.before_mm


@pytest.mark.parametrize(("stated", "effects"), [(None, ("spine_length_offset",)), (5e-3, ())])
def test_a_probe_5_mm_off_is_no_cause_where_the_stand_states_its_error(stated: float | None, effects: tuple[str, ...]) -> None:
    rows = [replace(r, force=(r.force or 0.0) * (r.spine_length / (r.spine_length + 5e-3)) ** 3) for r in pushes()]
    robot = ROBOT.model_copy(update={"uncertainty": Uncertainty(push_place=stated)})
    rivals = RIVALS | {"spine_length_offset": CATALOGUE["spine_length_offset"]}
    d = diagnose(Measured(robot, Table.of(rows)), Options(quantify=False, experiments=False, catalogue=rivals))
    assert d.attribute.effects == effects and d.locate.significant == bool(effects)


def test_the_gap_is_told_as_deflection_and_the_json_reads_back() -> None:
    d = answer("force_bias", 0.15, seed=2)
    assert d.locate.of == "deflection" and "deflections" in d.statement
    # 0.15 N bend the 30 cm spine by 0.55 mm, the 5 cm spine by 0.04 mm
    cells = {c.value: c for c in d.locate.by["stiffness"]}
    assert cells["spine 30 cm"].rmse_mm == pytest.approx(0.55, abs=0.15) and cells["spine 30 cm"].significant
    assert cells["spine 5 cm"].rmse_mm < 0.1
    assert set(d.locate.by) == {*FACTORS, "stiffness"} and not d.locate.by["pressure"]
    assert Diagnosis.from_json(d.to_json()).to_json() == d.to_json()


def test_effects_that_pushes_cannot_show_are_not_weighed_and_that_is_said() -> None:
    weighed = {e for r in answer(seed=1).attribute.ranking for e in r.effects}
    assert not weighed & {"chamber_azimuth", "body_modulus", "time_offset"}
    assert any("only stiffness trials" in c for c in answer(seed=1).concerns)


def test_the_floor_comes_from_repeats_and_not_from_what_the_model_gets_wrong() -> None:
    p = [prepare(ROBOT, states(case(list(pushes(effect, size, 2))))[0]) for effect, size in (("", 0), ("force_bias", 0.15))]
    for one in p:
        assert one.pushes.noise_components.channel["force"] == pytest.approx(FORCE, rel=0.3)
        assert one.pushes.noise_components.trial["zero"] == pytest.approx(ZERO, rel=0.6)
    assert p[1].pushes.noise_floor == pytest.approx(p[0].pushes.noise_floor, rel=0.05)


def test_beside_a_sweep_they_leave_its_states_and_its_floor_alone() -> None:
    rows = sweep(3, (0.0, 0.1, 0.2, 0.3))
    shown = [replace(r, trial=r.trial + 100) for r in pushes(body=True)]
    alone, both = (prepare(ROBOT, states(case(x))[0]) for x in (rows, shown + rows))
    n = len(rows)
    assert len(both.states) == n + len(shown)
    assert both.noise_components == alone.noise_components and both.noise_floor == alone.noise_floor
    assert np.array_equal(both.states.kind[:n], alone.states.kind)
    own = both.labels.kind < 3
    assert np.array_equal(both.problem.observed[own], alone.problem.observed)
    assert np.array_equal(both.problem.noise.sd[own], alone.problem.noise.sd)
    gap = both.gap(both.problem.observed)
    assert np.isfinite(gap[:n]).all() and np.isnan(gap[n:]).all()
    assert {"force_bias", "chamber_azimuth"} <= set(both.problem.parameters.ids)


def test_deflections_that_were_meant_alike_are_repeats_though_the_arm_misses_a_little() -> None:
    rng = np.random.default_rng(3)
    rows = [replace(r, deflection=r.deflection + 5e-6 * rng.normal()) for r in pushes()]  # type: ignore[operator]
    s = states(case(rows))[0]
    assert s.repeats == 3 and len(np.unique(s.condition)) == 36
    assert not lacking(s) and lacking(states(case([r for r in rows if r.repeat == 1]))[0])
    assert lacking(states(case([r for r in rows if r.spine_length == 0.1]))[0])


def test_a_state_read_twice_in_one_trial_is_no_repeat() -> None:
    rows = sweep(1)
    assert states(case(rows + [replace(r, step=r.step + 50) for r in rows]))[0].repeats == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"deflection": 3.0}, "looks like mm; .* divide by 1000"),
        ({"spine_length": 20.0}, "longer than the robot"),
        ({"spine_length": 0.0}, "specimen body"),
    ],
)
def test_rows_that_no_trial_gives_are_refused(change: dict[str, float], said: str) -> None:
    first, *rest = pushes()
    with pytest.raises(BadCase, match=said):
        states(case([replace(first, **change), *rest]))  # type: ignore[arg-type]


def test_few_repeats_name_nothing() -> None:
    rows = [r for r in pushes("force_bias", 0.15, 2) if r.repeat == 1]
    d = diagnose(case(rows), Options(quantify=False, experiments=False, catalogue=RIVALS))
    assert d.attribute.verdict == "unknown"
    assert any("deflections were not repeated" in c for c in d.concerns)
