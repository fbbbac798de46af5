"""One pass along a rod, from the tip to the base, in the section frame.

    q' = q (0, u) / 2,  m' = -u x m - v x n,  r' = -u x r - v  (r: from here to the tip),  n = R(q)^T N
with N in the base frame known without integration. u = m / (D K_bt) + u*, v = n / K_se + v* + e3; a hyperelastic
section has D = 1 + g(a k^2) + b e and n3 = EA (e + c e^2) + b EI k^2 / 2, k and e elastic; g(x) = x, but x / (1 - 2 x)
where x < 0, so that a section which softens never carries less moment the more it is bent.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.effects.shooting import layout as at
from model.statics.jit import routine

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
SERIES_ROUNDS = 12


@routine
def product(a: Array, b: Array, out: Array) -> None:
    """Quaternion a b."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3]
    z = a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1]
    out[0], out[1], out[2], out[3] = w, x, y, z


@routine
def turned(q: Array, a0: float, a1: float, a2: float, sign: float) -> tuple[float, float, float]:
    """R(q) a, or R(q)^T a with sign -1."""
    b, c, d = sign * q[1], sign * q[2], sign * q[3]
    t0, t1, t2 = 2 * (c * a2 - d * a1), 2 * (d * a0 - b * a2), 2 * (b * a1 - c * a0)
    return (
        a0 + q[0] * t0 + c * t2 - d * t1,
        a1 + q[0] * t1 + d * t0 - b * t2,
        a2 + q[0] * t2 + b * t1 - c * t0,
    )


@routine
def slope_at(y: Array, force: Array, row: Array, e: int, x: float, out: Array) -> float:
    """d(q, m, r) / d(distance towards the base) into `out`; returns the axial strain."""
    n0, n1, n2 = turned(y, force[0], force[1], force[2], -1.0)
    m0, m1, m2 = y[4], y[5], y[6]
    k0, k1 = m0 / row[e + 1], m1 / row[e + 2]
    strain = n2 / row[e + 6]
    a, b, c = row[e + 16], row[e + 17], row[e + 18]
    if a != 0.0 or b != 0.0 or c != 0.0:
        pull, bend = strain, k0 * k0 + k1 * k1
        coupled = 0.25 * b * (row[e + 1] + row[e + 2]) * bend / row[e + 6]
        d = 1.0
        for _ in range(SERIES_ROUNDS):
            # Newton on d - 1 - g(a bend / d^2) - b e = 0 and e + c e^2 + coupled / d^2 - pull = 0.
            w = 1.0 / (d * d)
            level = a * bend * w
            levelled = 1.0 / (1.0 - 2.0 * min(level, 0.0))
            first = d - 1.0 - level * levelled - b * strain
            second = strain + c * strain * strain + coupled * w - pull
            by_d = 1.0 + 2.0 * level * levelled * levelled / d
            mixed, by_e = -2.0 * coupled * w / d, 1.0 + 2.0 * c * strain
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


@routine
def advance(y: Array, force: Array, row: Array, e: int, left: float, h: float, work: Array) -> float:
    """Advance y by h towards the base from the distance `left` above the element's base end; returns axial strain."""
    whole = row[e]
    f, z, k = work[0], work[1], work[2:9]
    strain = slope_at(y, force, row, e, left / whole, k[0])
    for stage in range(1, STAGES):
        share = NODES[stage] * h
        for i in range(3):
            f[i] = force[i] + share * row[e + 13 + i]
        for i in range(10):
            total = 0.0
            for j in range(stage):
                total += TABLEAU[stage, j] * k[j, i]
            z[i] = y[i] + h * total
        slope_at(z, f, row, e, (left - share) / whole, k[stage])
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


@routine
def shoot(
    row: Array, share: float, q: Array, held: Array, arcs: Array, counts: Counts, work: Array, out: Array
) -> None:
    """One pass under a share of the loads: result columns into `out`, the six misses behind them."""
    y, force, side, spare = work[9], work[10], work[11], work[12]
    inner_work = work[0:9]
    f0, f1, f2 = turned(q, share * row[0], share * row[1], share * row[2], 1.0)
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
    g0, g1, g2 = turned(q, y[4], y[5], y[6], 1.0)
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
                        advance(side, spare, row, e, left, min(max(below, 0.0), h), inner_work)
                        p0, p1, p2 = turned(side, side[7], side[8], side[9], 1.0)
                        o = at.MARKERS + 3 * a
                        out[o], out[o + 1], out[o + 2] = -p0, -p1, -p2
                total += advance(y, force, row, e, left, h, inner_work)
        out[at.STRAIN + element] = total / steps
        if element == 1:
            for i in range(4):
                out[at.JOINT + i] = y[i]
        top = bottom
    p0, p1, p2 = turned(y, y[7], y[8], y[9], 1.0)
    out[0], out[1], out[2] = p0, p1, p2
    for a in range(arcs.size):
        o = at.MARKERS + 3 * a
        out[o] += p0
        out[o + 1] += p1
        out[o + 2] += p2
    m0, m1, m2 = turned(y, y[4], y[5], y[6], 1.0)
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
    product(y[:4], spare[:4], side[:4])
    for i in range(4):
        out[at.BASE + i] = y[i]
    miss = out.size - 6
    scale = math.copysign(4.0 / (1.0 + abs(side[0])), side[0])
    for i in range(3):
        out[miss + i] = scale * side[1 + i]
        out[miss + 3 + i] = held[i] - out[i]
