"""A further form of each effect that nothing is developed on: drawn only in worlds `new:SEED`.

x (n,) is the size in the unit of the form; a = s / L, p = P / 250 kPa, l the spine's length. Each scale moves the tip by as many
mm as `forms.EFFECTS` states, over the same sweep.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .actuation import _grows
from .body import Slip, WorldBody
from .equilibrium import Shape
from .frames import apply, turn
from .gas import GasChambers
from .loads import PER_LENGTH, _direction, _hat, _obstacle, _tilted
from .robot import SPINE_AREA, SPINE_SECOND
from .seen import Seeing, SeenPath, _aside, _at
from .silicone import _curved, _fibres
from .spine import _grown, _toward, _weaken, composite

Array = NDArray[np.float64]


# ------------------------------------------------------------------ the spine
def slip_towards_the_end(b: WorldBody, x: Array) -> None:
    """Dahl's element, yield 0.6 /m, that holds more towards the spine's end and under pressure."""
    reach = b.s / np.maximum(b.true_length, 1e-3)[:, None]
    b.slips.append(Slip(x[:, None] * (0.4 + 1.2 * reach) * b.cover, 0.6, "dahl", by_pressure=0.5))


def composite_geometric(b: WorldBody, x: Array) -> None:
    """Mix^(1 - x) composite^x, the spine a ring of dense granules about a loose core: 0.7 of its area, 0.91 of its moment."""
    silicone, spine = composite(b, 0.7 * SPINE_AREA, 0.91 * SPINE_SECOND)
    mixed, made = b.stiff_silicone + b.stiff_spine, silicone + spine
    blend = np.clip(x, 0, 1)[:, None, None]
    total, share = mixed ** (1 - blend) * made**blend, silicone / made
    share = (1 - blend) * b.stiff_silicone / mixed + blend * share
    b.stiff_silicone, b.stiff_spine = total * share, total * (1 - share)


def shear_of_loose_ends(b: WorldBody, x: Array) -> None:
    """E 6.4 MPa (1 - 0.7 (s / l)^2), kappa G 85 kPa: granules are packed less tightly where they came in last."""
    reach = np.clip(b.s / np.maximum(b.true_length, 1e-3)[:, None], 0, 1)
    _toward(b, x, 6.4e6 * (1 - 0.7 * reach**2), np.full_like(b.spine_e, 85e3), False)


def leak_against_the_pump(b: WorldBody, x: Array) -> None:
    """Share u / (1 + u) lost, u = x (0.3 + l / 0.2 m), stiffness as what is left to the 0.6: the pump's curve is hyperbolic."""
    lost = np.maximum(x, 0) * (0.3 + b.true_length / 0.2)
    _weaken(b, (lost / (1 + lost))[:, None], 0.6)


def tape_that_stretches(b: WorldBody, x: Array) -> None:
    """l + x (1.3 - l / 0.3 m): an end stop that is off, and a tape that stretches the other way."""
    _grown(b, x * (1.3 - b.lanes.spine / 0.3), True)


# ------------------------------------------------------------------ the silicone
def modulus_of_fibres(b: WorldBody, x: Array) -> None:
    """E (1 + 1.4 x) in stretch, (1 + 0.8 x) in bending, G (1 + 0.2 x): threads along the body."""
    b.silicone_axial *= 1 + 1.4 * x[:, None]
    b.silicone_bending *= 1 + 0.8 * x[:, None]
    b.silicone_shear *= 1 + 0.2 * x[:, None]


def _ogden(e: Array) -> tuple[Array, Array]:
    stretch, power = np.maximum(1 + e, 0.3), -4.0
    factor = 2 / (3 * power)
    stress = factor * (stretch ** (power - 1) - stretch ** (-power / 2 - 1))
    return stress, factor * ((power - 1) * stretch ** (power - 2) + (power / 2 + 1) * stretch ** (-power / 2 - 2))


ogden = _fibres(_ogden)
"""Share x of the section's fibres obeys Ogden's law with one term of power -4."""


def two_branches(b: WorldBody, x: Array) -> None:
    """Two Maxwell elements, 4 s and 150 s, alike."""
    b.creep += [(0.8 * x, 4.0), (0.8 * x, 150.0)]


def curved_to_the_tip(b: WorldBody, x: Array) -> None:
    """2 x a: hung by its base while it cured."""
    _curved(b, 2 * x[:, None] * b.along(), 0.0)


# ------------------------------------------------------------------ the chambers
balloon_between = _grows(lambda p: np.minimum(p, 1.2) ** 2 * (3 - 2 * np.minimum(p, 1.2)))
"""A (1 + x (3 p^2 - 2 p^3)): nothing at first, then a wall that gives, then fibres that hold."""


def caught_up_band(c: GasChambers, x: Array) -> None:
    """P - x (1 - exp(-(P / 45 kPa)^2)): folds that open all at once."""
    c.pressures.append(lambda p: p + x[:, None] * np.expm1(-((np.maximum(p, 0.0) / 45e3) ** 2)))


def drooping_supply(c: GasChambers, x: Array) -> None:
    """P + x (1.2 - 0.9 m), m the mean of all chambers / 100 kPa: zeros that are off, and a supply that droops."""
    c.pressures.append(lambda p: p + x[:, None] * (1.2 - 0.9 * p.mean(axis=1, keepdims=True) / 100e3))


def azimuth_of_an_ellipse(c: GasChambers, x: Array) -> None:
    """az + x (1 + 0.5 sin 2 az): turned, and pressed out of round."""
    c.azimuths += x[:, None] * (1 + 0.5 * np.sin(2 * c.azimuths))


def twist_there_and_back(c: GasChambers, x: Array) -> None:
    """x L sin(0.8 pi a): wound one way, and most of it back."""
    c.winding += x[:, None] * c.body.lanes.length[:, None] * np.sin(0.8 * np.pi * c.body.along())


def walls_but_the_middle(c: GasChambers, x: Array) -> None:
    """Share x (0.8 + 0.2 cos 2 pi a): a band holds the walls half way."""
    c.on_walls += np.clip(x, 0, 1)[:, None] * (0.8 + 0.2 * np.cos(2 * np.pi * c.body.along()))


# ------------------------------------------------------------------ loads and the base
def weight_of_a_sleeve(b: WorldBody, x: Array) -> None:
    """Weight (1 + 1.4 x (1 - a^2)): a sleeve that thins out."""
    b.line += PER_LENGTH * 1.4 * x[:, None] * (1 - b.along() ** 2)


def tether_of_rubber(b: WorldBody, x: Array) -> None:
    """x (1 + d / 0.25 m) at four fifths of the body, d its way against the pull."""
    direction, weights = _direction(b), _hat(b, 0.8)

    def force(shape: Shape) -> tuple[Array, Array]:
        sign = np.sign(x)
        away = -np.einsum("nk,nkc,c->n", weights, shape.r, direction) * sign
        pull = x * np.maximum(1 + away / 0.25, 0.0)
        slope = -np.where(1 + away / 0.25 > 0, np.abs(x) / 0.25, 0.0)
        out = (weights * pull[:, None])[..., None] * direction
        return out, (weights**2 * slope[:, None])[..., None, None] * np.outer(direction, direction)

    b.fields.append(force)


def contact_edge(b: WorldBody, x: Array) -> None:
    """x N/m times d (d / 15 mm)^0.3 at seven tenths of the body: an edge pressed into it."""

    def law(d: Array) -> tuple[Array, Array]:
        power = (np.maximum(d, 1e-9) / 0.015) ** 0.3
        return d * power, 1.3 * power

    _obstacle(b, law, x, _hat(b, 0.7), np.array([1.0, 0.0, 0.0]), -0.02)


def tilt_about_a_foot(b: WorldBody, x: Array) -> None:
    """Turned by x about a foot 80 mm aside and 30 mm above."""
    a = b.lanes.places.tilt
    _tilted(b, x, (0.08 * float(np.cos(a)), 0.08 * float(np.sin(a)), 0.03))


def give_of_rubber(b: WorldBody, x: Array) -> None:
    """Turns by 1.3 x M / (1 + M / 1.5 N m): feet that harden."""

    def law(w: Array) -> tuple[Array, Array]:
        m = w[:, 3:5]
        size = np.linalg.norm(m, axis=1) + 1e-9
        soft = 1.3 * x / (1 + size / 1.5)
        out, c = np.zeros_like(w), np.zeros((len(x), 6, 6))
        out[:, 3:5] = soft[:, None] * m
        bend = (soft / ((1.5 + size) * size))[:, None, None] * m[:, :, None] * m[:, None, :]
        c[:, 3:5, 3:5] = soft[:, None, None] * np.eye(2) - bend
        return out, c

    b.give = law


# ------------------------------------------------------------------ measuring
def turned_and_sheared(s: Seeing, x: Array) -> None:
    """Turned by x about the base; the first axis leans by x / 2 towards the third: camera axes that are not square."""
    lean = np.zeros((len(x), 3, 3))
    lean[:, 0, 2] = 0.5 * x
    rotation = turn(x[:, None] * np.array(s.lanes.places.axis))
    seen = rotation @ (np.eye(3) + lean)
    s.views.append(lambda path: replace(path, tip=apply(seen, path.tip), turns=rotation @ path.turns,
                                  markers=apply(seen[:, None], path.markers)))  # fmt: skip


def marker_on_a_stalk(s: Seeing, x: Array) -> None:
    """0.7 x aside and 0.7 x along the tip's axis, less by a fifth where the tip hangs level: its stalk bends."""
    offset = _aside(s, x, 1.0)
    s.views.append(
        lambda path: replace(path, tip=path.tip + (0.8 + 0.2 * path.turns[..., 2, 2:] ** 2) * apply(path.turns, offset))
    )


def late_at_high_speed(s: Seeing, x: Array) -> None:
    """The tip of x (0.6 + 0.8 u) seconds earlier, u the share of the trial that is over: a buffer fills."""

    def law(path: SeenPath) -> SeenPath:
        now = path.times[path.reads]
        passed = (now - now[0]) / max(float(np.ptp(now)), 1e-9)
        return _at(path, now[:, None] - x[None, :] * (0.6 + 0.8 * passed)[:, None])

    s.delays.append(law)


FORMS_HELD_OUT: dict[str, dict[str, tuple[Callable[[Any, Array], None], float]]] = {
    "spine_slip": {"towards_the_end": (slip_towards_the_end, 0.11)},
    "area_moment": {"geometric": (composite_geometric, 1.0)},
    "spine_shear": {"loose_ends": (shear_of_loose_ends, 1.0)},
    "vacuum_leak": {"against_the_pump": (leak_against_the_pump, 0.27)},
    "spine_length_offset": {"tape": (tape_that_stretches, 0.0135)},
    "body_modulus": {"fibres": (modulus_of_fibres, 0.15)},
    "hyperelastic": {"ogden": (ogden, 0.9)},
    "viscoelastic": {"two_branches": (two_branches, 0.03)},
    "precurvature": {"to_the_tip": (curved_to_the_tip, 0.12)},
    "chamber_ballooning": {"between": (balloon_between, 0.14)},
    "pressure_deadband": {"caught_up": (caught_up_band, 11000)},
    "pressure_offset": {"drooping": (drooping_supply, 6800)},
    "chamber_azimuth": {"ellipse": (azimuth_of_an_ellipse, 0.1)},
    "chamber_twist": {"there_and_back": (twist_there_and_back, 0.29)},
    "chamber_thrust": {"but_the_middle": (walls_but_the_middle, 1.0)},
    "self_weight": {"sleeve": (weight_of_a_sleeve, 0.25)},
    "tether_load": {"rubber": (tether_of_rubber, 0.63)},
    "contact": {"edge": (contact_edge, 1200)},
    "base_tilt": {"foot": (tilt_about_a_foot, 0.025)},
    "base_compliance": {"rubber": (give_of_rubber, 0.1)},
    "frame_misalignment": {"sheared": (turned_and_sheared, 0.0155)},
    "marker_offset": {"stalk": (marker_on_a_stalk, 0.0058)},
    "time_offset": {"buffer": (late_at_high_speed, 0.41)},
}
"""Law and plausible size (in its own unit) by effect and name of the form."""
