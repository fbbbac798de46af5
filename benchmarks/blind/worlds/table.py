"""The named worlds: one form of each effect, and how exactly things are built, mounted and seen there."""

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
WORLDS = {
    w.name: w
    for w in (
        World("bench", _forms(
            "dahl compliance soft seams reel layers mooney_rivlin power_law half_sine "
            "saturating seating regulator uneven late to_the_tip "
            "spine point hertz lever with_shift middle off_centre late")),
        World("workshop", _forms(
            "bouc_wen sliding lag along encoder skin gent stretched helix "
            "threshold slow falling off_centre middle but_the_cap "
            "fittings spread slanted corner hinge ceiling hidden_pin frames"),
            tolerance=1.5, heavy=True, drift=0.01, spread=1.3, remount=0.05, camera=0.3),
        World("cellar", _forms(
            "prandtl loose by_length by_length slack mix payne logarithmic at_the_base "
            "tube rational warming cap early from_the_base "
            "to_the_tip stiffening foam below play stretched cap filter"),
            tolerance=1.0, clutter=0.10, drift=0.025, camera=0.2, correlated=0.5),
        World("attic", _forms(
            "lugre from_the_base soft threshold wrinkles layers fung slow helix "
            "threshold play regulator cap late to_the_tip "
            "hose point foam lever hinge stretched off_centre frames"),
            tolerance=2.0, heavy=True, clutter=0.20, drift=0.015, spread=1.5, remount=0.1, remounts=True, camera=0.3,
            correlated=0.3),
        World("shared", _forms(
            "dahl loose lag threshold encoder mix gent logarithmic half_sine "
            "tube slow warming uneven middle from_the_base "
            "fittings stiffening hertz corner play ceiling cap late"),
            tolerance=1.0, clutter=0.12, thrust=0.5, drift=0.005, camera=0.15),
        World("field", _forms(
            "bouc_wen from_the_base by_length along slack skin payne power_law at_the_base "
            "saturating rational falling off_centre early but_the_cap "
            "to_the_tip spread slanted below with_shift middle hidden_pin filter"),
            tolerance=3.0, heavy=True, clutter=0.15, drift=0.025, spread=2.0, remount=0.1, remounts=True, camera=0.3,
            correlated=0.5),
        World("quiet", _forms(
            "prandtl sliding soft by_length wrinkles mix fung stretched half_sine "
            "threshold play regulator uneven late to_the_tip "
            "hose point hertz below hinge middle hidden_pin frames"),
            clutter=0.05, spread=0.5, camera=0.1),
    )
}  # fmt: skip
"""By name."""


def world(name: str) -> World:
    """A named world, or one that `drawn:SEED` draws (`new:SEED`: of forms that nothing is developed on). Raises ValueError."""
    if name in WORLDS:
        return WORLDS[name]
    word, _, number = name.partition(":")
    if word not in ("drawn", "new") or not number.isdecimal():
        raise ValueError(f"world {name!r}: must be one of {', '.join(WORLDS)}, drawn:SEED or new:SEED with a whole number")
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
