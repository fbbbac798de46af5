"""The STIFF-FLOP recording (NoLoad.mat of TMTDyn, samples "Rods/1. STIFF-FLOP") as a case folder.

    python examples/stiff_flop/import_stiff_flop.py PATH/TO/folder --out case

The file holds 20 Hz rows: time s, three absolute pressures bar, base sensor mm and quaternion, tip sensor mm and quaternion.
What is done to it, and nothing else:
- pressures: minus the first row, times 1.25e5 (its authors' scale from bar to Pa);
- a state is a stretch of at least 0.4 s in which no pressure changes by more than 0.01 bar a sample, averaged;
- the tip sensor sits at the end of a 14.5 mm mount and 14.514 mm beside the axis: moved back by the measured orientation;
- frame: z from base to tip (down), x and y of the tracker; the first state at ambient pressure counts as straight, which
  takes out where the sensors were glued (position and turn).
Each inflation from ambient counts as a trial.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from recordings.table_file import write_csv
from recordings.trials import Table, TrialRow

Array = NDArray[np.float64]

PA_PER_BAR = 1.25e5
STEADY, SHORTEST = 0.01, 0.4
"""bar a sample; s."""
SETTLING = 0.3
"""s left out at the start of a stretch, when it is long enough."""
SENSOR = np.array([0.015 - 0.000486, 0.0, 0.0145])
"""m from the body's end to the tip sensor at rest: beside the axis, and along it (its authors' exp_v0_1.m)."""
BODY_LENGTH = 0.050
PAIRS = ((1, 2), (3, 4), (5, 6))
"""Chambers (of robot.yaml) of the file's first, second and third pressure."""
AMBIENT = 5e3
"""Pa below which a state counts as at ambient pressure."""


def stretches(pressure: Array, t: Array) -> Iterator[slice]:
    """Where all pressures (n, 3) bar stand still."""
    moving = np.abs(np.diff(pressure, axis=0)).max(axis=1) >= STEADY
    edges = [0, *(np.flatnonzero(moving) + 1).tolist(), len(t)]
    for a, b in zip(edges, edges[1:], strict=False):
        if b - a > 1 and t[b - 1] - t[a] >= SHORTEST:
            skip = int(np.searchsorted(t[a:b], t[a] + SETTLING)) if t[b - 1] - t[a] > SHORTEST + SETTLING else 0
            yield slice(a + skip, b)


def states(file: Path) -> list[TrialRow]:
    """The settled states; raises ValueError when the file is another one."""
    data = loadmat(file).get("NoLoad")
    if data is None or data.shape[1] != 18:
        raise ValueError(f"{file}: holds no table NoLoad of 18 columns; take NoLoad.mat of the STIFF-FLOP sample")
    t, bar = data[:, 0], data[:, 1:4] - data[0, 1:4]
    base, tip = data[:, 4:7] * 1e-3, data[:, 11:14] * 1e-3
    turned = Rotation.from_quat(data[:, 14:18], scalar_first=True)
    found = list(stretches(bar, t))
    straight = turned[found[0]].mean()
    sensor_at_rest = (tip - base)[found[0]].mean(axis=0)
    rows: list[TrialRow] = []
    trial, step, resting = 0, 0, False
    for own in found:
        pressure = bar[own].mean(axis=0) * PA_PER_BAR
        at_rest = bool(pressure.max() < AMBIENT)
        if not rows or (at_rest and not resting):
            trial, step = trial + 1, 0
        resting, step = at_rest, step + 1
        rotation = turned[own].mean() * straight.inv()
        moved = (tip - base)[own] - sensor_at_rest
        # the sensor's displacement holds the end's, and the lever between them
        lever = rotation.apply(SENSOR) - SENSOR
        end = np.array([0.0, 0.0, BODY_LENGTH]) + moved.mean(axis=0) - lever
        q = rotation.as_quat(canonical=True, scalar_first=True)
        chambers = np.zeros(6)
        for value, pair in zip(pressure, PAIRS, strict=True):
            chambers[[c - 1 for c in pair]] = value
        rows.append(
            TrialRow(
                trial=trial, step=step, protocol="bending", repeat=1, branch="load", t=float(t[own].mean()),
                hold=float(np.ptp(t[own]) / 2), spine_length=0.0, tip_mass=0.01347, roll_deg=0.0,
                pressures=tuple(float(p) for p in chambers), tip=(float(end[0]), float(end[1]), float(end[2])),
                orientation=(float(q[0]), float(q[1]), float(q[2]), float(q[3])),
                sd=dict(zip("xyz", moved.std(axis=0, ddof=1).tolist(), strict=True)),
            )
        )  # fmt: skip
    return rows


def main() -> None:
    """Write the case folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder that holds NoLoad.mat")
    parser.add_argument("--out", type=Path, default=Path("stiff-flop"), help="case folder to write")
    a = parser.parse_args()
    rows = states(a.data / "NoLoad.mat")
    a.out.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).parent / "robot.yaml", a.out)
    write_csv(Table(tuple(rows)), a.out / "trials.csv")
    print(f"{len(rows)} states, {rows[-1].trial} trials in {a.out}; now: lab diagnose {a.out}")


if __name__ == "__main__":
    main()
