"""The clamped silicone beam of diffPD_sim2real (beam_*.c3d) as a case folder.

    python examples/silicone_beam/import_silicone_beam.py PATH/TO/folder --out case

Six recordings at 100 Hz: no load, 52 g and 102 g at the tip, twice each. The beam is held level, let go, and comes to rest.
What is done to them, and nothing else:
- the tip is the middle of the markers Tip-1..3 (the first three), against the middle of the base's; its way from the first
  frame to the mean of the last 50 is added to a straight beam;
- frame: z along the beam, x up (the weight acts along -x), as recorded;
- each recording gives one row with its tip mass (what the model can be compared with) and, where a weight hangs on it, one
  stiffness row: that weight against the deflection beyond that of the beam's own weight.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent))
from c3d_points import read_points  # noqa: E402

from recordings.table_file import write_csv  # noqa: E402
from recordings.trials import Table, TrialRow  # noqa: E402

LOADS = {"gravity": 0.0, "load52": 0.510, "load101": 1.0006}
"""N at the tip, by file name."""
REPEATS = ("a", "b")
LENGTH, GRAVITY, RESTING = 0.100, 9.81, 50


def way(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Displacement (3) m of the tip from the first frame to rest, its standard deviation there, and the recording's length, s."""
    rate, points = read_points(file)
    centre = points[:, :3].mean(axis=1) - points[:, 3:].mean(axis=1)
    # in these files the base follows the tip; whichever set moves is the tip
    if np.ptp(points[:, 3:], axis=0).max() > np.ptp(points[:, :3], axis=0).max():
        centre = -centre
    rest = centre[-RESTING:]
    return rest.mean(axis=0) - centre[0], rest.std(axis=0, ddof=1), len(points) / rate


def rows(folder: Path) -> list[TrialRow]:
    """Six tip rows and four stiffness rows."""
    out: list[TrialRow] = []
    for repeat, letter in enumerate(REPEATS, 1):
        ways = {name: way(folder / f"beam_{name}_V2_{letter}.c3d") for name in LOADS}
        for name, force in LOADS.items():
            moved, sd, seconds = ways[name]
            tip = moved + np.array([0.0, 0.0, LENGTH])
            trial = len(out) + 1
            out.append(
                TrialRow(
                    trial=trial, step=1, protocol="bending", repeat=repeat, branch="load", t=60.0 * trial, hold=seconds,
                    spine_length=0.0, tip_mass=force / GRAVITY, roll_deg=0.0, pressures=(0.0,),
                    tip=(float(tip[0]), float(tip[1]), float(tip[2])), sd=dict(zip("xyz", sd.tolist(), strict=True)),
                )
            )  # fmt: skip
        trial = len(out) + 1
        for step, (name, force) in enumerate(((n, f) for n, f in LOADS.items() if f > 0), 1):
            deflection = float(ways["gravity"][0][0] - ways[name][0][0])
            out.append(
                TrialRow(
                    trial=trial, step=step, protocol="stiffness", repeat=repeat, branch="load", t=60.0 * trial + step,
                    spine_length=0.0, pressures=(0.0,), specimen="body", force=force, deflection=deflection,
                )
            )  # fmt: skip
    return out


def main() -> None:
    """Write the case folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder that holds beam_*.c3d")
    parser.add_argument("--out", type=Path, default=Path("silicone-beam"), help="case folder to write")
    parser.add_argument("--only", choices=("bending", "stiffness"), help="just these rows (lab fit: stiffness)")
    a = parser.parse_args()
    found = [r for r in rows(a.data) if a.only in (None, r.protocol)]
    a.out.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).parent / "robot.yaml", a.out)
    write_csv(Table(tuple(found)), a.out / "trials.csv")
    print(f"{len(found)} rows in {a.out}; now: lab diagnose {a.out} (lab fit takes the stiffness rows alone)")


if __name__ == "__main__":
    main()
