"""Find readings that the other states of a table contradict.

A point jumps: between neighbouring states a place moves as the pressures do. One that moves much farther than such changes of
pressure have moved it elsewhere in the same data was measured on another marker, or after cameras or body were moved. A place is
far from its repeats. States repeat earlier ones to the last digit, as no reading does. A number is far beyond all others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from diagnosis import judgement
from diagnosis.arrays import rows_by
from diagnosis.data.campaign import Campaign
from diagnosis.data.case import campaign_of, finite
from diagnosis.data.levels import REST, SPINE_GAP, distinct, levels, loads
from diagnosis.data.plausible import FARTHEST
from diagnosis.data.shift import terms_of
from model.actuators import Words
from model.arrays import Array, Ints, Mask
from model.robot import Robot
from recordings.trials import Table, marker_columns, pressure_columns

from .robot_numbers import ABOVE


def at_rest(pressures: Array) -> Mask:
    """(n,) rows in which every pressure is the lowest of its chamber, but for noise."""
    finite = np.isfinite(pressures)
    low = np.where(finite, pressures, np.inf).min(axis=0, initial=np.inf)
    high = np.where(finite, pressures, -np.inf).max(axis=0, initial=-np.inf)
    above = np.nan_to_num(pressures - low, nan=np.inf).max(axis=1, initial=0.0)
    return np.asarray(above <= 0.03 * max(float((high - low).max(initial=0.0)), 1e-300))


STILL = 0.1
"""Robot lengths by which hysteresis, creep and noise may move a place while the pressures stay."""
USUAL, TIMES = 90, 2.0
"""Percentile of movement by change of pressure, and times that much more than it a place may move."""
CHANGED = 0.1
"""Share of the range of pressures from which a change of pressure tells how far places move."""
AGAINST = 2
"""Fewest other states that must contradict a state before it is left out."""
TIMES_SCATTER, STRAY, FEW = 10.0, 0.04, 0.025
"""Times the usual distance of a place from its repeats, and robot lengths, beyond which it is none of them (of 96 robots made up,
some with laws that snap, one state in 231 is 0.034 lengths away); the share of all states up to which such a place is a mistake:
what lasts for a trial, such as a slip of the mount, makes more."""
COPIED = 6
"""States in a row that repeat earlier ones to the last digit before they are copies: readings in whole mm may do so by chance."""
MOST_NAMED = 5
"""Of states that do not follow each other, in one note."""
SLIPPED = 3.0
"""Times the highest of the others beyond which a number has a slip of its decimal mark, which makes it ten times as large."""
ALONE, AGREED, MUCH_LESS = 0.02, 0.01, 0.2
"""Robot lengths beyond which a place is no repeat, though below `STRAY`, if those before and after are off by less than this
share of it: pressures of one setting differ by up to 2 % of their range, which moves a tip by up to 0.02 lengths; and the same
where `AGAINST` repeats agree as well: of 136 tables two have such places, read while the body still moved or was touched."""
EXCHANGED, EXCHANGED_SHARE = 3.0, 0.1
"""Times the usual distance from a surface, and share of its own, up to which a state with two pressures exchanged lies on it."""
TIMES_UNREPEATED, KNOWN = 30.0, 0.5
"""Times the usual distance beyond which a place that nobody repeated is a mistake: of 9,000 made-up tables in which bodies snap,
touch, saturate or lag none has one off by 20 between states that are not; and leverage below which others show where it is."""
MOST_TERMS, WEAK = 60, 0.01
"""Of a polynomial of places; and states, as many as which hold each of its factors near zero: one state alone shows none."""
AT_ONCE = 2**20
"""Distances that are computed at once."""
BODIES = ("the tip", *(f"marker {k}" for k in range(1, 100)))


@dataclass(frozen=True)
class Jump:
    """A place that moved farther than the body can."""

    state: int
    """The one after the jump, from 0."""
    bodies: tuple[int, ...]
    """0: the tip, 1 .. markers; and the one of a higher number with which it has changed places, if one."""
    text: str
    """What moved, in the words for the robot's actuators, and that it is left out if others contradict it."""
    against: int
    """States that all contradict this one, at least `AGAINST`, or 0: those at nearly the same pressures and loads, or those
    before and after it, if two points have changed places in this one alone."""


def jumps(states: Table, length: float, words: Words) -> Iterator[Jump]:
    """Points (the tip, markers) that move farther from one state to the next than those of a robot of this length (m) can.

    Compared are each state and the next, and each state at rest and the next one at rest, where both have the same loads (spine,
    masses, vacuum, forces, mounting). A point can move by `STILL` lengths, and by `TIMES` its usual m per Pa of the change."""
    places, every = np.concatenate([states.tip[:, None], states.markers], axis=1), np.arange(len(states))
    lost = np.linalg.norm(places, axis=2) > FARTHEST * length
    if np.count_nonzero(lost.any(axis=1)) <= FEW * len(states):  # `strays` names these; their neighbours are right
        places[lost] = np.nan
    pressures, load = states.pressures, loads(states)

    def apart(a: Ints, b: Ints) -> tuple[Array, Array]:
        """m by which points (.., 1 + k) are apart in states of the same loads, else NaN, and Pa by which pressures are."""
        alike = (load[a] == load[b]).all(axis=1)
        distance = np.linalg.norm(places[a] - places[b], axis=2)
        return np.where(alike[:, None], distance, np.nan), np.abs(pressures[a] - pressures[b]).max(axis=1)

    pairs = dict.fromkeys((a, b) for row in (every, np.flatnonzero(at_rest(pressures))) for a, b in pairwise(row.tolist()))
    earlier, later = np.array(list(pairs) or [(0, 0)]).T
    distance, pressure_change = apart(earlier, later)
    spread = np.nanmax(pressures, initial=-np.inf) - np.nanmin(pressures, initial=np.inf)
    small_change = CHANGED * max(float(spread), 1e-9)
    large_change = (pressure_change > small_change) & np.isfinite(distance).any(axis=1)

    def against(state: int, point: int, usual: float, limit: Array) -> int:
        """How many states at nearly the same pressures there are, if all of them have a point elsewhere, most in one place, and
        no neighbour stands with the state alone."""
        away, change = apart(np.full(len(states), state), every)
        alike = (change <= small_change) & np.isfinite(away[:, point]) & (every != state)
        if alike.sum() < AGAINST or (away[alike, point] <= _reach(length, usual, change[alike])).any():
            return 0
        others = places[alike, point]
        off = np.linalg.norm(others - (middle := np.median(others, axis=0)), axis=1)
        beside = ((earlier == state) | (later == state)) & (distance[:, point] <= limit)
        apart_from_them = np.linalg.norm(places[(earlier + later - state)[beside], point] - middle, axis=1) > limit[beside]
        return 0 if apart_from_them.any() or np.median(off) > STILL * length / 2 else len(others)

    found: dict[tuple[int, int], Jump] = {}
    for point in range(places.shape[1] if large_change.any() else 0):  # else nothing shows how far pressures move the body
        usable = large_change & np.isfinite(distance[:, point])
        usual = float(np.percentile(distance[usable, point] / pressure_change[usable], USUAL)) if usable.any() else 0.0
        limit = _reach(length, usual, pressure_change)
        far, seen = distance[:, point] > limit, np.isfinite(distance[:, point])
        taken = {i: _taken(places[earlier[i]], places[later[i]], point, limit[i]) for i in np.flatnonzero(far).tolist()}
        contradicted = dict[int, int]()
        for state in np.union1d(earlier[far], later[far]).tolist():
            held = [taken.get(i) for i in np.flatnonzero(seen & ((earlier == state) | (later == state))).tolist()]
            alone = len(held) >= AGAINST and held[0] is not None and len(set(held)) == 1
            contradicted[state] = len(held) if alone else against(state, point, usual, limit)
        for i, other in taken.items():
            bodies = (point,) if other is None else (point, other)
            state = int(earlier[i] if contradicted.get(int(earlier[i])) else later[i])
            what = (
                f"{BODIES[point]} moves by {1e3 * distance[i, point]:.1f} mm while no {words.pressure} changes by more than "
                f"{pressure_change[i] / words.pascal:.3g} {words.unit}, farther than the body can"
                if other is None
                else f"{BODIES[point]} and {BODIES[other]} swap places"
            )
            compared = contradicted.get(state, 0)
            left_out = f", unlike in all {compared} states that compare with this one: left out" * bool(compared)
            found[state, point] = Jump(state, bodies, what + left_out, compared)
    # each once: a state may be held against the one before it and the last one at rest, and both points change places
    yield from (jump for _, jump in sorted(found.items()) if jump.bodies[0] == min(jump.bodies))


def _taken(before: Array, after: Array, point: int, limit: float) -> int | None:
    """The point that `point` changes places (1 + k, 3) with from one state to the next, both within `limit`."""
    there, back = np.linalg.norm(before - after[point], axis=1), np.linalg.norm(after - before[point], axis=1)
    return next(iter(np.flatnonzero((there <= limit) & (back <= limit)).tolist()), None)  # not the point itself: it is far


def _reach(length: float, usual: float, change: Array) -> Array:
    """m by which a point can move while the pressures change (Pa), of which it follows with `usual` (m/Pa)."""
    return STILL * length + TIMES * usual * change


def without(places: Sequence[tuple[int, int]], states: Table) -> tuple[Table, Mask]:
    """States without some places (state, body), and (n,) which are kept: one without its tip is not."""
    gone = np.isin(np.arange(len(states)), [state for state, body in places if not body])
    for state, body in places:
        here = np.arange(len(states)) == state
        states = states.replaced({n: np.where(here, np.nan, states[n]) for n in marker_columns(body)[-1]}) if body else states
    return states.take(~gone), ~gone


def without_contradicted(table: Table, robot: Robot) -> Table:
    """A table that no import has checked without the places that jump and that others contradict, each with a warning."""
    rows = np.flatnonzero(table.with_tip)
    every = jumps(table.take(rows), robot.length, robot.actuators.words) if len(rows) > AGAINST else ()
    found = [jump for jump in every if jump.against]
    places = [(int(rows[j.state]), body) for j in found for body in j.bodies]
    warnings = (f"{table.place(int(rows[j.state]))}: {j.text}" for j in found)
    return replace(without(places, table)[0], warnings=(*table.warnings, *warnings))


def believed(table: Table, robot: Robot, place: Callable[[int], str] | None = None) -> Table:
    """A table without states with slips or that repeat others to the last digit, and places far from their repeats, with a
    warning for each; `place` names a state in them, `table.place` if None."""
    place = place or table.place
    gone, said = unusable(table, robot, place)
    kept = np.setdiff1d(np.flatnonzero(table.with_tip & finite(table)), gone)
    stray = dict(strays(campaign_of(table, kept, kept[:0]), robot.length)) if kept.size else {}
    said += (f"{place(row)}: {text}" for (row, _), text in stray.items())
    return replace(without([*stray, *((row, 0) for row in gone)], table)[0], warnings=(*table.warnings, *said))


def unusable(table: Table, robot: Robot, place: Callable[[int], str], written_twice: bool = False) -> tuple[list[int], list[str]]:
    """Rows of states with slips, that are `misread`, or that repeat others to the last digit (`written_twice`: with their times),
    and what to say of them, where `place` names each."""
    every = np.flatnonzero(table.with_tip & finite(table))
    if not every.size:
        return [], []
    slipped = {int(every[state]): text for state, text in slips(table.take(every), robot)}
    own = campaign_of(table, np.setdiff1d(every, [*slipped]), every[:0])
    time, found = table.get("t"), copies(own)
    slipped |= misread(own, robot)
    repeated = [(rows, of) for rows, of in found if not written_twice or np.array_equal(time[rows], time[of])]
    said = [f"{place(row)}: {text}" for row, text in slipped.items()]
    for block, earlier in repeated:
        said.append(f"{listed(block, place)}: repeats {listed(earlier, place)} to the last digit, as copies do: left out")
    return [*slipped, *(row for rows, _ in repeated for row in rows.tolist())], said


def listed(rows: Ints, place: Callable[[int], str]) -> str:
    """The first and last of rows that follow each other, of others the first few; their file or trial once."""
    in_turn = np.ptp(rows) < len(rows)
    first, *others = dict.fromkeys(map(place, rows[[0, -1]] if in_turn else rows[:MOST_NAMED]))
    own = f"{first.rpartition(' ')[0]} "
    text = (" to " if in_turn else ", ").join([first, *(name.removeprefix(own) for name in others)])
    return text + f" and {len(rows) - MOST_NAMED} more" * (len(rows) > MOST_NAMED and not in_turn)


def slips(states: Table, robot: Robot) -> Iterator[tuple[int, str]]:
    """States with a pressure far above max_pressure and the others (without max_pressure: `SLIPPED` times these), or far below
    zero, a spine longer than the robot, or a mass `SLIPPED` times the others in a part of a trial; and what to say of each. None
    where more than `FEW` of all states are so: a question of the unit."""
    words, most, few, others = robot.actuators.words, robot.highest_limit, int(FEW * len(states)), "the highest of the others"
    pressures, spine, mass = map(np.nan_to_num, (states.pressures, states.spine_length, states.get("tip_mass", 0.0)))
    highest, lowest, pressure, pascal = pressures.max(axis=1), pressures.min(axis=1), (words.pressure, words.unit), words.pascal
    top, load = (float(np.sort(values)[-1 - few]) for values in (highest, mass))
    top, load = top if top > REST else np.inf, load or np.inf  # where nearly all have none, nothing stands out
    above, limit = (SLIPPED * top, others) if most is None else (ABOVE * max(top, most), f"max_{words.pressure}")
    heavy = mass > SLIPPED * load
    for far, (name, unit), size, values, usual, of in (
        (highest > above, pressure, pascal, highest, most or top, limit),
        (lowest < -CHANGED * top, pressure, pascal, lowest, top, others),
        (spine > robot.length + SPINE_GAP, ("spine_length", "mm"), 1e-3, spine, robot.length, "the robot's length"),
        (heavy & np.isin(states.trial, states.trial[~heavy]), ("tip_mass", "g"), 1e-3, mass, load, others),
    ):
        remedy = "correct the cell" + ", or robot.yaml" * (of != others)
        for i in np.flatnonzero(far).tolist() if far.sum() <= few else ():
            times = f"{values[i] / usual:.2g} times {of} ({usual / size:.4g} {unit})"
            yield i, f"{name} {values[i] / size:.4g} {unit}, {times}: left out; {remedy}"


def copies(own: Campaign) -> Iterator[tuple[Ints, Ints]]:
    """Rows (k,) of states, and of those whose places they repeat to the last digit: at least `COPIED` in a row at the pressures
    of earlier ones; or all but the last at the same pressures and time, if other places have other times. None where all repeats
    are alike, as in a simulated table."""
    read, state = [own.tip, own.spine_length, own.trials.markers.reshape(len(own), -1)], np.arange(len(own))
    places = np.nan_to_num(np.column_stack(read), nan=np.inf)
    _, first = np.unique(places, axis=0, return_index=True)
    at_pressures = np.column_stack([places, own.trials.pressures])
    _, once, group = np.unique(at_pressures, axis=0, return_index=True, return_inverse=True)
    earlier = once[group.ravel()]
    alike = (earlier != state) & (len(np.unique(own.condition[first])) < len(first))
    blocks = np.split(state, np.flatnonzero(np.diff(state - earlier)) + 1)
    for rows in (b for b in blocks if b.size >= COPIED and alike[b].all()):
        alike[rows] = False
        yield own.row[rows], own.row[earlier[rows]]
    for clock in (own.time, distinct(own.trial, own.time)):  # that of the second begins anew in each trial
        twice = np.flatnonzero(alike & (clock == clock[earlier]))
        if twice.size and len(np.unique(clock[first])) == len(first):
            alike[twice] = False
            last = twice[np.argsort(earlier[twice], kind="stable")]  # of two at rest the last begins a trial: it stays
            yield own.row[np.where(np.diff(earlier[last], prepend=-1), earlier[last], np.roll(last, 1))], own.row[last]


def strays(own: Campaign, length: float) -> Iterator[tuple[tuple[int, int], str]]:
    """Places (state, body) far from those in all states of other trials at the same pressures and loads, if one of them was read
    on the same branch or both are at rest, by `TIMES_SCATTER` times what is usual and by `STRAY` lengths (m), or less where the
    states before and after are not; those out of reach; where repeats scatter, those of the state before at other pressures; and
    what to say of each; of two, both, or the one `off_surface` of the others. None where more than `FEW` of all states are so."""
    pressures = (levels(of_one, own.pressure_gap) for of_one in own.trials.pressures.T)
    driven = np.abs(np.diff(own.trials.pressures, axis=0, prepend=np.nan)).max(axis=1) > CHANGED * np.ptp(own.trials.pressures)
    setting, way = distinct(loads(own.trials), *pressures), np.where(at_rest(own.trials.pressures), 0.0, own.branch)
    for body, place in enumerate((own.tip, *np.swapaxes(own.trials.markers, 0, 1))):
        reach = np.linalg.norm(place, axis=1)
        seen, lost = np.flatnonzero(reach <= FARTHEST * length), np.flatnonzero(reach > FARTHEST * length)
        for i in lost.tolist() if len(lost) <= FEW * len(own) else ():
            away = f"{reach[i]:.3g} m from the base, farther than a body of {length:g} m reaches: left out"
            yield (int(own.row[i]), body), f"{BODIES[body]} is {away}"
        nearest = np.full(len(own), -1)
        for rows in (seen[of_setting] for of_setting in rows_by(setting[seen]) if of_setting.size > 1):
            for part in np.array_split(rows, 1 + rows.size**2 // AT_ONCE):
                others = own.trial[part, None] != own.trial[rows]  # what lasts for a trial is no mistake in one of its states
                others |= ~others.any(axis=1, keepdims=True) & (part[:, None] != rows)
                apart = sum((along[part, None] - along[rows]) ** 2 for along in place.T)
                nearest[part] = rows[np.where(others, apart, np.inf).argmin(axis=1)]
                nearest[part[~(others & (way[part, None] == way[rows])).any(axis=1)]] = -1  # hysteresis sets branches apart
        off = np.where(nearest < 0, np.nan, np.linalg.norm(place - place[nearest], axis=1))
        usual = float(np.median(off[np.isfinite(off)])) if np.isfinite(off).any() else 0.0
        far = np.flatnonzero(off > max(TIMES_SCATTER * usual, AGREED * length))
        far = far[[off[i] > STRAY * length or _alone(own, place, nearest, off, setting, i, length) for i in far.tolist()]]
        if far.size:
            distance, stray, leverage = off_surface(own.trials, place, reach <= FARTHEST * length, length)
            far = far[~(stray & (leverage < 1))[nearest[far]] | (distance[far] >= MUCH_LESS * off[far])]
        for i in far.tolist() if len(far) <= FEW * len(own) else ():
            away = f"{1e3 * off[i]:.1f} mm from all its repeats, usually {1e3 * usual:.2g} mm: left out"
            yield (int(own.row[i]), body), f"{BODIES[body]} is {away}"
        still = np.flatnonzero(driven & (np.diff(place, axis=0, prepend=np.nan) == 0).all(axis=1) & (usual > 0))
        for i in still.tolist() if len(still) <= max(1.0, FEW * len(own)) else ():
            yield (int(own.row[i]), body), f"{BODIES[body]} repeats the state before to the last digit: left out"


def _alone(own: Campaign, place: Array, nearest: Ints, off: Array, setting: Ints, i: int, length: float) -> bool:
    """Whether state i is `off` (m) the nearest repeat of its place (n, 3), while in its trial those before and after are not and
    no other at its setting stands with it: a slip, a first cycle or a drift lasts; nor is it at a peak: it may snap there. And
    `AGAINST` repeats agree; or it is not off by up to the steps that the body takes there, as one that snaps, lags or creeps."""
    around, own_trial, alike = [i - 1, i + 1], own.trial == own.trial[i], setting == setting[i]
    beside = np.linalg.norm(place[own_trial & alike] - place[i], axis=1) < 0.5 * off[i]
    if beside.sum() > 1 or not _between(own, off, i):
        return False
    others = place[alike & ~own_trial & np.isfinite(off)]
    agree = len(others) >= AGAINST and np.linalg.norm(others - np.median(others, axis=0), axis=1).max() < MUCH_LESS * off[i]
    if agree or off[i] <= ALONE * length:
        return bool(agree)
    from scipy.optimize import lsq_linear  # a twentieth of a short command, for few tables

    steps, error = place[around] - place[nearest[i]], place[i] - place[nearest[i]]
    return bool(np.linalg.norm(lsq_linear(steps.T, error, (-1.0, 1.0)).fun) > 0.5 * off[i])


def _between(own: Campaign, off: Array, i: int) -> bool:
    """Whether those before and after state i in its trial are `off` (m) much less, and it is at no peak: it may snap there."""
    around = [i - 1, i + 1]
    inside = 0 < i < len(own) - 1 and (own.trial[around] == own.trial[i]).all() and (off[around] < MUCH_LESS * off[i]).all()
    return bool(inside and (own.highest[around] >= own.highest[i]).any())


def off_surface(states: Table, place: Array, seen: Mask, length: float) -> tuple[Array, Mask, Array]:
    """m (n,) from places (n, 3) to a polynomial in pressures and loads, fitted by least squares to the others of `seen` (n,) that
    are not far; which are far, as for `strays`; and leverages (n,): above 1 no other state is near."""
    every = terms_of(states, min(int(seen.sum()) // judgement.SHIFT_ROWS_PER_TERM, MOST_TERMS))
    far = ~seen
    for _ in range(judgement.SHIFT_ROUNDS):
        used = seen & ~far
        fitted = every[used]
        inverse = np.linalg.inv(fitted.T @ fitted + WEAK * np.eye(every.shape[1]))
        leverage = ((every @ inverse) * every).sum(axis=1)
        missed = place - every @ (inverse @ (fitted.T @ place[used]))
        off = np.linalg.norm(missed, axis=1) / np.where(used, 1 - leverage, 1.0)
        far = off > max(TIMES_SCATTER * float(np.median(off[seen])), STRAY * length)
        if np.array_equal(used, seen & ~far):
            break
    return off, far, leverage


def misread(own: Campaign, robot: Robot) -> Iterator[tuple[int, str]]:
    """States whose tip is far `off_surface`, but on it with two of their pressures exchanged; or by `TIMES_UNREPEATED` times what
    is usual, at pressures and loads of no other state, either between states that are on it and at no peak, or at pressures that
    `AGAINST` others have under other loads; and what to say of each. None where more than `FEW` of all states are far: the
    surface is not theirs."""
    seen, words = np.linalg.norm(own.tip, axis=1) <= FARTHEST * robot.length, robot.actuators.words
    rows = np.flatnonzero(off_surface(own.trials, own.tip, seen, robot.length)[1] & seen) if seen.any() else np.arange(0)
    if not 0 < len(rows) <= FEW * len(own):
        return
    far, pairs = own.trials.take(rows), list(combinations(pressure_columns(own.pressure.shape[1]), 2))
    both = Table.stacked([own.trials, *(far.replaced({a: far[b], b: far[a]}) for a, b in pairs)])
    seen = np.append(seen, np.zeros(len(both) - len(own), bool))
    off, _, leverage = off_surface(both, both.tip, seen, robot.length)
    usual, load = float(np.median(off[seen])), loads(own.trials)
    lefts = np.where(leverage < 1, off, np.inf)[len(own) :].reshape(len(pairs), -1).T
    for i, left in zip(rows.tolist(), lefts, strict=True):
        away = f"the tip is {1e3 * off[i]:.1f} mm from where the other states put it, usually {1e3 * usual:.2g} mm"
        alike = np.abs(own.pressure - own.pressure[i]).max(axis=1) <= own.pressure_gap
        alone = np.count_nonzero(alike & (load == load[i]).all(axis=1)) == 1
        shown = alike.sum() > AGAINST or (leverage[i] < KNOWN and _between(own, off, i))
        if left.min(initial=np.inf) < min(EXCHANGED * usual, EXCHANGED_SHARE * off[i]):
            pair = " and ".join(column[1:] for column in pairs[left.argmin()])
            exchange = f"{words.pressures} {pair} are exchanged: {away}, and with these exchanged {1e3 * left.min():.1f} mm"
            yield int(own.row[i]), f"{exchange}: left out; correct the cells"
        elif off[i] > TIMES_UNREPEATED * usual and leverage[i] < 1 and alone and shown:
            yield int(own.row[i]), f"{away}: left out"
