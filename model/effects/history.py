"""Effects that remember: friction that opposes a change of shape, and a material that follows late.

Both are driven by the elastic rod, that is by the curvature and axial strain the same rod has without memory, and
answer with a rest curvature and a rest strain. A trial starts at its own state of zero pressure: friction is released
with the vacuum, and what the silicone has not yet recovered from the trial before fades in the time between. Between two
readings the drive stays, ramps linearly for |dP| / rate and stays again for the hold time of the later reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.arrays import Array, Ints, Mask
from model.condition import States
from model.effects import layout as at
from model.effects.compose import RodColumns, silicone_share
from model.effects.quantities import Quantities
from model.robot import Robot
from model.rods import columns as col
from model.rods.fast.compiler import kernel
from model.rotation import CONJUGATE, multiply, rotation_vector

CELLS = 12
"""Cells of equal length along the body: the silicone of each remembers its own shapes, whether the spine is in it or not."""
SHORTEST = 1e-4
"""m; a part shorter than this has no curvature to speak of."""

DRIVES = 8
"""Curvature x, y, z (1/m) and axial strain of the part with spine, then of the part beyond it."""
OF_PART = DRIVES // 2

USUAL_PAUSE = 20.0
"""Paces of the campaign between trials whose times are not known."""


def rest_columns(robot: Robot, layout: at.Layout) -> list[int]:
    """Columns of a rod to which memory adds, element by element: the drive of a part, with tendons the rise of curvature too."""
    each = (*range(col.REST_CURVATURE, col.REST_CURVATURE + 3), col.REST_STRAIN + 2)
    rises = (col.RISE, col.RISE + 1) if robot.tendons is not None else ()
    return [element + column for element in layout.elements for column in (*each, *rises)]


@dataclass(frozen=True)
class Path:
    """When and in which order the drive changes: one line a step, from one state to another."""

    before: Ints
    """(k,) index of the state a step comes from; a trial starts at its rest."""
    after: Ints
    """(k,) index of the state it leads to; steps of a trial follow each other."""
    first: Mask
    """(k,) the trial starts here."""
    stay: Array
    ramp: Array
    hold: Array
    """(k,) s each; before a trial the time since the one before is stayed at rest, inf where the table has no times."""

    def lag(self, drive: Array, time: float) -> Array:
        """(v, n, c) a drive (v, n, c) less what follows it with the relaxation time (s)."""
        out = np.zeros(drive.shape)
        _lag(np.ascontiguousarray(drive), self.before, self.after, self.first, self.stay, self.ramp, self.hold, time, out)
        return out

    def sliding(self, drive: Array, yields: Array) -> Array:
        """Mean state (v, n, c) of elastic-sliding elements that share a drive (v, n, c).

        Each is stretched with the drive from 0 at rest and slides at length 1; `yields` (v, j) is the change of the
        drive at which element j begins to slide, in the drive's unit.
        """
        v = np.broadcast_shapes((len(drive),), (len(yields),))[0]
        drive, yields = _spread(drive, v, *drive.shape[1:]), _spread(yields, v, yields.shape[1])
        out = np.zeros(drive.shape)
        _slide(drive, self.before, self.after, self.first, yields, out)
        return out

    def held(self, pulls: Array, friction: Array) -> tuple[Array, Array]:
        """Mean and rise (v, n, parts, tendons) of the straight line, along each part, that is nearest to the tensions at places.

        Places are the middles of equal pieces of a part. The tension at one stays what it was as long as that is between
        pull / (1 + f) and pull / (1 - f), f its `friction` (v, n, parts, places), `pulls` (v, n, tendons) those of the motors.
        """
        shape = np.broadcast_shapes(pulls.shape[:2], friction.shape[:2])
        pulls, friction = (_spread(x, *shape, *x.shape[2:]) for x in (pulls, friction))
        mean = np.repeat(pulls[:, :, None, :], friction.shape[2], axis=2)
        rise = np.zeros(mean.shape)
        _hold(pulls, friction, self.before, self.after, self.first, mean, rise)
        return mean, rise

    def extremes(self, drive: Array, covered: Array, roll: Array, rate: Array, usual_pause: float) -> Array:
        """m = max + min (v, n, DRIVES) of what each cell of the body has been through, mean over the cells of each part.

        In a cell, max(t) = max(max(t - dt) exp(-rate dt), drive(t)), from 0, and min likewise: m is 0 after equal bends to both
        sides, and the largest bend after bends to one side. `drive` (v, n, DRIVES); `covered` (v, n, CELLS) share 0..1 of
        each cell that the spine is in; `roll` (n,) rad by which the body was turned, as its cells remember in its own frame;
        `rate` (v,) 1/s; `usual_pause` s between trials whose times are not known.
        """
        out = np.zeros(drive.shape)
        pause = np.where(np.isfinite(self.stay), self.stay, usual_pause)
        _extremes(drive, covered, roll, self.after, pause + self.ramp + self.hold, rate, out)
        return out


def loading_path(design: States, rest_of: Ints) -> Path:
    """The steps of all trials in the order of the table; trial k begins at state rest_of[k]. No stiffness rows."""
    steps: list[tuple[float, ...]] = []  # as the fields of `Path`
    time = np.nan
    for k in range(len(design.trial_id)):
        previous, pressure, begins_trial = int(rest_of[k]), np.zeros(design.pressure.shape[1]), True
        for row in np.flatnonzero((design.trial == k) & ~design.stiffness).tolist():
            change = float(np.abs(design.pressure[row] - pressure).max())
            rate = float(design.rate[row])
            gap = float(design.t[row] - time)
            hold_time = float(max(design.hold[row], 0.0))
            # A table may hold rates without times or times that contradict them: the time that passed wins.
            ramp_time = change / rate if rate > 0 else 0.0
            if gap > 0:
                hold_time = min(hold_time, gap)
                ramp_time = min(ramp_time, gap - hold_time) if hold_time > 0 else gap
            stay = max(gap - ramp_time - hold_time, 0.0) if gap > 0 else np.inf if begins_trial else 0.0
            steps.append((previous, row, begins_trial, stay, ramp_time, hold_time))
            previous, pressure, time, begins_trial = row, design.pressure[row], float(design.t[row]), False
    before, after, first, *times = np.array(steps, float).reshape(-1, 6).T.copy()
    return Path(before.astype(np.int64), after.astype(np.int64), first.astype(bool), *times)


def ramps(design: States) -> Path:
    """Each of single states from its rest, which stands behind all states, by one ramp and a hold."""
    n = len(design)
    rows = np.arange(n)
    up = np.abs(design.pressure).max(axis=1) / design.rate
    return Path(rows + n, rows, np.ones(n, bool), np.full(n, np.inf), up, np.maximum(design.hold, 0.0))


@dataclass(slots=True)
class History:
    """What laws with memory see and fill."""

    quantities: Quantities
    path: Path
    drive: Array
    """(v, n, DRIVES) of the rods without memory, section frame."""
    bend_stiffness: Array
    """(v, n, 2) N m^2 of both parts."""
    axial_stiffness: Array
    """(v, n, 2) N of both parts."""
    silicone: Array
    """(v, n, DRIVES) silicone's share of each part's stiffness."""
    rest: Array
    """(v, n, DRIVES) added to rest curvatures and strains."""
    rise: Array
    """(v, n, 2, 2) its curvatures' rise along each part."""  # 1/m, x and y, about the means in `rest`; with tendons alone

    def add(self, amount: Array) -> None:
        """Add to `rest`, broadcasting over variants."""
        self.rest = self.rest + amount

    def extremes(self, rate: Array) -> Array:
        """(v, n, DRIVES) see `Path.extremes`, of this drive, fading at `rate` (v, 1) 1/s."""
        q = self.quantities
        edges = np.linspace(0.0, 1.0, CELLS + 1) * np.asarray(q.length)[..., None]
        covered = np.clip((q.spine_length[..., None] - edges[..., :-1]) / np.diff(edges), 0.0, 1.0)
        n, v = self.drive.shape[1], max(len(self.drive), len(covered), len(rate))
        drive, covered = _spread(self.drive, v, n, DRIVES), _spread(covered, v, n, CELLS)
        return self.path.extremes(drive, covered, q.design.roll, _spread(rate[:, 0], v), USUAL_PAUSE * q.scales.time)


def history_of(q: Quantities, path: Path, rods: RodColumns, driven: Array) -> History:
    """What laws with memory see of rods of n states that are driven so (v, n, DRIVES); nothing is remembered yet."""
    n = driven.shape[1]
    bend, stretch = (
        np.stack(np.broadcast_arrays(*(rods.mean(p, k) for p in (at.INNER, at.OUTER)), np.empty((1, n)))[:2], axis=-1)
        for k in (col.BEND, col.STRETCH + 2)
    )
    silicone = np.ones((len(bend), n, DRIVES))
    held = silicone_share(q, q.body.mean_area, q.body.mean_second, rods.mean(at.INNER, col.BEND))
    silicone[..., :OF_PART] = held[..., None]
    return History(q, path, driven, bend, stretch, silicone, np.zeros((1, n, DRIVES)), np.zeros((1, n, 2, 2)))


def by_element(history: History, rods: RodColumns) -> Array:
    """(v, n, columns) what a history adds to `rest_columns` of rods.

    With tendons a rest curvature is linear along a part: `rest` is its mean and `rise` its change from end to end; an element
    holds its value where the element begins, and its change over the element. Without tendons it is the same all along.
    """
    added: list[Array] = []
    walked = [np.zeros((1, 1)), np.zeros((1, 1))]  # m of the inner and of the outer part, behind the elements before
    for element, part in zip(rods.layout.elements, rods.layout.parts, strict=True):
        of_part = list(np.moveaxis(history.rest[..., OF_PART * part : OF_PART * (part + 1)], -1, 0))
        if history.quantities.robot.tendons is None:
            added += of_part
            continue
        length, start = rods.length(part), walked[part]
        walked[part] = start + rods[element + col.LENGTH]
        begins, ends = (np.where(length > 0, x / np.where(length > 0, length, 1.0), 0.0) for x in (start, walked[part]))
        rises = list(np.moveaxis(history.rise[:, :, part], -1, 0))
        added += [mean + rise * (begins - 0.5) for mean, rise in zip(of_part[:2], rises, strict=True)] + of_part[2:]
        added += [rise * (ends - begins) for rise in rises]
    return np.stack(np.broadcast_arrays(*added), axis=-1)


def drive(lengths: Sequence[Array], results: Array, places: Ints, states: int) -> Array:
    """(v, states, DRIVES) mean curvature and strain of both parts, `lengths` (v or 1, m) m, from results (v, m, columns).

    `places` (m,) says which states the rods are; the others stay 0, and so do rods without equilibrium, lest they
    spoil the states that come after them.
    """
    base, joint, tip = (results[..., k : k + 4] for k in (at.BASE, at.JOINT, at.ORIENTATION))
    out = np.zeros((max(len(results), *map(len, lengths)), states, DRIVES))
    for part, (long, start, end) in enumerate(zip(lengths, (base, joint), (joint, tip), strict=True)):
        bent = rotation_vector(multiply(start * CONJUGATE, end)) / np.maximum(long, SHORTEST)[..., None]
        out[:, places, OF_PART * part : OF_PART * part + 3] = np.where(long[..., None] > SHORTEST, bent, 0.0)
        out[:, places, OF_PART * part + 3] = np.where(long > SHORTEST, results[..., at.STRAIN + part], 0.0)
    return np.nan_to_num(out, copy=False)


def _spread(values: Array, *shape: int) -> Array:
    """A copy of this shape: a view would be another type, for which the kernels are compiled once more."""
    return np.array(np.broadcast_to(values, shape), order="C")


@kernel
def _lag(
    drive: Array, before: Ints, after: Ints, first: Mask, stay: Array, ramp: Array, hold: Array,
    time: float, out: Array,
) -> None:  # fmt: skip
    """Write drive - x (v, n, c) into `out`, x the exact solution of x' = (drive - x) / time.

    In step k the `drive` (v, n, c) stays at state before[k] for stay[k], ramps linearly to state after[k] in ramp[k], and is held
    there for hold[k] (s each; `time` too). Where first[k], a trial begins: its drive at rest may differ from that of the trial
    before, and x shifts with it, so that the lag x - drive is kept and fades.
    """
    follower, resting = np.zeros(drive.shape[2]), np.zeros(drive.shape[2])  # x, and the drive at rest of this trial
    all_kept, all_faded, all_settled = np.exp(-stay / time), np.exp(-ramp / time), np.exp(-hold / time)
    for v in range(drive.shape[0]):
        follower[:], resting[:] = 0.0, 0.0
        for k in range(before.size):
            kept, faded, settled = all_kept[k], all_faded[k], all_settled[k]
            for c in range(follower.size):
                start, end = drive[v, before[k], c], drive[v, after[k], c]
                if first[k]:
                    follower[c] += start - resting[c]
                    resting[c] = start
                x = start + (follower[c] - start) * kept
                if ramp[k] > 0.0:
                    ramp_lag = (end - start) / ramp[k] * time  # after a long ramp
                    x = end - ramp_lag + (x - start + ramp_lag) * faded
                x = end + (x - end) * settled
                follower[c] = x
                out[v, after[k], c] = end - x


@kernel
def _slide(drive: Array, before: Ints, after: Ints, first: Mask, yields: Array, out: Array) -> None:
    """Fill `out` with the mean of Jenkins elements: state += change of drive / yield, shortened to length 1 where longer."""
    elements, components = yields.shape[1], drive.shape[2]
    state = np.zeros((elements, components))
    for v in range(drive.shape[0]):
        for k in range(before.size):
            if first[k]:
                state[:] = 0.0
            for j in range(elements):
                length = 0.0
                for c in range(components):
                    state[j, c] += (drive[v, after[k], c] - drive[v, before[k], c]) / yields[v, j]
                    length += state[j, c] ** 2
                length = max(1.0, np.sqrt(length))
                for c in range(components):
                    state[j, c] /= length
                    out[v, after[k], c] += state[j, c] / elements


@kernel
def _hold(pulls: Array, friction: Array, before: Ints, after: Ints, first: Mask, means: Array, rises: Array) -> None:
    """Fill `means` and `rises` of `Path.held`: each step clips tensions to their limits, which begin as pulls at rest."""
    parts, places, tendons = friction.shape[2], friction.shape[3], pulls.shape[2]
    tensions = np.zeros((parts, places, tendons))
    # sum of the squares of 1 - places, 3 - places .. places - 1, by which least squares find a line
    squares = places * (places**2 - 1) / 3
    for v in range(pulls.shape[0]):
        for k in range(before.size):
            if first[k]:
                for i in range(tendons):  # numba compiles checks for two seconds where shapes may differ
                    tensions[:, :, i] = pulls[v, before[k], i]
            row = after[k]
            for part in range(parts):
                for i in range(tendons):
                    pull, mean, rise = pulls[v, row, i], 0.0, 0.0
                    for j in range(places):
                        tension = max(tensions[part, j, i], pull / (1.0 + friction[v, row, part, j]))
                        if friction[v, row, part, j] < 1.0:
                            tension = min(tension, pull / (1.0 - friction[v, row, part, j]))
                        tensions[part, j, i] = tension
                        mean += tension / places
                        rise += (2 * j + 1 - places) * tension
                    means[v, row, part, i] = mean
                    rises[v, row, part, i] = rise * 2 * places / squares


@kernel
def _extremes(drive: Array, covered: Array, roll: Array, after: Ints, passed: Array, rate: Array, out: Array) -> None:
    """See `Path.extremes`; `passed` (k,) s since the step before, the state `after[k]` included."""
    cells = covered.shape[2]
    top, low = np.zeros((cells, 4)), np.zeros((cells, 4))
    now, sums = np.zeros(4), np.zeros(4)
    cosine, sine, fading = np.cos(roll), np.sin(roll), np.exp(-rate[0] * passed)
    for v in range(drive.shape[0]):
        top[:], low[:] = 0.0, 0.0
        if v > 0 and rate[v] != rate[v - 1]:
            fading = np.exp(-rate[v] * passed)
        for k in range(after.size):
            row = after[k]
            kept, c, s = fading[k], cosine[row], sine[row]
            inside = 0.0  # cells that the spine is in
            for j in range(cells):
                inside += covered[v, row, j]
            for j in range(cells):
                share = covered[v, row, j]
                for i in range(4):
                    now[i] = share * drive[v, row, i] + (1.0 - share) * drive[v, row, 4 + i]
                now[0], now[1] = c * now[0] + s * now[1], c * now[1] - s * now[0]  # in the body's frame
                for i in range(4):
                    top[j, i] = max(top[j, i] * kept, now[i])
                    low[j, i] = min(low[j, i] * kept, now[i])
                    sums[i] = top[j, i] + low[j, i]
                sums[0], sums[1] = c * sums[0] - s * sums[1], c * sums[1] + s * sums[0]  # in the base frame
                for i in range(4):
                    if inside > 0.0:
                        out[v, row, i] += share / inside * sums[i]
                    if inside < cells:
                        out[v, row, 4 + i] += (1.0 - share) / (cells - inside) * sums[i]
