"""A campaign like the paper's, as the columns of a trials table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]
LEVELS = (50e3, 100e3, 150e3, 200e3, 250e3)


def campaign(
    lengths: Sequence[float] = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30),
    levels: Sequence[float] = LEVELS,
    unload: bool = True,
    zero: bool = True,
    repeats: int = 1,
    rate: float = 25e3,
    hold: float = 2.0,
    chambers: Sequence[int] = (9, 1, 2),
    **same: float,
) -> Columns:
    """One trial a spine length and repeat: levels up and down; `same` sets a whole column (roll_deg, tip_mass ..)."""
    up = [(p, "load") for p in ([0.0] if zero else []) + list(levels)]
    down = [(p, "unload") for p in list(levels)[-2::-1] + ([0.0] if zero else [])]
    rows: list[dict[str, Any]] = []
    time = 0.0
    for repeat in range(repeats):
        for length in lengths:
            trial, last = len({row["trial"] for row in rows}) + 1, 0.0
            time += 100.0
            for step, (pressure, branch) in enumerate(up + (down if unload else [])):
                time += abs(pressure - last) / rate + hold
                last = pressure
                cells = {f"p{c}": pressure if c in chambers else 0.0 for c in range(1, 10)}
                cells |= dict.fromkeys(("x", "y", "z", "qx", "qy", "qz"), 0.0) | {"qw": 1.0}
                rows.append(
                    {
                        "trial": trial,
                        "step": step,
                        "protocol": "bending",
                        "repeat": repeat + 1,
                        "branch": branch,
                        "t": time,
                        "rate": rate,
                        "hold": hold,
                        "spine_length": length,
                        "vacuum": 80e3,
                        **cells,
                        **same,
                    }  # fmt: skip
                )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.fixture(scope="session")
def make_campaign() -> Callable[..., Columns]:
    return campaign
