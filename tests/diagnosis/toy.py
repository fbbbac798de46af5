"""A small world with known answers: tips over spine length, pressure and branch as sums of simple functions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from diagnosis.data.noise import Lasting, Noise
from diagnosis.inference import prepare
from diagnosis.inference.discrepancy import settings, smooth_errors
from diagnosis.inference.problem import FitParameters, Problem
from model.arrays import Array, Ints
from model.effects.parameters import ParameterInfo
from model.effects.tolerance import Group

IDS = ("stiffer", "ballooning", "play", "turned", "offset", "bent", "late")
MM = 1e-3
ROBOT_LENGTH = 0.4


@dataclass(frozen=True)
class Grid:
    """The states of a sweep: 7 spine lengths, 5 pressures up and 4 down, some repeats."""

    repeats: int = 3
    length: Array = field(init=False)
    pressure: Array = field(init=False)
    branch: Array = field(init=False)
    trial: Ints = field(init=False)

    def __post_init__(self) -> None:
        rows = [
            (length, p, b, 7 * r + k + 1)
            for r in range(self.repeats)
            for k, length in enumerate(np.arange(0, 0.301, 0.05))
            for p, b in [*((50e3 * i, 1) for i in range(1, 6)), *((50e3 * i, -1) for i in range(4, 0, -1))]
        ]
        for name, column in zip(("length", "pressure", "branch", "trial"), np.array(rows).T, strict=True):
            object.__setattr__(self, name, column.astype(np.int64) if name == "trial" else column)


def parameter(
    name: str, effect: str = "", sd: float = 1.0, low: float = -np.inf, high: float = np.inf,
    role: Literal["size", "shape"] = "size",
) -> ParameterInfo:  # fmt: skip
    """A parameter of an effect, or a nuisance."""
    group: Group = "effect" if effect else "nuisance"
    return ParameterInfo(name, name, effect or name, group, "1", sd, low, high, "both", role, (0.0,), 0)


def parameters(*infos: ParameterInfo) -> FitParameters:
    return prepare.parameters(infos)


class ToyForward:
    """x, y, z (m) of each state, flattened state by state. Linear but for `ballooning`, which grows with its square."""

    def __init__(self, grid: Grid) -> None:
        length, p, b = grid.length / 0.3, grid.pressure / 250e3, grid.branch
        zero = np.zeros_like(p)
        bend = 100 * MM * p * (1 - 0.5 * length)

        def tip(x: Array, y: Array, z: Array) -> Array:
            return np.column_stack([x, y, z]).ravel()

        self.base = tip(-bend, zero, 0.4 - bend**2)
        effects = {
            "stiffer": tip(6 * MM * p * length**2, zero, MM * p * length),
            "ballooning": tip(-6 * MM * p**3, zero, -MM * p**2),
            "play": tip(2 * MM * b * np.sqrt(p), zero, zero),
            "turned": tip(zero, 5 * MM * p, zero),
            "offset": tip(2 * MM * np.exp(-4 * p), zero, zero),
            "bent": tip(zero, 4 * MM * (1 - length), zero),
            "late": tip(1 * MM * b, zero, zero),
        }
        trials = np.unique(grid.trial)
        per_trial = [tip(2 * MM * p * (grid.trial == t), zero, zero) for t in trials]
        self.slope = np.column_stack([*effects.values(), tip(-bend, zero, zero) * 0.2, *per_trial])
        self.parameters = parameters(
            *(parameter(e, e) for e in IDS), parameter("area"), *(parameter(f"trial {t}", sd=0.1) for t in trials)
        )
        self._square = IDS.index("ballooning")

    def near(self, theta: Array) -> "ToyForward":
        return self

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        return self.linearise(theta)[0]

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        t = theta[self._square]
        slope = self.slope.copy()
        slope[:, self._square] *= 1 + 0.4 * t
        predicted = self.base + self.slope @ theta + 0.2 * t**2 * self.slope[:, self._square]
        return predicted, slope if columns is None else slope[:, list(columns)]


def toy_problem(seed: int, truth: dict[str, float], sd: float = 0.3 * MM, clutter: float = 0.0) -> Problem:
    """A noisy world with some effects of given size (in plausible scales)."""
    rng = np.random.default_rng(seed)
    grid = Grid()
    forward = ToyForward(grid)
    p = forward.parameters
    theta = np.array([truth.get(name, 0.0) for name in p.names])
    theta += np.where(p.of_effect, clutter, p.sd) * rng.normal(size=theta.size) * (theta == 0)
    y = forward.predict(theta) + sd * rng.normal(size=forward.base.size)
    n = len(grid.pressure)
    state, channel = np.repeat(np.arange(n), 3), np.tile(np.arange(3), n)
    where = settings(grid.length, grid.pressure, grid.branch, np.zeros(n), ROBOT_LENGTH)
    smooth = smooth_errors(where, state, np.array(["x", "y", "z"])[channel], sd, ROBOT_LENGTH)
    return Problem(forward, p, y, Noise(state, np.full(y.size, sd), np.zeros((y.size, 1)), Lasting.none(y.size)), smooth)
