"""Parts of a body along its arc, as robot.yaml lists them, and whether radii and lengths fit together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat

from model.actuators import Actuators
from model.arrays import Array
from model.plain_yaml import FileTable

Radius = Annotated[FiniteFloat, Field(ge=0, le=1)]
Positive = Annotated[FiniteFloat, Field(gt=0, le=1e9)]
Weight = Annotated[FiniteFloat, Field(ge=0, le=20_000)]


class Section(FileTable):
    """A part of the body; keys that it leaves out are the robot's. Two numbers are those at its base and tip end, linear in
    between.
    """

    length: FiniteFloat = Field(gt=0, le=5, json_schema_extra={"unit": "m"})
    outer_radius: Radius | tuple[Radius, Radius] | None = Field(default=None, json_schema_extra={"unit": "m"})
    inner_radius: Radius | tuple[Radius, Radius] | None = Field(default=None, json_schema_extra={"unit": "m"})
    youngs_modulus: Positive | tuple[Positive, Positive] | None = Field(default=None, json_schema_extra={"unit": "Pa"})
    density: Weight | tuple[Weight, Weight] | None = Field(default=None, json_schema_extra={"unit": "kg/m^3"})
    bending_stiffness: Positive | tuple[Positive, Positive] | None = Field(default=None, json_schema_extra={"unit": "N m^2"})
    axial_stiffness: Positive | tuple[Positive, Positive] | None = Field(default=None, json_schema_extra={"unit": "N"})
    torsional_stiffness: Positive | tuple[Positive, Positive] | None = Field(default=None, json_schema_extra={"unit": "N m^2"})
    mass_per_length: Weight | tuple[Weight, Weight] | None = Field(default=None, json_schema_extra={"unit": "kg/m"})
    chamber_radius: Radius | tuple[Radius, Radius] | None = Field(default=None, json_schema_extra={"unit": "m"})
    """That of a chamber of mean area; 0: the chambers do not reach here."""
    path_radius: Radius | tuple[Radius, Radius] | None = Field(default=None, json_schema_extra={"unit": "m"})
    """The mean."""

    @property
    def tapers(self) -> bool:
        """Whether anything changes along it."""
        return any(isinstance(getattr(self, name), tuple) for name in type(self).model_fields)

    def at(self, name: str, share: Array) -> Array | None:
        """A field at shares 0..1 of its length; None where it is not said."""
        value = getattr(self, name)
        if value is None:
            return None
        base, tip = value if isinstance(value, tuple) else (value, value)
        return np.asarray(base + (tip - base) * share)


def section_problems(
    sections: Sequence[Section], length: float, radii: Mapping[str, float], spine: float | None, actuators: Actuators
) -> Iterator[str]:
    """One line for each misfit of sections, length, `radii` (by field of `Section`) and spine radius, m."""
    uniform = list(_crossing("", {name: np.array([value]) for name, value in radii.items()}, spine, actuators))
    yield from uniform
    if uniform or not sections:
        return
    total = sum(part.length for part in sections)
    if abs(total - length) > 1e-6 * length:
        yield f"sections: lengths add up to {total:g} m, must be length {length:g} m"
    for i, part in enumerate(sections):
        along = {name: part.at(name, np.array([0.0, 1.0])) for name in radii}
        of_section = {name: np.full(2, radii[name]) if x is None else x for name, x in along.items()}
        yield from _crossing(f"sections[{i}]: ", of_section, spine, actuators)


def _crossing(place: str, radii: Mapping[str, Array], spine: float | None, drive: Actuators) -> Iterator[str]:
    """One line for each pair of radii (m) that cross: of the wall, the chambers in it and the spine; `place` begins it."""
    outer, inner, chamber, path = (radii[k] for k in ("outer_radius", "inner_radius", "chamber_radius", "path_radius"))
    if (inner >= outer).any():
        worst = int(np.argmax(inner - outer))
        yield f"{place}inner_radius {inner[worst]:g} m must be less than outer_radius {outer[worst]:g} m"
        return
    # A chamber may touch the wall's surfaces (rounded drawings do), not cross them; where there is no bore, two chambers would
    # overlap at the axis, but one alone may reach over it.
    place_of, reach = np.multiply.outer(drive.levers, path), np.multiply.outer(np.sqrt(drive.shares), chamber)
    low, high = (place_of - reach).min(axis=0), (place_of + reach).max(axis=0)
    over_axis = (len(place_of) == 1) & (inner == 0)
    crosses = (chamber > 0) & ((~over_axis & (low < inner * (1 - 1e-9))) | (high > outer * (1 + 1e-9)))
    if crosses.any():
        k = int(np.argmax(crosses))
        yield (
            f"{place}chambers reach from {1e3 * low[k]:g} to {1e3 * high[k]:g} mm off the axis, the wall from inner_radius "
            f"{1e3 * inner[k]:g} to outer_radius {1e3 * outer[k]:g} mm: change chambers.path_radius or chambers.radius; of "
            "bellows beside a core the radii enclose both: state bending_stiffness, axial_stiffness and mass_per_length, too"
        )
    if spine is not None and (spine > inner * (1 + 1e-9)).any():
        yield f"{place}spine.radius {spine:g} m must not exceed inner_radius {inner.min():g} m"
