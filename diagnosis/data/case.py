"""From a table of trials to arrays, and which questions the table can answer.

Rows that cannot be used are left out and counted, a table that cannot be used at all is refused, and what a small table cannot
answer is reported as a concern with the result.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from model.robot import Robot
from recordings.trials import Table

from ..arrays import Array, Ints, Mask, rows_by
from ..errors import BadCase
from ..findings import Finding, finding
from ..remedies import of_trials
from .campaign import Campaign
from .levels import LOADS, RATE_GAP, SPINE_GAP, VACUUM_GAP, by_frequency, distinct, levels, loads, pressure_gap, step_gap
from .plausible import complete, implausible_values, of_body, require_plausible_pushes

UNCLEAR = 0.35, 0.65
"""Shares of a state's highest pressure between which noise decides whether a chamber counts as inflated, from half of it on."""


@dataclass(frozen=True)
class Case:
    """A robot and a table of trials."""

    robot: Robot
    table: Table


def states(case: Case) -> tuple[Campaign, tuple[Finding, ...]]:
    """The states with a tip and those of stiffness trials, and concerns about the table; raises `BadCase`."""
    robot = case.robot
    table, rows = case.table, np.arange(len(case.table))
    of_robot, of_pushes = rows[table.with_tip], rows[complete(table)]
    if not of_robot.size and not of_pushes.size:
        raise BadCase(
            f"none of the {len(table)} rows has a tip position, or force and deflection of a stiffness trial: "
            "record a bending, elongation or stiffness run"
        )
    usable, usable_pushes = of_robot[finite(table)[of_robot]], of_pushes[np.isfinite(table.spine_length[of_pushes])]
    every, good = len(of_robot) + len(of_pushes), len(usable) + len(usable_pushes)
    if not good:
        raise BadCase(f"all {every} states have values that are not finite: nothing can be compared")
    concerns = [finding("states_not_finite", left_out=every - good, states=every)] if good < every else []
    if wrong := implausible_values(robot, table.take(np.concatenate([usable, usable_pushes])))[0]:
        raise BadCase("\n".join(wrong))
    require_plausible_pushes(robot, table.take(usable_pushes))
    campaign = campaign_of(table, usable, usable_pushes)
    if (unread := rows[table.unread]).size:
        campaign = replace(campaign, history=campaign_of(table, unread, unread[:0]))
    return campaign, (*concerns, *_concerns(campaign, robot))


def campaign_of(table: Table, of_robot: Ints, of_trials: Ints) -> Campaign:
    """The campaign of these rows of a table, those of the robot and those of stiffness trials."""
    row = np.concatenate([of_robot, of_trials])
    none = np.zeros(len(row), np.int64)
    s = Campaign(table.take(row), row, none, none, pressure_gap(table.take(of_robot)))
    # states of the robot and pushes, by specimen and vacuum, come one behind the other, and share no number
    pushes = s.trials.take(s.pushed)
    of_pushes = by_frequency(of_body(pushes).astype(np.int64), levels(pushes.get("vacuum", 0.0), VACUUM_GAP))
    kinds = np.concatenate([_kinds(s.take(~s.pushed)), of_pushes])
    s = replace(s, kind=distinct(s.pushed, kinds))
    found = np.concatenate([_conditions(s.take(~s.pushed)), _conditions_of_pushes(s.take(s.pushed))])
    return replace(s, condition=distinct(s.pushed, found))


def finite(trials: Table) -> Mask:
    """(n,) states whose tip, spine length and pressures are all numbers."""
    return np.asarray(np.isfinite(np.column_stack([trials.tip, trials.spine_length, trials.pressures])).all(axis=1))


def _conditions(s: Campaign) -> Ints:
    """(n,) number of each state's condition: spine length, pressures, branch, kind and hold."""
    # settled readings take varying times; holds of 2, 5 and 10 s were meant to differ
    hold = levels(np.log1p(s.trials.get("hold", 0.0)), 0.4)
    level, branch = levels(s.highest, s.pressure_gap), s.branch.astype(np.int64)
    settings_alone = distinct(levels(s.spine_length, SPINE_GAP), level, branch, s.kind)
    found = distinct(settings_alone, hold)  # but not where most were read once at each of several paces
    found = found if not len(s) or np.median(np.bincount(found)[found]) >= 2 else settings_alone
    settings = np.zeros(s.pressure.shape, np.int64)
    for own in (found == c for c in np.unique(found)):
        # chambers that differ by more were set otherwise, whatever the highest pressure is
        if np.ptp(s.pressure[own], axis=0).max() > 6.0 * s.pressure_gap:
            settings[own] = np.column_stack([levels(chamber, s.pressure_gap) for chamber in s.pressure[own].T])
    return distinct(found, settings)


def _kinds(s: Campaign) -> Ints:
    """(n,) number of each state's kind of experiment, 0 the most frequent; what a row does not state counts as 0."""
    trials = s.trials
    while_ramping, rate = trials.get("hold") <= 0, np.abs(trials.get("rate", 0.0))
    inflated, ramp = s.inflated.copy(), np.zeros(len(trials))
    for in_trial in rows_by(s.trial):
        # A sweep is of one kind: near zero pressure no chamber stands out, and at its ends it stands still.
        inflated[in_trial] = _sweeps(inflated[in_trial], s.pressure[in_trial], s.pressure_gap)
        ramp[in_trial] = rate[in_trial].max() if while_ramping[in_trial].any() else 0.0
    vacuum = np.zeros(len(trials), np.int64)
    for own in rows_by(levels(s.spine_length, SPINE_GAP)):  # a leak takes more from a longer spine
        vacuum[own] = levels(-trials.get("vacuum", 0.0)[own], VACUUM_GAP)
    return by_frequency(
        np.unique(trials.get("protocol"), return_inverse=True)[1],
        distinct(inflated),
        loads(trials)[:, [name not in ("spine_length", "vacuum") for name in LOADS]],
        vacuum,
        levels(ramp, RATE_GAP),
    )


def _sweeps(inflated: Mask, pressure: Array, gap: float) -> Mask:
    """(m, chambers) chambers of the sweep that each of the m states of a trial belongs to; `pressure` and `gap` in Pa."""
    highest = pressure.max(axis=1)
    top, share = inflated[np.argmax(highest)], pressure / np.maximum(highest, gap)[:, None]
    others = np.where(top, share < UNCLEAR[0], share > UNCLEAR[1]).any(axis=1) & (highest > highest.max() / 2)
    out = np.where((inflated & top).any(axis=1, keepdims=True) & ~others.any(), top, inflated)  # else each state is of its own
    # closer to zero, the readings do not show which chambers are inflated
    with_pressure = np.flatnonzero(highest > 3.0 * gap)
    if not with_pressure.size:
        return np.broadcast_to(top, out.shape)
    following = np.searchsorted(with_pressure, np.arange(len(out)))
    return np.asarray(out[with_pressure[np.minimum(following, with_pressure.size - 1)]])


def lacking(s: Campaign) -> tuple[str, ...]:
    """Data that are missing to name a cause: repeated states, a robot bent at two pressures; or, of stiffness trials, a
    specimen pushed to two deflections at two lengths, or two specimens. Templates of `Words`."""
    own, pushes = s.take(~s.pushed), s.take(s.pushed)
    if not (len(own) and own.repeats >= 2):
        places = len(np.unique(distinct(levels(pushes.spine_length, SPINE_GAP), pushes.kind)))
        if len(np.unique(pushes.condition)) > places > 1 and pushes.repeats >= 2:
            return ()
        if not len(own):
            return ("no repeated pushes to two deflections at two lengths",)
        return ("states were repeated, but all in one trial" if own.within_trials else "most states were read in one trial only",)
    if own.highest.max() <= s.pressure_gap:
        return ("no state is bent",)
    return () if len(np.unique(levels(own.highest, s.pressure_gap))) > 1 else ("only one {pressure}",)


def _concerns(s: Campaign, robot: Robot) -> Iterator[Finding]:
    """What a small table, and its stiffness trials, cannot answer."""
    tips, pushes, words = s.take(~s.pushed), s.take(s.pushed), robot.actuators.words
    if len(tips):
        if robot.spine is not None and len(np.unique(levels(tips.spine_length, SPINE_GAP))) < 2:
            yield finding("one_spine_length", words)
        if len(np.unique(levels(tips.highest, s.pressure_gap))) < 2:
            yield finding("one_pressure", words)
        if tips.highest.max() < s.pressure_gap:
            yield finding("not_bent", words)
        if tips.within_trials:
            yield finding("repeated_within_trials", remedy=of_trials(tips.trials))
        elif tips.repeats < 3:
            yield finding("not_repeated" if tips.repeats < 2 else "repeated_once", words)
        if not (tips.branch < 0).any():
            yield finding("no_unload", words)
        if straight := s.trials.moved_to_model:
            yield finding("moved_to_model", words, straight=straight)
    elif len(pushes):
        yield finding("only_stiffness_trials", words)
    if len(pushes):
        if pushes.repeats < 3:
            how = "were not repeated" if pushes.repeats < 2 else "were repeated only once"
            yield finding("deflections_not_repeated", how=how)
        if len(np.unique(levels(pushes.spine_length, SPINE_GAP))) < 2:
            yield finding("one_stiffness_length")


def _conditions_of_pushes(s: Campaign) -> Ints:
    """Number of each state's condition: kind, spine length, branch and step of deflection."""
    same = distinct(s.kind, levels(s.spine_length, SPINE_GAP), -s.branch.astype(np.int64))
    level = np.zeros(len(s), np.int64)
    for own in rows_by(same):
        level[own] = levels(s.deflection[own], step_gap(s.deflection[own], s.trial[own]))
    return distinct(same, level)
