"""Make sweep.csv: the finger as it is, with its chambers turned by 8 deg, as another lab's program would write it.

Cameras look from the side (y is up) and have their origin 0.8 m away; lengths are in mm, pressures in kPa, angles in deg; a
row of units follows the headings; four positions of the tip were hidden.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import lab
from model.stated import Stated

HERE = Path(__file__).parent
TURNED = math.radians(8.0)
LEVELS = (0, 20, 40, 60, 40, 20, 0)
GROUPS = ((1,), (2,), (3,), (1, 2), (2, 3), (3, 1))
HEADS = ("time", "rep", "chambers", "p1", "p2", "p3", "tip x", "tip y", "tip z", "Roll", "Pitch", "Yaw")
UNITS = ("s", "-", "-", "kPa", "kPa", "kPa", "mm", "mm", "mm", "deg", "deg", "deg")
AWAY = (800.0, 1200.0, -350.0)
"""Of the base in the cameras' frame, mm."""
TO_CAMERAS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""x stays; the robot's axis points along the cameras' -y."""
HIDDEN = (17, 44, 45, 101)


def main() -> None:
    """Write sweep.csv beside this file."""
    dice = np.random.default_rng(3)
    robot = lab.load_robot(HERE / "robot.yaml")
    turned = robot.model_copy(update={"effects": {"chamber_azimuth": {"angle": Stated(value=TURNED, unit="rad")}}})
    rows = [(repeat, group, level) for repeat in (1, 2, 3) for group in GROUPS for level in LEVELS]
    pressures = np.array([[1e3 * level if c in group else 0.0 for c in (1, 2, 3)] for _, group, level in rows])
    found = turned.predict(pressures)
    tip = 1e3 * found.tip @ TO_CAMERAS.T + AWAY + dice.normal(0, 0.15, (len(rows), 3))
    turned_by = TO_CAMERAS @ Rotation.from_quat(found.orientation[:, [1, 2, 3, 0]]).as_matrix() @ TO_CAMERAS.T
    turns = Rotation.from_matrix(turned_by).as_euler("xyz", degrees=True)
    turns += dice.normal(0, 0.1, turns.shape)
    read = pressures / 1e3 + dice.normal(0, 0.05, pressures.shape)
    with (HERE / "sweep.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(HEADS)
        table.writerow(UNITS)
        for k, (repeat, group, _) in enumerate(rows):
            seen = ["", "", ""] if k in HIDDEN else [f"{value:.2f}" for value in tip[k]]
            of = "+".join(map(str, group))
            pressure = [f"{value:.2f}" for value in read[k]]
            table.writerow([f"{12.0 * k:.1f}", repeat, of, *pressure, *seen, *(f"{a:.2f}" for a in turns[k])])


if __name__ == "__main__":
    main()
