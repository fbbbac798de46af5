"""The one place where the forward model asks for equilibria: rows in, results and their derivatives out.

Rows and columns of results are laid out as in `layout`; the work is done by `model.rods`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from model import rods as rod
from model.arrays import Array, Ints, Mask, Order
from model.effects import layout as at
from model.rods.solution import AT_LARGEST
from model.rotation import cross, from_vector, multiply, to_base

DIVISIONS = 5.0
"""Integration steps along a whole rod: keeps one of 0.4 m within 0.01 mm up to a bend of `BEND`; in proportion beyond."""
BEND, MOST_BEND = 2.0, 20.0
"""rad; a rod that would bend further is asked for no more steps."""
METHOD = rod.Fast(divisions=DIVISIONS, close=1e-9, remember=True)
STRAIN_POINTS = 3
"""An element; strains change little along it."""
FAR = math.cos(0.5 * 0.8)
"""Cosine of half the angle (0.8 rad) by which its tip may have turned since."""
PARTS = (2, 6)
"""Stretches in which the way from a known rod to a new one is gone, where one does not do."""


@dataclass(frozen=True)
class SolvedRods:
    """Equilibria of n rows."""

    layout: at.Layout
    rows: Array
    """(n, layout.width)."""
    points: Array
    """(n, k, 3) m: x and y from the axis, and the arc length, of points fixed to sections."""
    steps: Ints
    solution: rod.Solution
    """Where a solve nearby starts."""
    result: Array
    """(n, columns); NaN where no equilibrium was found."""
    inside: bool
    """Whether the result tells of base, spine's end and strains; else these are NaN, and cost nothing."""
    arms: Array
    """(n, k, 3) m from the axis to each point, base frame."""

    @property
    def hard(self) -> bool:
        """Whether any rod has no equilibrium, or one that had to be followed to, here or nearby."""
        return bool((self.solution.status != rod.Status.SOLVED).any())

    @property
    def converged(self) -> Mask:
        """(n,) see `Solution.converged`."""
        return self.solution.converged

    def take(self, keep: slice) -> SolvedRods:
        """Some of the rows, of which no more is asked than tip and points."""
        own = {name: getattr(self, name)[keep] for name in ("rows", "points", "steps", "result", "arms")}
        return replace(self, **own, solution=self.solution.take(keep), inside=False)


BEYOND = 1e12
"""1/m, in place of the infinite curvature of a rod that no solution was found for."""


def integration_steps(layout: at.Layout, rows: Array) -> Ints:
    """(n, elements) integration steps of the elements of nominal rows.

    They stay the same while parameters change, so that results are smooth in the parameters.
    """
    rods = rods_from(layout, rows, plain=True)
    return _steps(rods, rod.solve(rods, rod.Fast(follow=False)).values[:, AT_LARGEST])


def _steps(rods: rod.Rods, moment: Array) -> Ints:
    """(n, elements) steps that rods under these largest moments (n,) N m need; NaN counts as a moment that bends little."""
    length = rods.field("length")
    share = length / length.sum(axis=1, keepdims=True)
    curvature = moment[:, None, None] / rods.field("bend_stiffness")[..., :2] + np.abs(rods.field("rest_curvature")[..., :2])
    finite = np.nan_to_num(curvature.max(axis=2), posinf=BEYOND)
    bend = (finite * length).sum(axis=1, keepdims=True)
    return np.maximum(1, np.ceil(DIVISIONS * share * np.clip(bend / BEND, 1.0, MOST_BEND / BEND) - 1e-6)).astype(np.int64)


def solve(
    layout: at.Layout,
    rows: Array,
    points: Array,
    steps: Ints | None,
    start: SolvedRods | None = None,
    inside: bool = True,
    trial: bool = False,
    plain: bool = False,
    whole: bool = False,
    followed: SolvedRods | None = None,
) -> SolvedRods:
    """Find the equilibria of rows (n, layout.width), with positions of `points` (n, k, 3) and, `inside`, turns and strains.

    From `start`, solved rows nearby, a `trial` gives up rods whose load would have to be followed from zero, `whole` all that
    remain once one has no equilibrium; `followed` are rows whose load was followed, from which others may be reached. `plain`: no
    other solve starts from these, so that springs that none of them has are left out, which take half of the time. Without
    `steps` each rod gets those that its own bend needs.
    """
    rods = rods_from(layout, rows, plain)
    if start is not None and steps is not None:
        solution = _solve_from(rods, rows, steps, start, trial, whole, followed)
    else:
        solution, steps = _solve_anew(rods, replace(METHOD, remember=not plain), steps)
    result = np.full((len(rows), at.MARKERS + 3 * points.shape[1]), np.nan)
    result[:, at.TIP : at.TIP + 3] = solution.tip
    result[:, at.ORIENTATION : at.ORIENTATION + 4] = solution.orientation
    solved = SolvedRods(layout, rows, points, steps, solution, result, False, np.zeros(points.shape))
    if inside or points.size:
        _fill_stations(solved, rods, inside)
    return replace(solved, inside=inside)


def look_inside(solved: SolvedRods) -> SolvedRods:
    """The same, with what is within the rods."""
    seen = replace(solved, result=solved.result.copy(), inside=True)
    _fill_stations(seen, rods_from(seen.layout, seen.rows), True)
    return seen


def _fill_stations(solved: SolvedRods, rods: rod.Rods, inside: bool) -> None:
    """Fill, in one pass, the results of points and, `inside`, those of base and spine's end and the parts' mean strains."""
    layout, result = solved.layout, solved.result
    places = _places(layout, rods, solved.points[..., 2], inside)
    own = slice(places.shape[1] - solved.points.shape[1], places.shape[1])
    if inside:
        gauss_points, weights = rod.gauss_points(rods, STRAIN_POINTS)
        places = np.concatenate([places, gauss_points], axis=1)
    at_stations = rod.stations(rods, solved.solution, places, replace(METHOD, steps=solved.steps))
    if (beside := solved.points * [1.0, 1.0, 0.0]).any():
        solved.arms[:] = to_base(at_stations.orientation[:, own], beside)
    result[:, at.MARKERS :] = (at_stations.position[:, own] + solved.arms).reshape(len(result), 3 * solved.points.shape[1])
    if inside:
        result[:, at.BASE : at.BASE + 4] = at_stations.orientation[:, 0]
        result[:, at.JOINT : at.JOINT + 4] = at_stations.orientation[:, 1]
        strain = at_stations.strain[:, own.stop :].reshape(len(result), layout.form.elements, STRAIN_POINTS)
        shares = _shares(layout, rods)
        result[:, at.STRAIN : at.STRAIN + 2] = np.einsum("nep,p,nqe->nq", strain, weights, shares)


def _solve_anew(rods: rod.Rods, method: rod.Fast, steps: Ints | None) -> tuple[rod.Solution, Ints]:
    """Solve from nothing. Without `steps`, with few at first, and once more what bends so far that it needs others."""
    if steps is not None:
        return rod.solve(rods, replace(method, steps=steps)), steps
    few = _steps(rods, np.full(len(rods), np.nan))
    solution = rod.solve(rods, replace(method, steps=few, follow=False))
    steps = _steps(rods, solution.values[:, AT_LARGEST])
    again = np.union1d(_unsolved(solution), np.flatnonzero((steps != few).any(axis=1)))
    if again.size:
        _put(solution, again, rod.solve(rods[again], replace(method, steps=steps[again])))
    return solution, steps


def _solve_from(
    rods: rod.Rods, rows: Array, steps: Ints, start: SolvedRods, trial: bool, whole: bool, followed: SolvedRods | None
) -> rod.Solution:
    """Solve from `start`; what fails from `followed`, else anew, else through rods between, else as loads grow from zero."""
    solution = _nearby(rods, steps, start.solution)
    unsolved = _unsolved(solution)
    if unsolved.size and followed is not None:
        attempt = _nearby(rods[unsolved], steps[unsolved], followed.solution.take(unsolved))
        attempt.status[attempt.status == rod.Status.SOLVED] = rod.Status.SOLVED_IN_STEPS
        unsolved = _put(solution, unsolved, attempt)
    if unsolved.size:
        unsolved = _put(solution, unsolved, rod.solve(rods[unsolved], replace(METHOD, steps=steps[unsolved], follow=False)))
    for parts in PARTS:
        if not unsolved.size:
            break
        attempt = start.solution.take(unsolved)
        for k in range(1, parts + 1):
            between = start.rows[unsolved] + k / parts * (rows[unsolved] - start.rows[unsolved])
            attempt = _nearby(rods_from(start.layout, between), steps[unsolved], attempt)
        unsolved = _put(solution, unsolved, attempt)
    if whole:
        unsolved = _all_or_none(solution, rods, steps, unsolved, start, followed)
    elif unsolved.size and not trial:
        _put(solution, unsolved, rod.solve(rods[unsolved], replace(METHOD, steps=steps[unsolved])))
        unsolved = unsolved[:0]
    # Not trusted, so not to be read either: a step would be taken there that the next solve takes back.
    solution.values[unsolved] = np.nan
    return solution


def _all_or_none(
    found: rod.Solution, rods: rod.Rods, steps: Ints, unsolved: Order, start: SolvedRods, followed: SolvedRods | None
) -> Order:
    """Follow the loads of rods until one has no equilibrium that had one at the start; returns those that are then not solved."""
    # what had none the last time comes first
    for i in unsolved if followed is None else unsolved[np.argsort(followed.converged[unsolved], kind="stable")]:
        if start.converged[i]:
            rod_alone = np.array([i])
            if _put(found, rod_alone, rod.solve(rods[rod_alone], replace(METHOD, steps=steps[rod_alone]))).size:
                break
            unsolved = unsolved[unsolved != i]
    return unsolved


def _nearby(rods: rod.Rods, steps: Ints, start: rod.Solution) -> rod.Solution:
    """Solve from solutions close by; FAILED where one is not to be trusted, or the tip turned so far that it may have snapped."""
    # closer to buckling, not even a solution that began at a trusted one close by is trusted
    solution = rod.solve(rods, replace(METHOD, steps=steps, least_margin=0.02, follow=False), start=start)
    turned = ~(np.abs(np.sum(solution.orientation * start.orientation, axis=1)) >= FAR)
    solution.status[turned] = rod.Status.FAILED
    return solution


def _unsolved(found: rod.Solution) -> Order:
    """Rods without a solution."""
    return np.flatnonzero(found.status > rod.Status.SOLVED_IN_STEPS)


def _put(into: rod.Solution, rows: Order, found: rod.Solution) -> Order:
    """Take over what was found of some rods; which of them are still open."""
    into.values[rows], into.status[rows] = found.values, found.status
    if len(found.memory):
        into.memory[rows] = found.memory
    return rows[_unsolved(found)]


def differentiate(solved: SolvedRods, directions: Array) -> Array:
    """(n, a, motions) derivatives of the results along `directions` (a, layout.width) of the rows.

    Motions are the shift and the turn (rad) of the tip, the shift of each point and, inside, the turns of base and spine's end
    and the strains, in this order.
    """
    rods = rods_from(solved.layout, solved.rows)
    own = int(solved.inside)
    places = _places(solved.layout, rods, solved.points[..., 2], solved.inside)[:, own:]
    method = replace(METHOD, steps=solved.steps)
    d = rod.sensitivities(rods, solved.solution, directions[None], method, arc_lengths=places, strain=solved.inside, attached=own)
    marked = d.position[:, :, own:]
    if solved.arms.any():
        marked = marked + cross(d.turn[:, :, own:], solved.arms[:, None])
    within = (d.base_rotation, d.turn[:, :, 0], d.strain @ _shares(solved.layout, rods).swapaxes(1, 2)) if solved.inside else ()
    return np.concatenate([d.tip, d.rotation, marked.reshape(*marked.shape[:2], 3 * marked.shape[2]), *within], axis=-1)


def nudged(solved: SolvedRods, step: float) -> Array:
    """(1 + motions, n, columns) the results, and the same a step along each motion of `differentiate`."""
    motions: list[tuple[int, int | None]] = [(at.TIP + k, None) for k in range(3)]
    motions += [(at.ORIENTATION, k) for k in range(3)] + [(k, None) for k in range(at.MARKERS, solved.result.shape[1])]
    if solved.inside:
        motions += [(column, k) for column in (at.BASE, at.JOINT) for k in range(3)]
        motions += [(at.STRAIN, None), (at.STRAIN + 1, None)]
    out = np.repeat(solved.result[None], 1 + len(motions), axis=0)
    for variant, (column, axis) in zip(out[1:], motions, strict=True):
        if axis is None:
            variant[:, column] += step
        else:
            turn = from_vector(step * np.eye(3)[axis])
            variant[:, column : column + 4] = multiply(turn, variant[:, column : column + 4])
    return out


def rods_from(layout: at.Layout, rows: Array, plain: bool = False) -> rod.Rods:
    """Rods from rows (n, layout.width), with all their springs; `plain`: without, where no row has one."""
    sprung = not plain or layout.form.view(rows, "spring_stiffness").any()
    form = layout.form if sprung else rod.Form(layout.form.elements)
    rods = rod.Rods(form, np.array(rows, order="C") if sprung else np.delete(rows, slice(at.SPRINGS, at.ELEMENTS), axis=1))
    rods.field("rest_strain")[..., 2] += 1.0
    return rods


def _shares(layout: at.Layout, rods: rod.Rods) -> Array:
    """(n, 2, elements) of the length of the inner and of the outer part; of an empty part its first element."""
    length = rods.field("length")
    out = np.zeros((len(rods), 2, layout.form.elements))
    for part, own in enumerate(layout.of_part):
        whole = length[:, own].sum(axis=1)
        out[:, part, own[0]] = whole == 0
        out[:, part, own] += length[:, own] / np.where(whole > 0, whole, 1.0)[:, None]
    return out


def _places(layout: at.Layout, rods: rod.Rods, arcs: Array, inside: bool) -> Array:
    """(n, k or 2 + k) m: of what is inside the base and the spine's end, then `arcs` (n, k), no farther than the tip."""
    inner = rods.field("length")[:, layout.of_part[at.INNER]].sum(axis=1, keepdims=True)
    given = np.minimum(arcs, rods.whole_length[:, None])
    return np.concatenate([np.zeros_like(inner), inner, given], axis=1) if inside else given
