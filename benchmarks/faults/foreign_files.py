"""Eleven tables as other laboratories write them, mutated, and everything that `lab import` does with each."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.edits.reading import read as judged
from lab.files.config import ConfigError, load
from lab.files.map_file import Map, Source
from lab.imports.formats import read
from lab.imports.guess import guess_map
from lab.imports.proposal import guess_text
from lab.imports.table import imported
from model.robot import Robot

from .foreign_tables import BARE, HEADINGS, UNITS, comma, sweep, text
from .text_files import either, mutated_bytes

ROBOT = Path(__file__).parent.parent.parent / "examples" / "three_chambers" / "robot.yaml"
EPOCH = 1_709_290_000
CELLS = (
    "", "NA", "n/a", "--", "#N/A", "Inf", "-1e400", "9999", "1,5", "1.234,5", "1 234", "12:61:99", "2024-13-45", "2024-03-01",
    "1e308", "0", "-0", "9" * 400, "\u0663", "50 kPa", "12 mm", '"', "=1+1", "TRUE", "O.5", "1.2.3", "[mm]", "Tip X [mm]", "\0",
)  # fmt: skip
"""What stands in a cell where nobody expects it."""
LABVIEW = "LabVIEW Measurement\t\nSeparator\tTab\nDate\t2024/03/01\n***End_of_Header***\t\n\t\nChannels\t6\t\t\t\t\t\t\t\n"
MOTIVE = "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,2.5,Rotation Type,Quaternion,Length Units,Millimeters\n\n"


def binary_files(folder: Path) -> dict[str, bytes]:
    """Sound binary tables by the name of their file."""
    import c3d
    import pandas as pd
    from scipy.io import savemat

    rows = np.array(sweep(3, 0.4))
    savemat(folder / "t.mat", {"t": rows[:, :1], "p": rows[:, 1:4], "log": {"tip": rows[:, 4:], "by": "Anna"}})
    pd.DataFrame(rows, columns=list(HEADINGS)).to_parquet(folder / "t.parquet")
    writer = c3d.Writer(point_rate=2.5, analog_rate=2.5, point_scale=-1.0, point_units="mm  ")
    writer.set_point_labels(["Tip"])
    writer.set_analog_labels(["Pressure1", "Pressure2", "Pressure3"])
    for row in rows:
        writer.add_frames([(np.array([[*row[4:], 0, 0]]), row[1:4, None])])
    with warnings.catch_warnings(), open(folder / "t.c3d", "wb") as file:
        warnings.simplefilter("ignore")
        writer.write(file)
    return {name: (folder / name).read_bytes() for name in ("t.mat", "t.parquet", "t.c3d")}


def text_tables() -> dict[str, bytes]:
    """Sound text tables by the name of their file."""
    rows = sweep(3, 0.4)
    german = ["Zeit [s]", *(f"Druck {i} [kPa]" for i in (1, 2, 3)), *(f"Spitze {a} [mm]" for a in "XYZ")]
    body = [*(f"Rotation {a}" for a in "XYZW"), *(f"Position {a}" for a in "XYZ")]
    motive = [["", "Name", *["Tip"] * 7], ["", "", *(b.split()[0] for b in body)], ["Frame", "Time", *(b[-1] for b in body)]]
    pose = text(rows, headings=(), change=lambda k, c: [str(k), c[0], "0", "0", "0", "1", *c[4:]])
    vicon = "Trajectories\n2.5\n,,,,,Rig:Tip,,\nFrame,Time,P1,P2,P3,X,Y,Z\n,s,kPa,kPa,kPa,mm,mm,mm\n"
    named = ["rep", "chambers", "Roll", "Pitch", "Yaw"]
    counted = text(rows, ";", [*HEADINGS, *named], lambda k, c: [*c, str(1 + k // 45), "ABC"[k // 15 % 3], c[5], c[4], "0"])
    return {
        "counted.csv": counted.encode(),
        "spreadsheet.csv": ("Ger\xe4t;7\n" + text(rows, ";", german, lambda k, c: comma(c, *range(7)))).encode("latin-1"),
        "units.csv": (",".join(BARE) + "\n" + text(rows, ",", UNITS) + "END\n").encode(),
        "labview.lvm": (LABVIEW + text(rows, "\t", [*HEADINGS, "Comment"])).encode(),
        "motive.csv": (MOTIVE + "".join(",".join(line) + "\n" for line in motive) + pose).encode(),
        "vicon.csv": (vicon + text(rows, headings=(), change=lambda k, c: [str(k), *c])).encode(),
        "log.csv": text(rows, headings=["stamp", *BARE[1:]], change=lambda k, c: [str(EPOCH * 1000 + 400 * k), *c[1:]]).encode(),
        "wide.txt": text(rows, "\t", change=lambda k, c: c if k % 9 else [*c[:4], "n/a", "--", ""]).encode("utf-16"),
    }  # fmt: skip


def _one_cell(data: bytes, rng: random.Random) -> bytes:
    """One to five cells of a table changed, moved or cut off."""
    lines = data.split(b"\n")
    mark = max((b"\t", b";", b","), key=data.count)
    for _ in range(rng.randint(1, 5)):
        i = rng.randrange(len(lines))
        cells = lines[i].split(mark)
        k = rng.randrange(len(cells))
        match rng.randrange(5):
            case 0 | 1:
                cells[k] = rng.choice(CELLS).encode("utf-8")
            case 2:
                cells.insert(k, cells[rng.randrange(len(cells))])
            case 3:
                del cells[k]
            case _:
                cells = [rng.choice(CELLS).encode("utf-8") for _ in cells]
        lines[i] = mark.join(cells)
    return b"\n".join(lines)


def foreign_tables(folder: Path) -> Callable[[random.Random], Callable[[], object]]:
    """A function that mutates one of the eleven tables, and returns what proposes its map and imports it."""
    texts, robot = text_tables(), load(ROBOT, Robot)
    sound = texts | binary_files(folder)
    maps: dict[str, Any] = {}
    for name, data in sound.items():
        (folder / name).write_bytes(data)
        series = read(folder / name, Source())
        place = folder / f"{name}.yaml"
        place.write_text(guess_text(guess_map(series, robot), ROBOT, [folder / name], series.form), encoding="utf-8")
        with suppress(ConfigError):  # of a file without pressures
            maps[name] = load(place, Map)

    def every_way(place: Path) -> None:
        if place.name in maps:
            with suppress(ConfigError):
                judged(robot, imported([place], maps[place.name], robot).table)
        series = read(place, Source())
        proposed = folder / "proposed.yaml"
        proposed.write_text(guess_text(guess_map(series, robot), ROBOT, [place], series.form), encoding="utf-8")
        imported([place], load(proposed, Map), robot)

    def go(rng: random.Random) -> Callable[[], object]:
        name = rng.choice(sorted(sound))
        data = sound[name]
        if name not in texts:
            data = mutated_bytes(data, rng)
        elif rng.random() < 0.6:
            data = _one_cell(data, rng)
        else:
            data = either(data, rng) if name not in ("wide.txt", "spreadsheet.csv") else mutated_bytes(data, rng)
        (folder / name).write_bytes(data)
        return partial(every_way, folder / name)

    return go
