"""What each measured value of a problem is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Ints


@dataclass(frozen=True)
class Labels:
    """What each of n measured values is."""

    state: Ints
    """(n,) index into the states."""
    channel: NDArray[np.str_]
    kind: Ints
    """(n,) 0 tip, 1 orientation, 2 marker, 3 force."""
    axis: Ints
    """(n,) which of its kind's three axes; 0 for forces."""
    trial: Ints
    experiment: Ints
    """(n,) kind of experiment, see `Campaign.kind`."""
