"""Equilibrium of a chain: the out-of-balance forces of its nodes, and Newton's method.

A segment's stress gives a world force n and moment m at the mean point of its arc, which lies o = -h^2/12 R (curvature
x e3) beside the middle of the chord d. Each node is in balance under its segments and its loads:

    F_i = f_i + n_i - n_(i-1)
    M_i = l_i + m_i - m_(i-1) + (d_i/2 + o_i) x n_i + (d_(i-1)/2 - o_(i-1)) x n_(i-1)

Newton's matrix is block-tridiagonal (blocks of 6). The derivative of o is left out: it is small, no iteration more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .blocks import add_skew, cross_matrix, kernel, matrix_cross, rotation, solve_chain, turn
from .chain import Chain, ChainLoads, relative_rotation, segment_strain
from .material import Sections, SliderHistory, respond

Array = NDArray[np.float64]


@kernel
def contact_force(depth: float, soft_depth: float, soft: float, stiff: float) -> tuple[float, float]:
    """Force (N) and stiffness (N/m) at a depth (m): nothing, a soft layer, then stiff with a start rounded over 1 um."""
    if depth <= 0.0:
        return 0.0, 0.0
    force = soft * depth if soft_depth > 0.0 else 0.0
    slope = soft if soft_depth > 0.0 else 0.0
    g = depth - soft_depth
    width = 1e-7
    if g > 0.0:
        if g < width:
            return force + stiff * g * g / (2 * width), slope + stiff * g / width
        return force + stiff * (g - width / 2), slope + stiff
    return force, slope


@kernel
def _balance(
    chain: Chain, s: Sections, hist: SliderHistory, loads: ChainLoads, low: Array, diag: Array, up: Array, g: Array
) -> None:
    """Fill the out-of-balance forces g (sign: to be solved for) and Newton's matrix.

    Of each segment, in the world: `nw`, `mw` its force and moment; `knn` = dn/dd, `kmm` = dm/d(turn of one end against the
    other), `p` = dn/d(turn of either end), `w` the same of m; `tr` and `tp` are the derivatives of d/2 x n like `knn` and `p`.
    """
    n = chain.h.shape[0]
    low[:] = 0.0
    diag[:] = 0.0
    up[:] = 0.0
    g[:] = 0.0
    mid = np.empty(4)
    frame = np.empty((3, 3))
    d = np.empty(3)
    strain = np.empty(6)
    stress = np.empty(6)
    t = np.empty(7)
    nw = np.empty(3)
    mw = np.empty(3)
    bow = np.empty(3)
    knn = np.empty((3, 3))
    kmm = np.empty((3, 3))
    p = np.empty((3, 3))
    w = np.empty((3, 3))
    tr = np.empty((3, 3))
    tp = np.empty((3, 3))
    for k in range(n):
        segment_strain(chain, k, mid, frame, d, strain)
        respond(s, hist, k, strain, stress, t, False)
        h = chain.h[k]
        for i in range(3):
            a, b, c = frame[i, 0], frame[i, 1], frame[i, 2]
            nw[i] = a * stress[0] + b * stress[1] + c * stress[2]
            mw[i] = a * stress[3] + b * stress[4] + c * stress[5]
            for j in range(3):
                knn[i, j] = (a * t[0] * frame[j, 0] + b * t[1] * frame[j, 1] + c * t[2] * frame[j, 2]) / h
                kmm[i, j] = (
                    (a * t[3] + b * t[4]) * frame[j, 0] + (a * t[4] + b * t[5]) * frame[j, 1] + c * t[6] * frame[j, 2]
                ) / h
                w[i, j] = 0.0
        matrix_cross(knn, d, 0.5, p)
        add_skew(nw, -0.5, p)
        add_skew(mw, -0.5, w)
        cross_matrix(d, knn, 0.5, tr)
        add_skew(nw, -0.5, tr)
        for i in range(3):
            bow[i] = -h * h / 12 * (frame[i, 0] * strain[4] - frame[i, 1] * strain[3])
        cross_matrix(d, p, 0.5, tp)
        arm = (0.5 * (d[1] * nw[2] - d[2] * nw[1]), 0.5 * (d[2] * nw[0] - d[0] * nw[2]), 0.5 * (d[0] * nw[1] - d[1] * nw[0]))
        da = diag[k]
        db = diag[k + 1]
        u = up[k]
        l = low[k + 1]
        for i in range(3):
            g[k, i] -= nw[i]
            aside = bow[(i + 1) % 3] * nw[(i + 2) % 3] - bow[(i + 2) % 3] * nw[(i + 1) % 3]
            g[k, 3 + i] -= mw[i] + arm[i] + aside
            g[k + 1, i] += nw[i]
            g[k + 1, 3 + i] += mw[i] - arm[i] + aside
            for j in range(3):
                da[i, j] -= knn[i, j]
                u[i, j] += knn[i, j]
                l[i, j] += knn[i, j]
                db[i, j] -= knn[i, j]
                da[i, 3 + j] += p[i, j]
                u[i, 3 + j] += p[i, j]
                l[i, 3 + j] -= p[i, j]
                db[i, 3 + j] -= p[i, j]
                da[3 + i, j] -= tr[i, j]
                u[3 + i, j] += tr[i, j]
                l[3 + i, j] -= tr[i, j]
                db[3 + i, j] += tr[i, j]
                da[3 + i, 3 + j] += w[i, j] - kmm[i, j] + tp[i, j]
                u[3 + i, 3 + j] += w[i, j] + kmm[i, j] + tp[i, j]
                l[3 + i, 3 + j] += tp[i, j] - w[i, j] + kmm[i, j]
                db[3 + i, 3 + j] += tp[i, j] - w[i, j] - kmm[i, j]
    _external(chain, loads, diag, up, low, g, frame, nw, mw)


@kernel
def _external(
    chain: Chain, loads: ChainLoads, diag: Array, up: Array, low: Array, g: Array, frame: Array, f: Array, m: Array
) -> None:
    """Add the nodes' loads F to the residual, as -F, and their derivatives; `frame`, `f`, `m` are scratch space."""
    n = chain.h.shape[0]
    for k in range(1, n + 1):
        for i in range(3):
            g[k, i] -= loads.force[k, i]
        b = loads.follower_moment[k]
        if b[0] != 0.0 or b[1] != 0.0 or b[2] != 0.0:
            rotation(chain.q[k], frame)
            for i in range(3):
                m[i] = frame[i, 0] * b[0] + frame[i, 1] * b[1] + frame[i, 2] * b[2]
                g[k, 3 + i] -= m[i]
            add_skew(m, -1.0, diag[k, 3:, 3:])
    b = loads.follower_force
    rotation(chain.q[n], frame)
    for i in range(3):
        f[i] = frame[i, 0] * b[0] + frame[i, 1] * b[1] + frame[i, 2] * b[2]
        g[n, i] -= f[i] + loads.spring[0] * (loads.spring[1 + i] - chain.r[n, i])
        diag[n, i, i] -= loads.spring[0]
    add_skew(f, -1.0, diag[n, :3, 3:])
    for c in range(loads.contacts.shape[0]):
        row = loads.contacts[c]  # node, weight, direction (3), level, soft depth, soft stiffness, stiffness
        k = int(row[0])
        w = row[1]
        distance = 0.0
        for i in range(3):
            distance += row[2 + i] * ((1 - w) * chain.r[k, i] + w * chain.r[k + 1, i])
        force, slope = contact_force(row[5] - distance, row[6], row[7], row[8])
        for i in range(3):
            g[k, i] -= (1 - w) * force * row[2 + i]
            g[k + 1, i] -= w * force * row[2 + i]
            for j in range(3):
                s = slope * row[2 + i] * row[2 + j]
                diag[k, i, j] -= (1 - w) * (1 - w) * s
                up[k, i, j] -= (1 - w) * w * s
                low[k + 1, i, j] -= (1 - w) * w * s
                diag[k + 1, i, j] -= w * w * s


@kernel
def equilibrium(chain: Chain, s: Sections, hist: SliderHistory, loads: ChainLoads) -> int:
    """Move the chain to equilibrium; returns the iterations used, -1 when it was not found.

    The history is read, not changed. On failure the chain is left where the last iteration put it.
    """
    n = chain.h.shape[0]
    low = np.empty((n + 1, 6, 6))
    diag = np.empty((n + 1, 6, 6))
    up = np.empty((n + 1, 6, 6))
    g = np.empty((n + 1, 6))
    for i in range(4):
        chain.q[0, i] = loads.base[i]
    # m and rad, largest last correction of a node; each is at least 50 times smaller than the one before
    tolerance = 1e-7 if loads.contacts.shape[0] > 0 else 1e-6
    for iteration in range(30):
        _balance(chain, s, hist, loads, low, diag, up, g)
        solve_chain(low, diag, up, g)
        move = 0.0
        angle = 0.0
        for k in range(n + 1):
            for i in range(3):
                move = max(move, abs(g[k, i]))
                angle = max(angle, abs(g[k, 3 + i]))
        if not (move < 1e3 and angle < 1e5):
            return -1
        # m and rad: keeps Newton on the branch it started on
        scale = min(1.0, 0.04 / max(move, 1e-30), 0.25 / max(angle, 1e-30))
        for k in range(n + 1):
            for i in range(3):
                chain.r[k, i] += scale * g[k, i]
            turn(chain.q[k], scale * g[k, 3], scale * g[k, 4], scale * g[k, 5])
        if max(move, angle) < tolerance:
            return iteration + 1
    return -1


@kernel
def foresee(chain: Chain, r_before: Array, q_before: Array, ratio: float) -> None:
    """Carry the last motion on: the shape becomes now + ratio * (now - before); the arrays `before` take what was now."""
    d = np.empty(3)
    frame = np.empty((3, 3))
    q = np.empty(4)
    for k in range(1, chain.r.shape[0]):
        for i in range(3):
            now = chain.r[k, i]
            chain.r[k, i] += ratio * (now - r_before[k, i])
            r_before[k, i] = now
        relative_rotation(q_before[k], chain.q[k], d)
        rotation(chain.q[k], frame)
        for i in range(4):
            q[i] = chain.q[k, i]
        turn(
            chain.q[k],
            ratio * (frame[0, 0] * d[0] + frame[0, 1] * d[1] + frame[0, 2] * d[2]),
            ratio * (frame[1, 0] * d[0] + frame[1, 1] * d[1] + frame[1, 2] * d[2]),
            ratio * (frame[2, 0] * d[0] + frame[2, 1] * d[1] + frame[2, 2] * d[2]),
        )
        for i in range(4):
            q_before[k, i] = q[i]


@kernel
def commit(chain: Chain, s: Sections, hist: SliderHistory) -> None:
    """Let the history move on to the present shape."""
    mid = np.empty(4)
    frame = np.empty((3, 3))
    d = np.empty(3)
    strain = np.empty(6)
    stress = np.empty(6)
    t = np.empty(7)
    for k in range(chain.h.shape[0]):
        segment_strain(chain, k, mid, frame, d, strain)
        respond(s, hist, k, strain, stress, t, True)
