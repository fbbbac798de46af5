"""A fitted number with its standard error, and how the standard error is found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from model.arrays import Array
from model.errors import BadCondition, NotIdentified


@dataclass(frozen=True)
class Estimate:
    """A fitted value in SI units."""

    value: float
    standard_error: float
    dof: int
    """Degrees of freedom behind the standard error."""
    n: int
    """Readings used."""
    rms_residual: float
    """In the unit of the readings."""

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval (Student's t)."""
        half = float(stdtrit(self.dof, 0.975)) * self.standard_error
        return self.value - half, self.value + half

    def as_dict(self) -> dict[str, float]:
        """JSON-able, with the ends of the 95 % interval."""
        low, high = self.interval
        return {"value": self.value, "standard_error": self.standard_error, "low95": low, "high95": high, "n": self.n}

    def scaled(self, factor: float) -> Estimate:
        """The same knowledge about `factor` times the value; the residual stays in the unit of the readings."""
        return Estimate(factor * self.value, abs(factor) * self.standard_error, self.dof, self.n, self.rms_residual)


def estimate(
    value: float, sensitivity: Array, residual: Array, fitted: int, trial: NDArray[np.generic] | None = None
) -> Estimate:
    """Standard error of one least-squares parameter.

    `sensitivity` (n,) is d(prediction)/d(value) with all other fitted numbers projected out, `residual` (n,) measured minus
    predicted, `fitted` how many numbers were fitted. With `trial` (n,) of at least three trials the readings of one trial may err
    together (cluster-robust form with its small-sample factor); otherwise each reading is taken to err alone. Raises
    `NotIdentified` when the readings do not depend on the value or are too few.
    """
    n = residual.size
    if n <= fitted:
        raise NotIdentified(f"{n} readings for {fitted} fitted numbers: at least {fitted + 1} are needed")
    information = float(sensitivity @ sensitivity)
    if not information > 0:
        raise NotIdentified("the readings do not depend on the fitted value: vary the pressure or the deflection")
    rms = float(np.sqrt(np.mean(residual**2)))
    score = sensitivity * residual
    names = np.unique(trial) if trial is not None else np.zeros(0)
    # the scatter between trials sets the standard error; that of two says nothing
    if trial is not None and names.size >= 3:
        total = sum(float(score[trial == name].sum()) ** 2 for name in names)
        small_sample = names.size / (names.size - 1)
        return Estimate(value, float(np.sqrt(small_sample * total)) / information, names.size - 1, n, rms)
    variance = float(residual @ residual) / (n - fitted)
    return Estimate(value, float(np.sqrt(variance / information)), n - fitted, n, rms)


def readings(n: int, width: int | None = None, **columns: ArrayLike) -> dict[str, Array]:
    """The columns as finite float arrays (n, ..), or (n, width); raises `BadCondition` naming a column that is not."""
    checked = {}
    for name, column in columns.items():
        values = np.asarray(column, float)
        if values.shape[:1] != (n,) or (width is not None and values.shape != (n, width)):
            wanted = f"have {n} rows" if width is None else f"be ({n}, {width})"
            raise BadCondition(f"{name}: shape {values.shape}, must {wanted}")
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise BadCondition(f"{name}: row {row} is not finite: drop the rows that were not measured")
        checked[name] = values
    return checked
