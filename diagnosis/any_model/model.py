"""A person's forward function as the forward model of a problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..arrays import Array, Mask
from ..errors import BadCase
from ..inference.problem import FitForward
from .cause import Parameter

Predict = Callable[[dict[str, float], pd.DataFrame], Any]
DIFFERENCE = 0.01
"""Step of one-sided differences, plausible sizes: far above the rounding of an integrator, far below the size."""
REMEMBERED = 20_000_000
"""Predicted values that are kept, as searches ask for the same predictions again."""

MOST = 1e30
"""Values from which a prediction has diverged, and counts as none."""


class Model(FitForward):
    """`predict` over the rows of a table; the forward model of the measured values, row by row."""

    def __init__(
        self, predict: Predict, inputs: pd.DataFrame, outputs: Sequence[str], parameters: Sequence[Parameter], kept: Mask,
        nominal: Mapping[str, float],
    ) -> None:  # fmt: skip
        """`kept` (rows, outputs) marks the measured values; `nominal` has the parameters that are not fitted, too."""
        self._predict, self.inputs, self._outputs, self._parameters = predict, inputs, tuple(outputs), tuple(parameters)
        self.kept, self._nominal = kept, nominal
        self._known, self._slopes = dict[bytes, Array](), dict[bytes, Mapping[str, Array]]()

    def of(self, inputs: pd.DataFrame) -> Model:
        """The same function over other inputs, of which every value counts."""
        every = np.ones((len(inputs), len(self._outputs)), bool)
        return Model(self._predict, inputs, self._outputs, self._parameters, every, self._nominal)

    def by(self, parameters: Sequence[Parameter], kept: Mask | None = None) -> Model:
        """The same by other parameters, or of other values; both remember the same predictions."""
        kept = self.kept if kept is None else kept
        other = Model(self._predict, self.inputs, self._outputs, parameters, kept, self._nominal)
        other._known, other._slopes = self._known, self._slopes
        return other

    def values(self, theta: Array) -> dict[str, float]:
        """The function's own parameters at differences from nominal (k,)."""
        return {**self._nominal, **{p.key: p.nominal + float(x) for p, x in zip(self._parameters, theta, strict=True)}}

    def table(self, theta: Array) -> Array:
        """(rows, outputs) predicted. Raises `BadCase` where the function raises or returns another shape."""
        at = np.array([*self.values(theta).values()]).tobytes()
        if at not in self._known:
            if len(self._known) * self.kept.size >= REMEMBERED:
                self._known.pop(next(iter(self._known)))
            self._known[at] = self._asked(theta)
        return self._known[at]

    def _asked(self, theta: Array) -> Array:
        """(rows, outputs) from the function."""
        values, shape = self.values(theta), (len(self.inputs), len(self._outputs))
        try:
            with np.errstate(all="ignore"):
                returned = self._predict(dict(values), self.inputs.copy())
        except Exception as error:
            shown = ", ".join(f"{k}={v:.6g}" for k, v in values.items())
            raise BadCase(f"predict raised {type(error).__name__}: {error} at {shown}; it must answer there") from error
        try:
            if isinstance(returned, Mapping | pd.DataFrame) and {*self._outputs} <= {*returned}:
                returned = np.transpose([returned[name] for name in self._outputs])
            answer = np.asarray(returned, float)
        except (TypeError, ValueError):
            raise BadCase(f"predict returned {type(returned).__name__}, must be an array of numbers {shape}") from None
        if answer.shape == shape[:1] and shape[1] == 1:
            answer = answer[:, None]
        if answer.shape != shape:
            raise BadCase(
                f"predict returned shape {answer.shape}, must be {shape}: a row per row of its inputs, a column per output"
            )
        return answer

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """(n,) the measured values; NaN where the function has no answer."""
        try:
            values = self.table(theta)[self.kept]
            return np.where(np.abs(values) < MOST, values, np.nan)
        except BadCase:
            return np.full(int(self.kept.sum()), np.nan)

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """(n,) the measured values and derivatives (n, c) by some or all parameters: its own, else by differences."""
        chosen, here = range(len(theta)) if columns is None else columns, self.predict(theta)
        slope, offered = np.zeros((len(here), len(chosen))), self.offered(theta) if len(chosen) else {}
        for j, i in enumerate(chosen):
            p = self._parameters[i]
            if p.key in offered:
                slope[:, j] = offered[p.key][self.kept]
                continue
            for step in (DIFFERENCE * p.sd, -DIFFERENCE * p.sd):
                end = float(np.clip(theta[i] + step, p.low, p.high))
                if abs(end - theta[i]) > 0.5 * abs(step):
                    slope[:, j] = (self.predict(np.where(np.arange(len(theta)) == i, end, theta)) - here) / (end - theta[i])
                    if np.isfinite(slope[:, j]).all():
                        break
        return here, slope

    def offered(self, theta: Array) -> Mapping[str, Array]:
        """Parameter -> (rows, outputs), derivatives that the function offers. Raises `BadCase` where they are something else."""
        own, values = getattr(self._predict, "derivatives", None), self.values(theta)
        if own is None:
            return {}
        at = np.array([*values.values()]).tobytes()
        if at not in self._slopes:
            self._slopes.clear()
            try:
                offered = own(values, self.inputs.copy())
                self._slopes[at] = {key: np.asarray(x, float).reshape(self.kept.shape) for key, x in offered.items()}
            except Exception as error:
                text = f"predict.derivatives failed with {type(error).__name__}: {error}"
                raise BadCase(f"{text}; it must return parameter -> array {self.kept.shape}") from error
        return self._slopes[at]
