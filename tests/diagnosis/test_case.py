"""What a table can be asked, and what it is refused for."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.data.case import Case as Measured
from diagnosis.data.case import states
from diagnosis.data.levels import levels, pressure_gap
from diagnosis.errors import BadCase
from model.robot import load_robot
from recordings.trials import Table, TrialRow

ROBOT = load_robot(Path(__file__).parents[2] / "examples" / "paper" / "robot.yaml")


def row(trial: int, step: int, length: float, pressure: float, branch: str = "load", repeat: int = 1) -> TrialRow:
    used = tuple(pressure if c in (8, 0, 1) else 0.0 for c in range(9))
    tip = (-0.2 * pressure / 250e3, 0.0, 0.39)
    return TrialRow(trial, step, "bending", repeat, branch, 60.0 * trial + 8.0 * step, length, used, hold=3.0, rate=25e3, tip=tip)


def sweep(repeats: int = 3, lengths: tuple[float, ...] = (0.0, 0.15, 0.3), unload: bool = True) -> list[TrialRow]:
    rows, trial = [], 0
    for repeat in range(1, repeats + 1):
        for length in lengths:
            trial += 1
            plan = [(p, "load") for p in (0.0, 100e3, 200e3)] + ([(100e3, "unload"), (0.0, "unload")] if unload else [])
            rows += [row(trial, i, length, p, b, repeat) for i, (p, b) in enumerate(plan, 1)]
    return rows


def case(rows: list[TrialRow]) -> Measured:
    return Measured(ROBOT, Table.of(rows))


def test_repeats_of_a_state_are_found_by_what_was_meant() -> None:
    found, concerns = states(case(sweep()))
    assert found.repeats == 3
    assert len(np.unique(found.condition)) == 15
    assert set(found.kind) == {0}
    assert concerns == ()


def test_a_trial_that_drives_several_groups_to_one_pressure_repeats_each_of_its_states() -> None:
    rows, rng = [], np.random.default_rng(0)
    plan = list(enumerate(itertools.product(([0], [1], [0, 1], [1, 2]), (100e3, 200e3))))
    for trial, (step, (group, p)) in itertools.product((1, 2, 3), plan):
        read = tuple(p * (c in group) + rng.normal(0.0, 400.0) for c in range(9))
        rows.append(replace(row(trial, step, 0.0, p, repeat=trial), pressures=read))
    found, _ = states(case(rows))
    assert found.repeats == 3 and len(np.unique(found.condition)) == 8


def test_a_heavier_tip_is_another_kind_of_experiment() -> None:
    extra = [replace(r, trial=r.trial + 9, tip_mass=0.153) for r in sweep(1)]
    assert set(states(case(sweep() + extra))[0].kind) == {0, 1}


def test_a_weaker_vacuum_is_another_experiment_also_where_a_leak_takes_more_from_a_longer_spine() -> None:
    # 80, 71 and 62 kPa, and with less vacuum 64, 57 and 50 kPa.
    leaking = [replace(r, vacuum=80e3 - 60e3 * r.spine_length) for r in sweep()]
    found, _ = states(case([*leaking, *(replace(r, trial=r.trial + 9, vacuum=0.8 * (r.vacuum or 0.0)) for r in leaking)]))
    assert len(np.unique(found.condition)) == 30
    assert [set(found.kind[found.trial == t]) for t in (1, 2, 3)] == [{0}] * 3
    assert [set(found.kind[found.trial == t]) for t in (10, 11, 12)] == [{1}] * 3


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        (sweep(1), "not_repeated"),
        (sweep(2), "repeated_once"),
        (sweep(3, (0.1,)), "one_spine_length"),
        (sweep(3, unload=False), "no_unload"),
        ([r for r in sweep() if max(r.pressures) == 100e3], "one_pressure"),
        ([r for r in sweep() if max(r.pressures) == 0], "not_bent"),
        ([*sweep(), replace(row(40, 1, 0.0, 100e3), tip=(float("nan"), 0.0, 0.4))], "states_not_finite"),
    ],
)
def test_what_is_missing_is_said(rows: list[TrialRow], code: str) -> None:
    (found,) = [f for f in states(case(rows))[1] if f.code == code]
    assert code != "states_not_finite" or "1 of 46 states" in found.text


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([replace(r, tip=(40.0, 0.0, 0.4)) for r in sweep()], "looks like cm"),
        ([replace(r, pressures=(0.0, 1e5)) for r in sweep()], "rows with 2 pressures .*: p3, .* p9 are missing"),
        ([replace(r, spine_length=0.5) for r in sweep()], "longer than the robot"),
        ([replace(r, protocol="stiffness", tip=None) for r in sweep()], "rows has a tip"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_with_what_to_do(rows: list[TrialRow], said: str) -> None:
    with pytest.raises(BadCase, match=said):
        states(case(rows))


def test_chambers_swept_one_after_another_in_a_trial_are_repeats_of_themselves() -> None:
    rng = np.random.default_rng(5)
    rows = []
    for trial in (1, 2, 3):
        step = 0
        for chamber in (0, 3, 6):
            for level in (0.0, 50e3, 100e3, 50e3, 0.0):
                step += 1
                pressure = np.zeros(9)
                pressure[chamber] = level + 60.0 * rng.normal() * (level > 0)
                made = row(trial, step, 0.0, 0.0, branch="unload" if step % 5 in (4, 0) else "load", repeat=trial)
                rows.append(
                    replace(made, t=10.0 * len(rows), pressures=tuple(pressure), tip=(-1e-6 * level, 1e-3 * chamber, 0.4))
                )
    own, concerns = states(case(rows))
    _, counts = np.unique(own.condition, return_counts=True)
    assert set(counts.tolist()) <= {3, 6} and counts.sum() == 45
    assert not any("most states were read in one" in text for text in map(str, concerns))


@pytest.mark.parametrize(("scatter", "gap"), [(50.0, 0.8e3), (500.0, 1.5e3), (5e3, 3e3)])
def test_a_narrow_range_is_told_apart_finely_but_not_finer_than_its_scatter(scatter: float, gap: float) -> None:
    rows = [replace(row(1, i, 0.0, 2.5e3 * i), sd={"p1": scatter, "p9": scatter}) for i in range(1, 17)]
    assert pressure_gap(Table.of(rows)) == pytest.approx(gap) and pressure_gap(Table.of([row(1, 1, 0.0, 250e3)])) == 3e3


def test_steps_of_2500_pa_are_states_of_their_own_where_40_kpa_is_the_most() -> None:
    s = states(case([row(t, 1, 0.0, 2.5e3 * t) for t in range(2, 17)]))[0]
    assert len(np.unique(s.condition)) == 15
    assert len(np.unique(levels(s.highest, s.pressure_gap))) == 15


def test_chambers_set_one_by_one_are_no_repeats_because_one_of_them_is_as_high() -> None:
    settings = [(92e3, 20e3, 5e3), (92.3e3, 45e3, 5e3), (91.8e3, 20.4e3, 5.2e3), (40e3, 21e3, 40e3)]
    rows = [replace(row(t, 1, 0.0, 0.0), pressures=(*p, *(0.0,) * 6)) for t, p in enumerate(settings, 1)]
    a, b, again, other = states(case(rows))[0].condition.tolist()
    assert a == again and len({a, b, other}) == 3
