"""Inputs of `fit`, `compare` and similar verbs: recordings or case folders, as one table of trials and the robot."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.campaign import settings
from diagnosis.data.case import Case as Measured
from diagnosis.findings import Finding, finding
from model.arrays import Array, Ints
from model.condition import States
from model.robot import Robot
from model.shown import Shown
from recordings.campaign.replay import campaigns, merged
from recordings.file.reader import Recording
from recordings.file.recover import RECOVERED
from recordings.file.verify import verify
from recordings.table_file import read_csv
from recordings.trials import Mapped, Table

from ..console import note
from ..plain import typed
from .config import ConfigError, Source, check, parse_yaml, read_yaml
from .jumps import believed, listed, without_contradicted
from .map_file import stated_map
from .robot_numbers import doubts

CASE = ("robot.yaml", "trials.csv")
TABLES = (
    ".csv", ".tsv", ".txt", ".dat", ".lvm", ".log", ".asc", ".mat", ".npz", ".npy", ".c3d", ".parquet",
)  # fmt: skip
"""Ends of names of tables that other programs wrote."""


@dataclass(frozen=True)
class Case(Measured, Shown):
    """Measured states, `table`, and the `robot` they were measured on."""

    robot_text: str = field(default="", compare=False)
    """robot.yaml as read, to derive another from it; empty if there is none."""

    def __repr__(self) -> str:
        return f"<Case: {self.robot.name}, {repr(self.table)[len('<Table: ') :]}"

    def _columns(self) -> dict[str, NDArray[Any]]:
        return {f"{n} [{unit}]" if unit not in ("", "1") else n: self.table[n] for n, unit in self.table.units.items()}

    @property
    def tips(self) -> tuple[States, Array, Ints]:
        """States with a tip: conditions, tips (n, 3) m in the base frame, trial numbers (n,)."""
        states = self.table.take(self.table.with_tip)
        if not len(states):
            raise ConfigError("the input contains no state with a tip position; record a bending or elongation run")
        return settings(self.robot, states), states.tip, states.trial


def read_case(inputs: Sequence[Path], given: Path | Robot | None = None) -> Case:
    """Read recordings (.mcap) and case folders into one case, of its robot or one `given`; raises ConfigError, RecordingError.

    Readings that this robot cannot produce in SI units and in its frame are refused (see `diagnosis.edits.reading`)."""
    for path in inputs:
        _demand_case(path)
    recordings = [Recording.open(path) for path in without_torn(inputs) if not path.is_dir()]
    recorded = [(", ".join(str(r.path) for r in group), table) for group, table in _in_time(campaigns(recordings))]
    folders = [path for path in inputs if path.is_dir()]
    sources = [read_yaml(path / "robot.yaml") for path in folders if given is None]
    sources += [parse_yaml(attached(r, "robot.yaml"), f"{r.path}:robot.yaml") for r in recordings if given is None]
    source = read_yaml(given) if isinstance(given, Path) else next(iter(sources), Source("the Robot", {}, {}))
    robot = given if isinstance(given, Robot) else check(source, Robot)
    for other in sources[1:]:
        if not same_robot(check(other, Robot), robot):
            raise ConfigError(
                f"{other.name}: was recorded with a different robot.yaml than {source.name}; give one for both with --robot"
            )
    parts = [
        (str(path / "trials.csv"), replace(read_csv(path / "trials.csv"), mapped=_mapped(path / "map.yaml", robot)))
        for path in folders
    ]
    return case_of(robot, [*parts, *recorded], source.name, source.text.decode())


def _mapped(path: Path, robot: Robot) -> Mapped | None:
    """How the map.yaml of a case made its table; None where there is none, or one that is not of this program."""
    try:
        made = stated_map(read_yaml(path), robot.actuators.words)
    except ConfigError:
        return None
    unit, *others = {column.unit or None for name, column in made.columns.items() if re.fullmatch(r"p\d+", name)} or {None}
    return made.mapped(None if others else unit)


def case_of(robot: Robot, parts: Sequence[tuple[str, Table]], robot_name: str, robot_text: str = "") -> Case:
    """Tables, each with its name, as one case; `robot_name`: where the robot was read. Raises ConfigError as `read_case`."""
    from diagnosis.edits.reading import read  # with the rod, which no recording alone needs

    asked, used = list[str](), list[Table]()
    for file, table in parts:
        table = believed(without_contradicted(table, robot) if table.mapped is None else table, robot)
        reading = read(robot, table)
        if reading.refused:
            raise ConfigError("\n".join(f"{file}: {text}" for text in reading.refused))
        asked += (f"{file}: {text}" for text in (*reading.asked, *table.warnings))
        used.append(reading.table)
    table = Table.joined(used)
    units = {column: unit for _, part in parts for column, unit in part.sensor_units.items()}
    return Case(robot, replace(table, warnings=(*asked, *doubts(robot, table, robot_name)), sensor_units=units), robot_text)


def _demand_case(path: Path) -> None:
    """Raise a ConfigError that says what to give instead of a file or folder that is neither a recording nor a case."""
    if path.name in CASE and all((path.parent / name).is_file() for name in CASE):
        raise ConfigError(f"{path}: is part of a case; give its folder: {path.parent}")
    if path.is_file() and path.suffix.lower() in (".yaml", ".yml"):
        raise ConfigError(f"{path}: is not a recording or a case folder; a robot.yaml goes with --robot")
    if path.is_file() and path.suffix.lower() in TABLES:
        remedy = typed("lab", "import", path, "--guess", "--robot", "ROBOT.yaml", "--out", "map")
        raise ConfigError(f"{path}: is a table, not a recording; make a case of it, beginning with: {remedy}")
    if path.is_dir() and not (path / "trials.csv").exists():
        if any(path.glob("*.mcap")):
            raise ConfigError(f"{path}: is a folder of recordings, not a case folder; give its files, {path}/*.mcap")
        raise ConfigError(f"{path}: has no trials.csv, so it is not a case folder; give one written by lab import or lab export")


def without_torn(paths: Sequence[Path]) -> list[Path]:
    """Return the paths without one of each damaged or unfinished recording and its recovered file, where both are given.

    The recording is left out with a note. One that is whole counts, and its recovered file is left out instead."""
    pairs = ((path, path.with_name(path.stem + RECOVERED)) for path in paths if not path.is_dir())
    left_out = dict((saved, path) if verify(path).ok else (path, saved) for path, saved in pairs if saved in paths)
    note(f"{over}: not read; {counts}, which holds the same run, is also given" for over, counts in left_out.items())
    return [path for path in paths if path not in left_out]


def _in_time(groups: Sequence[Sequence[Recording]]) -> list[tuple[Sequence[Recording], Table]]:
    """The table of each campaign; `t` goes on from the first to those that were begun later."""
    out: list[tuple[Sequence[Recording], Table]] = []
    for group in groups:
        table = merged(group)
        begun = (min(r.start_wall_ns for r in group) - min(r.start_wall_ns for r in groups[0])) / 1e9
        shift = max(begun, out[-1][1].get("t").max(initial=0.0) if out else 0.0) if begun > 0 else 0.0
        out.append((group, table.replaced({"t": table.get("t") + shift}) if shift and len(table) else table))
    return out


def same_robot(a: Robot, b: Robot) -> bool:
    """Whether two robots have the same body; their limit and the arm's error may have been added to one later."""
    known = b.uncertainty.model_copy(update={"push_place": a.uncertainty.push_place})
    return a == b.model_copy(update={"max_pressure": a.max_pressure, "max_tension": a.max_tension, "uncertainty": known})


def same_body(a: bytes, b: bytes) -> bool:
    """Whether two robot.yaml describe the same body; when one cannot be read, whether they are the same file."""
    if a == b:
        return True
    try:
        one, other = (check(parse_yaml(text.decode("utf-8"), "robot.yaml"), Robot) for text in (a, b))
    except (ConfigError, UnicodeDecodeError):
        return False
    return same_robot(one, other)


def unconfirmed_guesses(inputs: Sequence[Path]) -> Iterator[Finding]:
    """One finding for each case whose map.yaml has guesses that `lab import --guess` marks."""
    for place in inputs:
        path = place / "map.yaml"
        try:
            listed = read_yaml(path).table.get("unconfirmed")
        except ConfigError:  # a recording, or a case that was not imported
            continue
        if isinstance(listed, list) and listed:
            more = f" and {len(listed) - MOST_GUESSES} more" if len(listed) > MOST_GUESSES else ""
            half = MOST_OF_GUESS // 2 - 2  # of one that is too long, at whose end its remedy stands
            texts = (t if len(t) <= MOST_OF_GUESS else f"{t[:half]} .. {t[-half:]}" for t in map(str, listed[:MOST_GUESSES]))
            are = "1 guess of the map is" if len(listed) == 1 else f"{len(listed)} guesses of the map are"
            yield finding("unconfirmed_guesses", count=len(listed), are=are, guesses="; ".join(texts) + more, path=str(path))


MOST_GUESSES, MOST_OF_GUESS = 6, 160
"""Named one by one; characters of each."""
DOUBTS = {
    "soft": "the jammed spine was soft",
    "bodies": "a body was out of the robot's reach",
    "drift": "the force sensor's zero drifted unevenly, so the drift was not removed",
}
"""Meaning of each of `recordings.trials.DOUBTS`, for people."""
CLIPPED = (
    "; the pressures read are right, but the ramp there was uneven: this computer sent a set-point late and max_rate held the "
    "next one back, or a limit of rig.yaml is below what was asked (`/log` has the values)"
)


def marked_notes(table: Table) -> list[str]:
    """One line that names the states with clipped set-points, and one for each doubt about states."""
    notes = [("set-points were clipped to the rig's limits before", table.clipped, CLIPPED)]
    notes += [(f"{text} in", table.get("doubt") == doubt, "") for doubt, text in DOUBTS.items()]
    found = [(text, np.flatnonzero(own), more) for text, own, more in notes if own.any()]
    return [f"{text} {len(own)} of {len(table)} states: {listed(own, table.place)}{more}" for text, own, more in found]


def attached(recording: Recording, name: str) -> str:
    """The text of an attached file; raises ConfigError when there is none, or it is no text."""
    try:
        return recording.attachments[name].decode("utf-8")
    except KeyError:
        remedy = "; give one with --robot" * (name == "robot.yaml")
        raise ConfigError(f"{recording.path}: has no {name} attached{remedy}") from None
    except UnicodeDecodeError as e:
        raise ConfigError(f"{recording.path}: the attached {name} is not a text file") from e
