"""The arm segment of diffPD_sim2real (blackframe_25mbarIntervals.npy) as a case folder.

    python examples/sopra_segment/import_sopra_segment.py PATH/TO/folder --out case

The file holds 15 pressure steps x 150 frames (100 Hz) x 7 markers (4 at the base, 3 at the tip), m; one chamber is inflated
from ambient at the start of each step. What is done to it, and nothing else:
- each step is a trial of two states: its first frame (ambient pressure) and the mean of its last 10 frames;
- the tip is the middle of its three markers, against the middle of the base's four; its turn is the rotation that fits them;
- frame: z along the cameras' x (from base to tip), x and y their y and z; the very first frame counts as straight.
The .npy is a pickled table: read only files you trust.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recordings.table_file import write_csv
from recordings.trials import Table, TrialRow

Array = NDArray[np.float64]

BASE, TIP = slice(0, 4), slice(4, 7)
TO_ROBOT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Cameras' frame -> z along the segment."""
LENGTH = 0.100
AVERAGED = 10
RATE_HZ = 100.0
STEP_SECONDS = 10.0
"""Between steps the time is not known; they are put this far apart."""


def states(file: Path) -> list[TrialRow]:
    """Two states a step; raises ValueError when the file is another one."""
    table: dict[str, Any] = np.load(file, allow_pickle=True).item()
    markers: Array = np.asarray(table["data"], float) @ TO_ROBOT.T
    if markers.ndim != 4 or markers.shape[2] != 7:
        raise ValueError(f"{file}: markers of shape {markers.shape}, expected (steps, frames, 7, 3)")
    centre = markers[:, :, TIP].mean(axis=2) - markers[:, :, BASE].mean(axis=2)
    at_rest, spread = centre[0, 0], markers[0, 0, TIP] - markers[0, 0, TIP].mean(axis=0)
    rows = []
    for step, (mbar, path) in enumerate(zip(np.ravel(table["p"]), centre, strict=True), 1):
        for number, (pressure, frames) in enumerate(
            ((0.0, slice(0, 1)), (100.0 * float(mbar), slice(-AVERAGED, None))), 1
        ):
            moved = path[frames] - at_rest
            held = markers[step - 1, frames][:, TIP].mean(axis=0)
            turn, _ = Rotation.align_vectors(held - held.mean(axis=0), spread)
            q = turn.as_quat(canonical=True, scalar_first=True)
            tip = moved.mean(axis=0) + np.array([0.0, 0.0, LENGTH])
            frame = 0 if number == 1 else len(path) - AVERAGED / 2
            sd = dict(zip("xyz", moved.std(axis=0, ddof=1).tolist(), strict=True)) if len(moved) > 1 else {}
            rows.append(
                TrialRow(
                    trial=step, step=number, protocol="bending", repeat=1, branch="load",
                    t=(step - 1) * STEP_SECONDS + frame / RATE_HZ, hold=frame / RATE_HZ if number == 2 else 1.0,
                    spine_length=0.0, tip_mass=0.0, roll_deg=0.0, pressures=(pressure, 0.0, 0.0, 0.0),
                    tip=(float(tip[0]), float(tip[1]), float(tip[2])),
                    orientation=(float(q[0]), float(q[1]), float(q[2]), float(q[3])), sd=sd,
                )
            )  # fmt: skip
    return rows


def main() -> None:
    """Write the case folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder that holds blackframe_25mbarIntervals.npy")
    parser.add_argument("--out", type=Path, default=Path("sopra-segment"), help="case folder to write")
    a = parser.parse_args()
    rows = states(a.data / "blackframe_25mbarIntervals.npy")
    a.out.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).parent / "robot.yaml", a.out)
    write_csv(Table(tuple(rows)), a.out / "trials.csv")
    print(f"{len(rows)} states, {rows[-1].trial} trials in {a.out}; now: lab diagnose {a.out}")


if __name__ == "__main__":
    main()
