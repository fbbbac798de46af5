"""Equilibria of rods by shooting from the tip, with base compliance, springs at the tip and hyperelastic sections.

Unknowns of a rod: the rotation of its tip and, where springs hold it, the tip's position. A pass integrates from the
tip to the base (Runge-Kutta of order six) in the section frame:
    q' = q (0, u) / 2,  m' = -u x m - v x n,  r' = -u x r - v  (r: from here to the tip),  n = R(q)^T N
with N in the base frame known without integration. u = m / (D K_bt) + u*, v = n / K_se + v* + e3; a hyperelastic
section has D = 1 + a k^2 + b e and n3 = EA (e + c e^2) + b EI k^2 / 2, k and e elastic. Sensitivities follow from the
implicit function theorem at the solution, the partial derivatives by central differences of one pass.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

STAGES = 7
NODES = np.array([0.0, 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2, 1.0])
TABLEAU = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 3, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 2 / 3, 0.0, 0.0, 0.0, 0.0],
        [1 / 12, 1 / 3, -1 / 12, 0.0, 0.0, 0.0],
        [-1 / 16, 9 / 8, -3 / 16, -3 / 8, 0.0, 0.0],
        [0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2, 0.0],
        [9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11],
    ]
)
WEIGHTS = np.array([11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120])
"""Butcher's explicit method of order six, J. Austral. Math. Soc. 4 (1964)."""
NUDGE = 1e-6
"""rad and m, central differences of the unknowns."""
CLOSE = 1e-10
"""rad and m, miss of a solved rod."""
ROUNDS = 40
SLOW = 0.5
"""A miss that shrinks by less than this in a round asks for a new Jacobian."""
SERIES_ROUNDS = 12
LONGEST = 0.6
"""rad (and a fifth of it in m), a Newton step is shortened to this."""
LEAST_DETERMINANT = 1e-3
"""Of the Jacobian of the misses, 1 without dead loads: less is at or beyond a point of buckling."""
FAR = math.cos(0.5 * 0.8)
"""Cosine of half the angle (0.8 rad) from the start of a solve that is still taken without question."""
MOST_PARTS = 16
"""Load steps from zero, when nothing else works."""


@numba.njit(cache=True, error_model="numpy")
def _product(a: Array, b: Array, out: Array) -> None:
    """Quaternion a b."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3]
    z = a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1]
    out[0], out[1], out[2], out[3] = w, x, y, z


@numba.njit(cache=True, error_model="numpy")
def _turned(q: Array, a0: float, a1: float, a2: float, sign: float) -> tuple[float, float, float]:
    """R(q) a, or R(q)^T a with sign -1."""
    b, c, d = sign * q[1], sign * q[2], sign * q[3]
    t0, t1, t2 = 2 * (c * a2 - d * a1), 2 * (d * a0 - b * a2), 2 * (b * a1 - c * a0)
    return (
        a0 + q[0] * t0 + c * t2 - d * t1,
        a1 + q[0] * t1 + d * t0 - b * t2,
        a2 + q[0] * t2 + b * t1 - c * t0,
    )


@numba.njit(cache=True, error_model="numpy")
def _slope(y: Array, force: Array, row: Array, e: int, x: float, out: Array) -> float:
    """d(q, m, r) / d(distance towards the base) into `out`; returns the axial strain."""
    n0, n1, n2 = _turned(y, force[0], force[1], force[2], -1.0)
    m0, m1, m2 = y[4], y[5], y[6]
    k0, k1 = m0 / row[e + 1], m1 / row[e + 2]
    strain = n2 / row[e + 6]
    a, b, c = row[e + 16], row[e + 17], row[e + 18]
    if a != 0.0 or b != 0.0 or c != 0.0:
        pull, bend = strain, k0 * k0 + k1 * k1
        coupled = 0.25 * b * (row[e + 1] + row[e + 2]) * bend / row[e + 6]
        d = 1.0
        for _ in range(SERIES_ROUNDS):
            # Newton on d - 1 - a bend / d^2 - b e = 0 and e + c e^2 + coupled / d^2 - pull = 0.
            w = 1.0 / (d * d)
            first = d - 1.0 - a * bend * w - b * strain
            second = strain + c * strain * strain + coupled * w - pull
            by_d, mixed, by_e = 1.0 + 2.0 * a * bend * w / d, -2.0 * coupled * w / d, 1.0 + 2.0 * c * strain
            scale = 1.0 / (by_d * by_e + b * mixed)
            d -= scale * (by_e * first + b * second)
            strain -= scale * (by_d * second - mixed * first)
            if abs(first) + abs(second) < 1e-9:
                break
        k0, k1 = k0 / d, k1 / d
    x2 = x * x
    x3 = x2 * x
    u0 = k0 + row[e + 7] + x * row[e + 19] + x2 * row[e + 22] + x3 * row[e + 25]
    u1 = k1 + row[e + 8] + x * row[e + 20] + x2 * row[e + 23] + x3 * row[e + 26]
    u2 = m2 / row[e + 3] + row[e + 9] + x * row[e + 21] + x2 * row[e + 24] + x3 * row[e + 27]
    v0, v1 = n0 / row[e + 4] + row[e + 10], n1 / row[e + 5] + row[e + 11]
    v2 = 1.0 + strain + row[e + 12]
    out[0] = 0.5 * (y[1] * u0 + y[2] * u1 + y[3] * u2)
    out[1] = -0.5 * (y[0] * u0 + y[2] * u2 - y[3] * u1)
    out[2] = -0.5 * (y[0] * u1 + y[3] * u0 - y[1] * u2)
    out[3] = -0.5 * (y[0] * u2 + y[1] * u1 - y[2] * u0)
    out[4] = u1 * m2 - u2 * m1 + v1 * n2 - v2 * n1
    out[5] = u2 * m0 - u0 * m2 + v2 * n0 - v0 * n2
    out[6] = u0 * m1 - u1 * m0 + v0 * n1 - v1 * n0
    out[7] = u1 * y[9] - u2 * y[8] + v0
    out[8] = u2 * y[7] - u0 * y[9] + v1
    out[9] = u0 * y[8] - u1 * y[7] + v2
    return strain + row[e + 12]


@numba.njit(cache=True, error_model="numpy")
def _step(y: Array, force: Array, row: Array, e: int, left: float, h: float, work: Array) -> float:
    """Advance y by h towards the base from the distance `left` above the element's base end; returns axial strain."""
    whole = row[e]
    f, z, k = work[0], work[1], work[2:9]
    strain = _slope(y, force, row, e, left / whole, k[0])
    for stage in range(1, STAGES):
        share = NODES[stage] * h
        for i in range(3):
            f[i] = force[i] + share * row[e + 13 + i]
        for i in range(10):
            total = 0.0
            for j in range(stage):
                total += TABLEAU[stage, j] * k[j, i]
            z[i] = y[i] + h * total
        _slope(z, f, row, e, (left - share) / whole, k[stage])
    for i in range(10):
        total = 0.0
        for j in range(STAGES):
            total += WEIGHTS[j] * k[j, i]
        y[i] += h * total
    size = 1.0 / math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3])
    for i in range(4):
        y[i] *= size
    for i in range(3):
        force[i] += h * row[e + 13 + i]
    return strain


@numba.njit(cache=True, error_model="numpy")
def _pass(
    row: Array, share: float, q: Array, held: Array, arcs: Array, counts: Counts, work: Array, out: Array
) -> None:
    """One pass under a share of the loads: result columns into `out`, the six misses behind them."""
    y, force, side, spare = work[9], work[10], work[11], work[12]
    inner_work = work[0:9]
    f0, f1, f2 = _turned(q, share * row[0], share * row[1], share * row[2], 1.0)
    force[0], force[1], force[2] = f0 + share * row[6], f1 + share * row[7], f2 + share * row[8]
    for j in range(at.SPRING_COUNT):
        o = at.SPRINGS + j * at.SPRING_WIDTH
        if row[o + 3] != 0.0:
            stretch = row[o] * held[0] + row[o + 1] * held[1] + row[o + 2] * held[2] - row[o + 4]
            soft = row[o + 5]
            if soft > 0.0:
                stretch = 0.5 * (stretch + math.sqrt(stretch * stretch + soft * soft))
            for i in range(3):
                force[i] -= share * row[o + 3] * stretch * row[o + i]
    for i in range(4):
        y[i] = q[i]
        out[at.ORIENTATION + i] = q[i]
    for i in range(3):
        y[4 + i] = share * row[at.TIP_MOMENT + i]
        y[7 + i] = 0.0
    g0, g1, g2 = _turned(q, y[4], y[5], y[6], 1.0)
    top = row[at.ELEMENTS] + row[at.ELEMENTS + at.ELEMENT_WIDTH]
    for element in range(at.ELEMENT_COUNT - 1, -1, -1):
        e = at.ELEMENTS + element * at.ELEMENT_WIDTH
        whole = row[e]
        bottom = top - whole
        steps = counts[element]
        total = 0.0
        if whole > 0.0:
            h = whole / steps
            for i in range(steps):
                left = whole - i * h
                for a in range(arcs.size):
                    below = bottom + left - arcs[a]
                    lowest = i == steps - 1 and element == 0
                    if 0.0 <= below < h or (lowest and below >= h) or (below < 0.0 and i == 0 and element == 1):
                        for c in range(10):
                            side[c] = y[c]
                        for c in range(3):
                            spare[c] = force[c]
                        _step(side, spare, row, e, left, min(max(below, 0.0), h), inner_work)
                        p0, p1, p2 = _turned(side, side[7], side[8], side[9], 1.0)
                        o = at.MARKERS + 3 * a
                        out[o], out[o + 1], out[o + 2] = -p0, -p1, -p2
                total += _step(y, force, row, e, left, h, inner_work)
        out[at.STRAIN + element] = total / steps
        if element == 1:
            for i in range(4):
                out[at.JOINT + i] = y[i]
        top = bottom
    p0, p1, p2 = _turned(y, y[7], y[8], y[9], 1.0)
    out[0], out[1], out[2] = p0, p1, p2
    for a in range(arcs.size):
        o = at.MARKERS + 3 * a
        out[o] += p0
        out[o + 1] += p1
        out[o + 2] += p2
    m0, m1, m2 = _turned(y, y[4], y[5], y[6], 1.0)
    relief = row[at.BASE_RELIEF]
    if relief != 0.0:
        m0 -= relief * (g0 + p1 * f2 - p2 * f1)
        m1 -= relief * (g1 + p2 * f0 - p0 * f2)
        m2 -= relief * (g2 + p0 * f1 - p1 * f0)
    # The base misses its pose by the rotation from where it should be; small, so the order of turns does not matter.
    b0 = row[at.BASE_TURN] + row[at.BASE_COMPLIANCE] * m0
    b1 = row[at.BASE_TURN + 1] + row[at.BASE_COMPLIANCE + 1] * m1
    b2 = row[at.BASE_TURN + 2] + row[at.BASE_COMPLIANCE + 2] * m2
    angle = math.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
    half = 0.5 - angle * angle / 48.0 if angle < 1e-3 else math.sin(0.5 * angle) / angle
    spare[0], spare[1], spare[2], spare[3] = math.cos(0.5 * angle), -half * b0, -half * b1, -half * b2
    _product(y[:4], spare[:4], side[:4])
    for i in range(4):
        out[at.BASE + i] = y[i]
    miss = out.size - 6
    scale = math.copysign(4.0 / (1.0 + abs(side[0])), side[0])
    for i in range(3):
        out[miss + i] = scale * side[1 + i]
        out[miss + 3 + i] = held[i] - out[i]


@numba.njit(cache=True, error_model="numpy")
def _turn(q: Array, x: Array, work: Array, out: Array) -> None:
    """q turned by the rotation vector x (base frame) into `out`."""
    angle = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    half = 0.5 - angle * angle / 48.0 if angle < 1e-3 else math.sin(0.5 * angle) / angle
    work[0], work[1], work[2], work[3] = math.cos(0.5 * angle), half * x[0], half * x[1], half * x[2]
    _product(work[:4], q, out)
    size = 1.0 / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    for i in range(4):
        out[i] *= size


@numba.njit(cache=True, error_model="numpy")
def _by_unknowns(
    row: Array,
    share: float,
    q: Array,
    held: Array,
    arcs: Array,
    counts: Counts,
    work: Array,
    here: Array,
    slopes: Array,
    central: bool,
) -> None:
    """Derivatives of a pass by the six unknowns, (6, columns), into `slopes`; `here` is the pass itself."""
    sprung = False
    for j in range(at.SPRING_COUNT):
        sprung = sprung or row[at.SPRINGS + j * at.SPRING_WIDTH + 3] != 0.0
    wide = slopes.shape[1]
    x, near, moved, out = np.zeros(3), np.zeros(4), np.zeros(3), np.empty(wide)
    for k in range(6):
        if k >= 3 and not sprung:
            slopes[k] = 0.0
            slopes[k, wide - 6 + k] = 1.0
            continue
        for sign in (1.0, -1.0):
            x[:] = 0.0
            moved[:] = held
            if k < 3:
                x[k] = sign * NUDGE
            else:
                moved[k - 3] += sign * NUDGE
            _turn(q, x, work[12], near)
            _pass(row, share, near, moved, arcs, counts, work, out)
            if not central:
                for c in range(wide):
                    slopes[k, c] = (out[c] - here[c]) / NUDGE
                break
            for c in range(wide):
                slopes[k, c] = out[c] if sign > 0 else (slopes[k, c] - out[c]) / (2.0 * NUDGE)


@numba.njit(cache=True, error_model="numpy")
def _newton(
    row: Array,
    share: float,
    q: Array,
    held: Array,
    jacobian: Array,
    known: bool,
    counts: Counts,
    work: Array,
    out: Array,
) -> bool:
    """Move the unknowns q and held to equilibrium, by Newton with Broyden's updates; True when they got there.

    `jacobian` (6, 6) of the misses is where it begins when `known`, and what was reached.
    """
    none = np.empty(0)
    last, fresh = np.inf, known
    turned, before, change, slopes = np.empty(4), np.empty(6), np.zeros(6), np.empty((6, at.MARKERS + 6))
    miss = out[at.MARKERS :]
    for i in range(ROUNDS):
        _pass(row, share, q, held, none, counts, work, out)
        size = np.sqrt(np.sum(miss**2))
        if not size < np.inf:
            return False
        if size < CLOSE or (size < 1e-8 and size >= 0.5 * last):
            return True
        if not fresh or size > SLOW * last:
            _by_unknowns(row, share, q, held, none, counts, work, out, slopes, False)
            for j in range(6):
                for k in range(6):
                    jacobian[j, k] = slopes[k, at.MARKERS + j]
            fresh = True
        elif i > 0:
            # The rank-one change that makes the Jacobian agree with the step just made.
            gained = (miss - before - jacobian @ change) / np.sum(change**2)
            for j in range(6):
                for k in range(6):
                    jacobian[j, k] += gained[j] * change[k]
        last = size
        # One eigenvalue through zero is a point of snapping or buckling; what lies beyond is another branch.
        if not np.linalg.det(jacobian) > LEAST_DETERMINANT:
            return False
        before[:] = miss
        change[:] = -np.linalg.solve(jacobian, miss)
        longest = max(np.abs(change[:3]).max(), 5.0 * np.abs(change[3:]).max())
        if longest > LONGEST:
            change *= LONGEST / longest
        _turn(q, change[:3], work[12], turned)
        q[:] = turned
        held += change[3:]
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def solve_rows(
    rows: Array, arcs: Array, steps: Counts, start: Array, warm: bool, out: Array, unknowns: Array
) -> NDArray[np.bool_]:
    """Solve every row; returns which were solved.

    `start` (n, 43) holds quaternion and position of the tip and the Jacobian of the misses there; it is used when
    `warm`. `unknowns` gets the same for the solution.
    """
    n = rows.shape[0]
    solved = np.zeros(n, np.bool_)
    work, short = np.zeros((13, 10)), np.empty(at.MARKERS + 6)
    q, held, jacobian = np.zeros(4), np.zeros(3), np.zeros((6, 6))
    for r in range(n):
        row, counts = rows[r], steps[r]
        if warm:
            q[:] = start[r, :4]
            held[:] = start[r, 4:7]
            jacobian[:] = start[r, 7:].reshape(6, 6)
            solved[r] = _newton(row, 1.0, q, held, jacobian, True, counts, work, short)
            near = 0.0
            for i in range(4):
                near += q[i] * start[r, i]
            # A tip that turned far from where it started may have snapped: follow it from zero load instead.
            solved[r] = solved[r] and abs(near) > FAR
        parts = 4 if warm else 1
        while not solved[r] and parts <= MOST_PARTS:
            q[:] = 0.0
            q[0] = 1.0
            held[:] = 0.0
            held[2] = row[at.ELEMENTS] + row[at.ELEMENTS + at.ELEMENT_WIDTH]
            solved[r] = True
            for i in range(1, parts + 1):
                if not _newton(row, i / parts, q, held, jacobian, i > 1, counts, work, short):
                    solved[r] = False
                    break
            parts *= 4
        unknowns[r, :4] = q
        unknowns[r, 4:7] = held
        unknowns[r, 7:] = jacobian.ravel()
        if solved[r]:
            _pass(row, 1.0, q, held, arcs, counts, work, out[r])
        else:
            out[r] = np.nan
    return solved


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sensitivities(
    rows: Array, arcs: Array, steps: Counts, out: Array, unknowns: Array, directions: Array, step: float, result: Array
) -> None:
    """d(out) / d(direction) of solved rows: `directions` (p, n, WIDTH) -> `result` (p, n, columns without the miss)."""
    p, n, _ = directions.shape
    wide = out.shape[1]
    work, row, near = np.zeros((13, 10)), np.empty(rows.shape[1]), np.empty(wide)
    slopes, change = np.empty((6, wide)), np.empty(6)
    for r in range(n):
        if not np.isfinite(out[r, 0]):
            result[:, r] = np.nan
            continue
        counts, q, held = steps[r], unknowns[r, :4], unknowns[r, 4:7]
        _by_unknowns(rows[r], 1.0, q, held, arcs, counts, work, out[r], slopes, True)
        inverse = np.linalg.inv(np.ascontiguousarray(slopes[:, wide - 6 :].T))
        for k in range(p):
            moves = False
            for c in range(row.size):
                along = directions[k, r, c]
                row[c] = rows[r, c] + step * along
                moves = moves or along != 0.0
            if not moves:
                result[k, r] = 0.0
                continue
            _pass(row, 1.0, q, held, arcs, counts, work, near)
            for c in range(wide):
                near[c] = (near[c] - out[r, c]) / step
            for i in range(6):
                total = 0.0
                for c in range(6):
                    total -= inverse[i, c] * near[wide - 6 + c]
                change[i] = total
            for c in range(wide - 6):
                total = near[c]
                for i in range(6):
                    total += slopes[i, c] * change[i]
                result[k, r, c] = total
