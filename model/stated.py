"""What robot.yaml states of effects: values with their uncertainty, and how the uncertainties hang together.

    effects:                                            # causes that are part of this robot
      area_moment:
        blend: {value: 0.71, sd: 0.02, unit: '1'}
    tolerances:                                         # how the set-up of the campaign differed from its drawing
      tilt:
        x: {value: 0.0011, sd: 0.0007, unit: rad}
    posterior:                                          # of a fit: what predictions take their intervals from
      parameters: [area_factor, area_moment.blend, tilt.x]
      area_factor_sd: 0.004
      correlation: [[1], [0.31, 1], [0.02, -0.1, 1]]    # lower triangle, in the order of `parameters`
      law_error: 0.03                                   # share of what each effect does
      discrepancy: 0.0001                               # m
      fitted_pressure: [0, 60000]                       # Pa, of the states that were fitted
      noise: {floor: 0.0006, reading: 0.0001, pressure: 500, spine_length: 0.001, spine_stiffness: 0.02, turn: 0.0005}

Which ids, parameters and units there are is known to a catalogue of effects alone: `model.effects.nominal` checks them.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, FiniteFloat, model_validator

from model.arrays import Array
from model.plain_yaml import FileTable

AREA_FACTOR = "area_factor"
"""Stands for robot.yaml's area factor among the parameters of a posterior."""
LEAST_EIGENVALUE = 1e-9
"""Of a matrix of correlations: with less, some combination of the parameters would be known exactly."""

Name = Annotated[str, Field(min_length=1, max_length=100)]
Deviation = Annotated[FiniteFloat, Field(ge=0, le=1)]
Correlation = Annotated[FiniteFloat, Field(ge=-1, le=1)]
Ends = tuple[FiniteFloat, FiniteFloat]
"""Lowest and highest."""


class Stated(FileTable):
    """One parameter of an effect."""

    model_config = ConfigDict(coerce_numbers_to_str=True)

    value: FiniteFloat
    sd: FiniteFloat = Field(default=0.0, ge=0)
    """Standard deviation; 0: exact."""
    unit: str = Field(max_length=40)
    """That of `lab effects --json`, '1' for none."""


Table = dict[Name, dict[Name, Stated]]
"""Effect (or tolerance) -> parameter -> what is stated of it."""


class Noise(FileTable):
    """Standard deviations between repeats of a state, by their origin."""

    floor: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "m"})
    """rms distance of a tip reading from the mean of its repeats."""
    reading: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "m"})
    """Of a reading of the tip along each axis, robot at rest."""
    reading_by_axis: tuple[Deviation, Deviation, Deviation] | None = Field(default=None, json_schema_extra={"unit": "m"})
    """The same along x, y and z, where repeats tell."""
    pressure: FiniteFloat = Field(default=0.0, ge=0, le=1e6, json_schema_extra={"unit": "Pa"})
    """Of the chambers' pressure from the regulator's reading."""
    spine_length: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "m"})
    """Of the length to which a spine grows."""
    spine_stiffness: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "1"})
    """Of its stiffness between jammings, as a share."""
    turn: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "rad"})
    """Of the base about each axis between mountings."""
    shift: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "m"})
    """Of the base along each axis between mountings."""


class Posterior(FileTable):
    """Correlations of what a fit leaves uncertain, and its other errors."""

    parameters: tuple[Name, ...] = Field(min_length=1, max_length=200)
    """area_factor, or EFFECT.PARAMETER of `effects` or `tolerances`; one that is stated in neither is ignored."""
    area_factor_sd: FiniteFloat = Field(default=0.0, ge=0, json_schema_extra={"unit": "1"})
    correlation: tuple[tuple[Correlation, ...], ...] = Field(min_length=1, max_length=200, json_schema_extra={"unit": "1"})
    """Lower triangle with diagonal, in the order of `parameters`."""
    law_error: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "1"})
    """Model-form error, as a share of what each effect does."""
    discrepancy: FiniteFloat = Field(default=0.0, ge=0, le=1, json_schema_extra={"unit": "m"})
    """Standard deviation along each axis of what no effect describes."""
    fitted_pressure: Ends | None = Field(default=None, json_schema_extra={"unit": "Pa"})
    """Lowest and highest of an actuator in the states fitted; predictions beyond extrapolate."""
    fitted_spine_length: Ends | None = Field(default=None, json_schema_extra={"unit": "m"})
    """Likewise."""
    fitted_tip_mass: Ends | None = Field(default=None, json_schema_extra={"unit": "kg"})
    """Likewise."""
    noise: Noise = Noise()

    @model_validator(mode="after")
    def _is_a_correlation(self) -> Posterior:
        """Refuse names that repeat and what is no positive definite lower triangle with ones on its diagonal."""
        k = len(self.parameters)
        if twice := [name for name in self.parameters if self.parameters.count(name) > 1]:
            raise ValueError(f"parameters: {twice[0]} stands there twice")
        lengths = [len(row) for row in self.correlation]
        if lengths != list(range(1, k + 1)):
            raise ValueError(
                f"correlation: rows of {lengths[:8]} numbers, must be a lower triangle of {k} rows with 1, 2 .. {k} numbers, "
                "as there are parameters"
            )
        bad = [i for i, row in enumerate(self.correlation) if row[-1] != 1]
        if bad:
            raise ValueError(f"correlation: {self.correlation[bad[0]][-1]:g} of {self.parameters[bad[0]]} with itself, must be 1")
        smallest = float(np.linalg.eigvalsh(self.matrix).min())
        if smallest < LEAST_EIGENVALUE:
            raise ValueError(
                f"correlation: not positive definite (least eigenvalue {smallest:.2g}, must be at least {LEAST_EIGENVALUE:g}): "
                "let lab fit write it again, or leave parameters out"
            )
        return self

    @property
    def matrix(self) -> Array:
        """(k, k) correlations."""
        out = np.eye(len(self.parameters))
        for i, row in enumerate(self.correlation):
            out[i, : len(row)] = out[: len(row), i] = row
        return out


class Residual(FileTable):
    """Gaussian process of what the model misses, learnt from a campaign (`model.prediction.residual`)."""

    amplitude: FiniteFloat = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    """Standard deviation along each axis far from all states."""
    pressure_scale: FiniteFloat = Field(gt=0, le=1e9, json_schema_extra={"unit": "Pa"})
    """Scale over the pressures in `learnt`."""
    length_scale: FiniteFloat = Field(gt=0, le=1e3, json_schema_extra={"unit": "m"})
    """Scale over the spine's length."""
    trial: FiniteFloat = Field(ge=0, le=1, json_schema_extra={"unit": "m"})
    """Standard deviation along each axis between trials."""
    reading: FiniteFloat = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    """The same between readings of a trial."""
    learnt: tuple[tuple[FiniteFloat, ...], ...] = Field(min_length=1, max_length=1000)
    """States: trial; pressure of each actuator, Pa; spine length, m; measured minus predicted x, y, z, m."""


def problems(effects: Table, tolerances: Table, posterior: Posterior | None, area_is_number: bool) -> list[str]:
    """One line for each contradiction between effects, tolerances and posterior."""
    issues = [f"{both}: stands in effects and in tolerances, keep one" for both in sorted(set(effects) & set(tolerances))]
    issues += [
        f"{key}.{id}: states no parameter, leave it out"
        for key, table in (("effects", effects), ("tolerances", tolerances))
        for id, values in table.items()
        if not values
    ]
    if posterior is None:
        return issues
    stated = named(effects, tolerances)
    for name in posterior.parameters:
        if name == AREA_FACTOR:
            if not area_is_number:
                issues.append("posterior.parameters: area_factor must be a number, not a table, to have a posterior")
            elif not posterior.area_factor_sd > 0:
                issues.append("posterior.area_factor_sd = 0: must be above 0 where area_factor is among the parameters")
        elif name in stated and not stated[name].sd > 0:
            issues.append(f"{name}: sd = 0 {stated[name].unit}, must be above 0 for a parameter of the posterior")
    return issues


def named(*tables: Table) -> dict[str, Stated]:
    """EFFECT.PARAMETER -> what is stated of it."""
    return {f"{id}.{name}": p for table in tables for id, own in table.items() for name, p in own.items()}
