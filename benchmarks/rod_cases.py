"""The robot of the paper with random parameters, as rods, condition after condition."""

from __future__ import annotations

import math

import numpy as np

from model.arrays import Array
from model.rods import Form, Rods, Solution, rods

LENGTH, OUTER, INNER, BODY, GRAVITY = 0.40, 0.05, 0.029, 0.507147e6, 9.81
AREA, SECOND = math.pi * (OUTER**2 - INNER**2), math.pi / 4 * (OUTER**4 - INNER**4)
SPINE_AREA = math.pi * INNER**2
CHAMBER, PATH = 1.5 * math.pi * 0.005**2, 0.04


def rods_like_it(
    spine: Array, moduli: tuple[Array, Array], push: Array, roll: Array, dead: tuple[Array, Array, Array], weight: Array,
    form: Form | None = None,
) -> Rods:  # fmt: skip
    """Rods (n): spine lengths (m), moduli of both parts (Pa), force of a chamber (N), roll (rad), tip load (N), weight (N/m)."""
    azimuth, push = np.deg2rad([-40.0, 0.0, 40.0]) + roll[:, None], push[:, None]
    modulus, zero = np.stack(moduli, 1)[:, :, None], np.zeros(len(spine))
    return rods(
        form or Form(elements=2),
        len(spine),
        length=np.stack([spine, LENGTH - spine], 1),
        bend_stiffness=modulus * np.array([SECOND, SECOND, 2 * SECOND]),
        stretch_stiffness=modulus * np.array([AREA / 3, AREA / 3, AREA]),
        tip_force=np.stack([zero, zero, 3 * push[:, 0]], 1),
        tip_moment=np.stack([PATH * (np.sin(azimuth) * push).sum(1), -PATH * (np.cos(azimuth) * push).sum(1), zero], 1),
        dead_force=np.stack(dead, 1),
        load=np.stack([zero, zero, weight], 1)[:, None, :],
    )


def paper_rods(n: int, seed: int) -> Rods:
    """n rods: 7 spine lengths by 5 pressures, each with E, spine E, area, weights within 10 % and any roll."""
    r = np.random.default_rng(seed)
    condition = np.arange(n) * 35 // max(n, 1)
    spine, pressure = 0.05 * (condition // 5), 50e3 * (1 + condition % 5)
    body = BODY * r.uniform(0.9, 1.1, n)
    own = (0.318 + (4.389 - 0.318) * (spine - 0.05) / 0.25) * 1e6 * r.uniform(0.9, 1.1, n)
    mixed = np.where(spine > 0, (AREA * body + SPINE_AREA * own) / (AREA + SPINE_AREA), body)
    roll = r.uniform(0, 2 * np.pi, n)
    push = pressure * CHAMBER * r.uniform(0.9, 1.1, n)
    weight = 1300.0 * AREA * GRAVITY * r.uniform(0.9, 1.1, n)
    dead = (np.zeros(n), np.zeros(n), 0.053 * GRAVITY * r.uniform(0.5, 1.5, n))
    return rods_like_it(spine, (mixed, body), push, roll, dead, weight)


def directions(found: Rods) -> Array:
    """Eight parameters: both moduli, actuation, tip weight, body weight, precurvature twice, spine length."""
    view, width = found.form.view, found.form.width
    d = np.zeros((len(found), 8, width))
    for name in ("bend_stiffness", "stretch_stiffness"):
        view(d, name)[:, 0, 0] = found.field(name)[:, 0]
        view(d, name)[:, 1, 1] = found.field(name)[:, 1]
    for name in ("tip_force", "tip_moment"):
        view(d, name)[:, 2] = found.field(name)
    view(d, "dead_force")[:, 3] = found.field("dead_force")
    view(d, "load")[:, 4] = found.field("load")
    view(d, "rest_curvature")[:, 5, :, 0] = 1.0
    view(d, "rest_curvature")[:, 6, :, 1] = 1.0
    view(d, "length")[:, 7] = (1.0, -1.0)
    return d


def eased(found: Rods, share: float = 0.99) -> Rods:
    """The same rods with a little less of what the chambers do: a start that is near and not the solution."""
    less = Rods(found.form, found.values.copy())
    less.field("tip_force")[:] *= share
    less.field("tip_moment")[:] *= share
    return less


def split(found: Rods, parts: int) -> Rods:
    """The same rods with every element cut into equal parts."""
    names = ("bend_stiffness", "stretch_stiffness", "load")
    cut = {name: np.repeat(found.field(name), parts, axis=1) for name in names}
    ends = {name: found.field(name) for name in ("tip_force", "tip_moment", "dead_force")}
    length = np.repeat(found.field("length"), parts, axis=1) / parts
    return rods(Form(elements=2 * parts), len(found), length=length, **cut, **ends)


def tips_of(solution: Solution) -> Array:
    """Tips (n, 3) m of rods that were all solved."""
    return solution.trusted().tip


def wild_rods(n: int, seed: int) -> Rods:
    """Random robots far beyond the paper's: E +-30 %, to 450 kPa, any spine length, tip forces to 5 N sideways."""
    r = np.random.default_rng(seed)
    spine, pressure = r.uniform(0, 0.395, n) * (r.random(n) < 0.85), r.uniform(0, 450e3, n)
    body = BODY * r.uniform(0.7, 1.3, n)
    own = (0.318 + (4.389 - 0.318) * (spine - 0.05) / 0.25) * 1e6
    mixed = np.where(spine > 0, (AREA * BODY + SPINE_AREA * own) / (AREA + SPINE_AREA), BODY) * r.uniform(0.7, 1.3, n)
    roll = r.uniform(0, 2 * np.pi, n)
    angle, size = r.uniform(0, 2 * np.pi, n), r.uniform(0, 5, n)
    dead = (size * np.cos(angle), size * np.sin(angle), 0.053 * GRAVITY * r.uniform(0, 3, n))
    return rods_like_it(spine, (mixed, body), pressure * CHAMBER, roll, dead, 1300.0 * AREA * GRAVITY * r.uniform(0.8, 1.2, n))
