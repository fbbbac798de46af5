"""What another simulator predicts of a case: a baseline in the rod's place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Array, Ints


@dataclass(frozen=True)
class Baseline:
    """Predictions of n states, in the order of the case's table; SI, base frame, NaN where there is none."""

    name: str
    """Of the simulator, or of the file of its predictions."""
    spine_length: Array
    """(n,) m, of the state that was predicted; it may differ a little from the measured one."""
    pressure: Array
    """(n, chambers) Pa gauge, the same."""
    tip: Array
    """(n, 3) m."""
    orientation: Array
    """(n, 4) quaternion w, x, y, z."""
    markers: Array
    """(n, k, 3) m."""
    varied: Mapping[str, tuple[float, Baseline]] = field(default_factory=dict)
    """Parameter -> a small step in its unit, and what the simulator predicts that far from the robot as it is described."""

    def take(self, own: Ints) -> Baseline:
        """The predictions of some states, by their rows in the table (m,)."""
        return replace(
            self, spine_length=self.spine_length[own], pressure=self.pressure[own], tip=self.tip[own],
            orientation=self.orientation[own], markers=self.markers[own],
            varied={name: (step, there.take(own)) for name, (step, there) in self.varied.items()},
        )  # fmt: skip

    def columns(self) -> dict[str, Array]:
        """As columns of a table of trials."""
        pressures = [f"p{i + 1}" for i in range(self.pressure.shape[1])]
        markers = [f"m{k + 1}{axis}" for k in range(self.markers.shape[1]) for axis in "xyz"]
        names = ["spine_length", *pressures, *"xyz", "qw", "qx", "qy", "qz", *markers]
        n = len(self.spine_length)
        values = (self.spine_length[:, None], self.pressure, self.tip, self.orientation, self.markers.reshape(n, -1))
        return dict(zip(names, np.hstack(values).T, strict=True))
