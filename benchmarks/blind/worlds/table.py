"""Worlds: one form of each effect, and how exactly things are built, mounted and seen there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .forms import FORMS
from .forms_held_out import FORMS_HELD_OUT


@dataclass(frozen=True)
class World:
    """One physics. Tolerances in the bench's usual ones: E 2 %, density 1 %, 0.1 deg, 0.5 mm; spread in 1 mm and 2 %."""

    name: str
    forms: Mapping[str, str]
    tolerance: float = 1.0
    heavy: bool = False
    """Tolerances and clutter are Student's t of three degrees of freedom, cut at four, instead of normal."""
    clutter: float = 0.15
    """Standard deviation of every other effect in a cluttered robot, in its plausible scale."""
    thrust: float = 0.0
    """Share of the thrust that the side walls balance, in every robot."""
    drift: float = 0.0
    """E lost over the campaign, at most."""
    spread: float = 1.0
    """Of trials: length and stiffness of the spine."""
    remount: float = 0.0
    """deg, standard deviation of the base's tilt from one mounting to the next."""
    remounts: bool = False
    """Mounted anew before each repeat of the sweep, not only for another experiment."""
    camera: float = 0.2
    """mm and deg of a reading."""
    correlated: float = 0.0
    """Share of the camera's variance that lasts for about a minute."""


def _forms(line: str) -> dict[str, str]:
    """One form of every effect, in the order of `FORMS`."""
    names = line.split()
    if len(names) != len(FORMS):
        raise ValueError(f"a world names {len(names)} forms, there are {len(FORMS)} effects")
    return dict(zip(FORMS, names, strict=True))


# spine_slip area_moment spine_shear vacuum_leak spine_length_offset body_modulus hyperelastic viscoelastic precurvature
# chamber_ballooning pressure_deadband pressure_offset chamber_azimuth chamber_twist chamber_thrust
# self_weight tether_load contact base_tilt base_compliance frame_misalignment marker_offset time_offset
BENCH = World("bench", _forms(
    "dahl compliance soft seams reel layers mooney_rivlin power_law half_sine "
    "saturating seating regulator uneven late to_the_tip "
    "spine point hertz lever with_shift middle off_centre late"))  # fmt: skip
"""The default."""


def world(name: str) -> World:
    """`bench`, or one that `drawn:SEED` draws (`new:SEED`: of forms that nothing is developed on). Raises ValueError."""
    if name == BENCH.name:
        return BENCH
    word, _, number = name.partition(":")
    if word not in ("drawn", "new") or not number.isdecimal():
        raise ValueError(f"world {name!r}: must be {BENCH.name}, drawn:SEED or new:SEED with a whole number")
    return _drawn(name, int(number), FORMS if word == "drawn" else FORMS_HELD_OUT)


def _drawn(name: str, seed: int, laws: Mapping[str, Mapping[str, object]]) -> World:
    rng = np.random.default_rng([seed, 14])
    return World(
        name,
        {effect: str(rng.choice(list(forms))) for effect, forms in laws.items()},
        tolerance=float(np.exp(rng.uniform(0, np.log(3)))),
        heavy=bool(rng.random() < 0.5),
        clutter=float(rng.uniform(0.05, 0.2)),
        thrust=float(rng.uniform(0.3, 1.0)) if rng.random() < 0.2 else 0.0,
        drift=float(rng.uniform(0, 0.025)),
        spread=float(rng.uniform(0.7, 2.0)),
        remount=float(rng.uniform(0, 0.1)),
        remounts=bool(rng.random() < 0.3),
        camera=float(rng.uniform(0.1, 0.3)),
        correlated=float(rng.choice([0.0, 0.3, 0.6])),
    )
