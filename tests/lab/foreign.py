"""Files of other programs for tests of `lab import`: read by the map that is proposed for them, or by one of the test's own."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lab.files.config import load, read_yaml
from lab.files.map_file import Source, map_of
from lab.imports.formats import read
from lab.imports.guess import guess_map
from lab.imports.proposal import Guess, guess_text
from lab.imports.table import Imported, imported
from model.robot import Robot
from recordings.trials import Table

ROBOT = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"
OWN_TABLE = Path(__file__).parents[2] / "examples/own_table"
AZIMUTHS = np.radians([0.0, 120.0, 240.0])
"""Of its chambers."""


def guessed(file: Path) -> tuple[Guess, Path]:
    """The map proposed for a file, and where it was written."""
    series = read(file, Source())
    made = guess_map(series, load(ROBOT, Robot))
    place = file.parent / "map.yaml"
    place.write_text(guess_text(made, ROBOT, [file], series.form), encoding="utf-8")
    return made, place


def by_map(files: Path | list[Path], /, **values: Any) -> Imported:
    """The files by a map that says this; without any, by map.yaml next to the first file."""
    files = files if isinstance(files, list) else [files]
    place, robot = files[0].parent / "map.yaml", load(ROBOT, Robot)
    if values:
        place.write_text(yaml.safe_dump(values))
    return imported(files, map_of(read_yaml(place), robot.actuators.words), robot)


def through(file: Path, content: str | bytes | None = None) -> tuple[Guess, Imported]:
    """A file (with this content) by the map that is proposed for it."""
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return guessed(file)[0], by_map(file)


def plain(**columns: object) -> dict[str, Any]:
    """What a map says of columns that are read in the unit of their heading, name -> heading."""
    return {name: {"column": column} for name, column in columns.items()}


def tips(table: Table) -> np.ndarray:
    """(n, 3) mm."""
    return np.column_stack([table[a] for a in "xyz"]) * 1e3


def pressures(table: Table) -> np.ndarray:
    """(n, 3) kPa."""
    return np.column_stack([table[f"p{i}"] for i in (1, 2, 3)]) / 1e3
