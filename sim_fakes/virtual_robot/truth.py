"""What the virtual robot really is: geometry, materials, time constants, the stand. SI units throughout.

The defaults are the robot of the Wang & Rojas paper (its Tables I and II) with one effective-area factor for all spine
lengths. Whoever analyses the recordings is not shown this file's values: they are the truth behind the fake
instruments.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

TABLE_II = {0.05: 0.318e6, 0.10: 1.323e6, 0.15: 2.032e6, 0.20: 3.069e6, 0.25: 3.763e6, 0.30: 4.389e6}
"""Apparent modulus of the jammed spine (Pa) over its length (m), Table II of the paper."""

HANGING_STAND = ((1.0, 0.0, 0.0, 0.50), (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.70), (0.0, 0.0, 0.0, 1.0))
"""A specimen clamped 0.7 m above the arm's base, hanging down; its x axis is the arm's x axis."""


Radius = Annotated[float, Field(gt=0, le=0.1)]


class RobotTruth(BaseModel):
    """Constants of one virtual robot; frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # body
    length: float = Field(default=0.40, gt=0.05, le=2, json_schema_extra={"unit": "m"})
    outer_radius: float = Field(default=0.05, gt=0, le=0.5, json_schema_extra={"unit": "m"})
    inner_radius: float = Field(default=0.029, ge=0, le=0.5, json_schema_extra={"unit": "m"})
    density: float = Field(default=1300.0, ge=0, le=20_000, json_schema_extra={"unit": "kg/m^3"})
    youngs_modulus: float = Field(default=0.507147e6, gt=1e3, le=1e9, json_schema_extra={"unit": "Pa"})
    shear_ratio: float = Field(default=1 / 3, gt=0, le=1)
    """Shear modulus / Young's modulus, body and jammed spine alike."""
    bending_stiffness: float | None = Field(default=None, gt=0, le=1e9, json_schema_extra={"unit": "N m^2"})
    axial_stiffness: float | None = Field(default=None, gt=0, le=1e9, json_schema_extra={"unit": "N"})
    torsional_stiffness: float | None = Field(default=None, gt=0, le=1e9, json_schema_extra={"unit": "N m^2"})
    mass_per_length: float | None = Field(default=None, ge=0, le=20_000, json_schema_extra={"unit": "kg/m"})
    """Of the body, in place of those that modulus, density and the annulus give."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 9.81)
    """m/s^2, robot base frame (z from base to tip)."""
    markers: tuple[float, ...] = (0.1, 0.2, 0.3)
    """Arc lengths of the body markers, m."""

    # chambers
    chamber_radius: Radius | tuple[Radius, ...] = 0.005
    """m, of all chambers or of each."""
    chamber_path_radius: float | tuple[float, ...] = 0.04
    """m, of all chambers or of each."""
    chamber_azimuths_deg: tuple[float, ...] = Field(default=tuple(40.0 * i for i in range(9)), min_length=1, max_length=64)
    area_factor: float = Field(default=1.6, gt=0, le=10)
    """Effective chamber area / (pi chamber_radius^2), one number for all spine lengths."""
    thrust_on_walls: bool = False
    """Whether the side walls take the chambers' thrust, all along the arc, instead of the tip's cap."""
    fill_time: float = Field(default=0.25, gt=0, le=60, json_schema_extra={"unit": "s"})
    supply_pressure: float = Field(default=400e3, gt=0, le=1e6, json_schema_extra={"unit": "Pa"})
    max_pressure: float | tuple[float, ...] | None = None
    """Pa, highest that rig.yaml allows, of all chambers or of each; of no effect on the physics."""

    # spine
    spine_modulus: dict[float, float] = Field(default_factory=lambda: dict(TABLE_II))
    """Apparent modulus (Pa) at nominal vacuum over spine length (m): straight between points and beyond the last one,
    constant below the first one."""
    spine_radius: float = Field(default=0.029, gt=0, le=0.5, json_schema_extra={"unit": "m"})
    nominal_vacuum: float = Field(default=80e3, gt=1e3, lt=101e3, json_schema_extra={"unit": "Pa"})
    pump_time: float = Field(default=1.5, gt=0, le=600, json_schema_extra={"unit": "s"})
    release_time: float = Field(default=0.7, gt=0, le=600, json_schema_extra={"unit": "s"})
    jam_threshold: float = Field(default=15e3, gt=0, lt=101e3, json_schema_extra={"unit": "Pa"})
    """Vacuum above which the granules hold the spine so that the unit cannot move it."""
    scatter_length: float = Field(default=0.0, ge=0, le=0.02, json_schema_extra={"unit": "m"})
    """Standard deviation of the true length, drawn anew at each jamming."""
    scatter_stiffness: float = Field(default=0.0, ge=0, le=0.2)
    """Relative standard deviation of the jammed modulus, drawn anew at each jamming."""

    # how it is simulated and held
    segments: int = Field(default=40, ge=8, le=400)
    settling_time: float = Field(default=0.06, ge=0, le=5, json_schema_extra={"unit": "s"})
    """Time constant of the overdamped approach to equilibrium."""
    stand: tuple[tuple[float, float, float, float], ...] = HANGING_STAND
    """Specimen base frame in the arm base frame, homogeneous 4 x 4. The probe pushes along the specimen's +x."""
    stand_gravity: tuple[float, float, float] = (0.0, 0.0, 9.81)
    """m/s^2, specimen frame; acts on the body only (the bare spine is taken as weightless)."""
    contact_stiffness: float = Field(default=1e7, gt=1e3, le=1e10, json_schema_extra={"unit": "N/m"})
    arm_errors: float = Field(default=0.0, ge=0, le=10)
    """Size of the arm's differences from its nominal kinematics; 1: those of a UR5 as it is built."""
    canonical_directions: bool = False
    """Effects that have a direction act along x (or about y) instead of in a direction drawn from the seed."""

    @model_validator(mode="after")
    def _consistent(self) -> RobotTruth:
        if self.inner_radius >= self.outer_radius:
            raise ValueError(f"inner_radius {self.inner_radius} m must be below outer_radius {self.outer_radius} m")
        if any(not 0 < s < self.length for s in self.markers) or list(self.markers) != sorted(self.markers):
            raise ValueError(f"markers {self.markers} m must rise and lie inside the body of {self.length} m")
        if len(self.stand) != 4 or self.stand[3] != (0.0, 0.0, 0.0, 1.0):
            raise ValueError("stand must be a homogeneous 4 x 4 matrix, last row 0 0 0 1")
        if len(self.spine_modulus) < 2 or min(self.spine_modulus) <= 0 or min(self.spine_modulus.values()) <= 0:
            raise ValueError("spine_modulus needs two or more lengths (m), all above 0, with moduli (Pa) above 0")
        return self

    @property
    def annulus(self) -> float:
        """Its cross-section, m^2 (chambers not subtracted)."""
        return math.pi * (self.outer_radius**2 - self.inner_radius**2)

    @property
    def area(self) -> float:
        """EA / E of the body, m^2."""
        return self.annulus if self.axial_stiffness is None else self.axial_stiffness / self.youngs_modulus

    @property
    def second_moment(self) -> float:
        """EI / E of the body, m^4."""
        of_annulus = math.pi / 4 * (self.outer_radius**4 - self.inner_radius**4)
        return of_annulus if self.bending_stiffness is None else self.bending_stiffness / self.youngs_modulus

    @property
    def torsion(self) -> float:
        """GJ / E of the body, m^4: twice that about a diameter unless it is given."""
        return 2 * self.second_moment if self.torsional_stiffness is None else self.torsional_stiffness / self.youngs_modulus

    @property
    def line_density(self) -> float:
        """Mass of the body per length, kg/m."""
        return self.density * self.annulus if self.mass_per_length is None else self.mass_per_length

    @property
    def spine_area(self) -> float:
        """Cross-section of the spine, m^2."""
        return math.pi * self.spine_radius**2

    @property
    def chamber_area(self) -> NDArray[np.float64]:
        """(chambers,) effective area of each, m^2."""
        areas = self.area_factor * math.pi * np.square(self.chamber_radius)
        return np.broadcast_to(areas, len(self.chamber_azimuths_deg))
