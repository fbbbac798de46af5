"""`lab import`: turn measurements of other laboratories and programs into a case, with a map of their columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from diagnosis.edits.reading import read as judged
from model.robot import Robot
from recordings.own_files import copied, replaced
from recordings.table_file import write_csv
from recordings.trials import counted

from ..console import Screen, note, out
from ..files.config import ConfigError, load, read_yaml
from ..files.jumps import believed
from ..files.map_file import Source, map_of
from ..files.output_folder import demand_free, whole
from ..files.robot_numbers import doubts
from ..imports.formats import KNOWN, REMEDIES, read
from ..imports.guess import guess_map, lacks
from ..imports.joining import experiments, joined, on_one_clock, stream_of
from ..imports.proposal import Guess, asking, guess_text
from ..imports.series import Series, listed
from ..imports.table import imported
from ..options import READS, REPLACE, OneOf, Result, Verb, inputs, option, path_option
from ..plain import typed

MAP, PICTURE = "map.yaml", "states.png"
OWN = ("robot.yaml", "trials.csv", MAP, PICTURE)
"""What an import writes, and replaces when it is repeated."""


def import_files(inputs: Sequence[Path], map_path: Path, robot_path: Path | None, folder: Path, replace_all: bool) -> Result:
    """Write CASE/robot.yaml, trials.csv, map.yaml and a picture of which rows became states. Raises ConfigError."""
    demand_free(folder, OWN, replace_all, inputs)
    given = read_yaml(map_path)
    robot_path = robot_path or map_path.parent / str(given.table.get("robot", "robot.yaml"))
    robot = load(robot_path, Robot)
    wanted = map_of(given, robot.actuators.words)
    with Screen("import") as screen:
        result = imported(inputs, wanted, robot, screen.progress)
    credible = believed(replace(result.table, warnings=()), robot, result.places.__getitem__)
    reading = judged(robot, credible)
    if reading.refused:
        raise ConfigError(*(f"{map_path}: {text}" for text in reading.refused))
    doubtful = (*credible.warnings, *doubts(robot, credible, str(robot_path)), *reading.asked)
    result = replace(result, notes=(*result.notes, *doubtful))
    with whole(folder, OWN, replace_all, inputs) as (place, word):
        copied(robot_path, place / "robot.yaml")
        copied(map_path, place / MAP)
        if questions := [q for q in result.questions if q not in wanted.unconfirmed]:
            replaced(place / MAP, asking(given.text.decode(), questions))
        write_csv(result.table, place / "trials.csv")
        from ..pages.import_figure import draw

        draw(result, robot, place / PICTURE)
    trials = len(set(result.table.trial.tolist()))
    written = [str(folder / name) for name in OWN]

    def show() -> None:
        note((*result.notes, *(f"check: {text}" for text in result.questions)))
        out.print(f"{counted(len(result.table), 'state')} in {counted(trials, 'trial')}")
        out.print(f"{word}: {', '.join(written)}", soft_wrap=True)
        out.print(f"look at {folder / PICTURE}, then: {typed('lab', 'diagnose', folder)}", soft_wrap=True)

    about = {"states": len(result.table), "trials": trials, "columns": result.table.columns, "notes": result.notes,
             "check": result.questions}  # fmt: skip
    return Result({"files": written, "read": [str(q.path) for _, q, _ in result.files], **about}, show)


def _first_proposal(inputs: Sequence[Path], robot: Robot) -> tuple[Series, Guess]:
    """Columns of the first file, or of joined files, that name pressures and tip, with the map proposed. Raises ConfigError."""
    failed, tables = list[ConfigError](), list[Series]()
    inside = (file for path in inputs for file in (sorted(path.iterdir()) if path.is_dir() else [path]))
    for file in (file for file in inside if file.suffix.lower() in KNOWN):
        try:
            series = read(file, Source())
            if not lacks(series, robot):
                return series, guess_map(series, robot)
            tables.append(series)
        except ConfigError as e:
            if file in inputs:
                raise
            failed.append(e)
    kinds = [lacks(series, robot) for series in tables]
    if tables and not frozenset.intersection(*kinds):
        streams = on_one_clock([stream_of(series, series.path.name) for series in tables])
        lead, companions = experiments(streams, kinds, lambda kind: "tip" not in kind)[0][0]
        series = joined(lead, companions)
        return series, guess_map(series, robot)
    for series in tables:
        try:
            return series, guess_map(series, robot)
        except ConfigError as e:
            failed.append(e)
    if len(tables) > 1:
        whats = ("pressures", "a pressure of each actuator (p1, P2 [kPa], tendon1 [N] ..)"), ("tip", "the tip (x, y, z)")
        missing = " and ".join(text for what, text in whats if all(what in kind for kind in kinds))
        each = "; ".join(f"{series.path} has {listed(series.names[:12])}" for series in tables)
        raise ConfigError(f"no heading of these files names {missing}: {each}. Name the columns so, or write map.yaml by hand")
    if failed:
        raise failed[0]
    remedy = next((REMEDIES[path.suffix.lower()] for path in inputs if path.suffix.lower() in REMEDIES), "export it as CSV")
    raise ConfigError(f"{', '.join(map(str, inputs))}: no file of a kind that is read ({', '.join(KNOWN)}); {remedy}")


def grouped(proposed: Guess) -> dict[str, list[str]]:
    """Keys of a proposed map by their common reason, without the doubtful ones but columns, of which nobody is to miss one."""
    found: dict[str, list[str]] = {}
    for key, reason in proposed.reasons.items():
        doubtful, column = key in proposed.doubtful, key.startswith("columns.")
        found.setdefault(reason + "; see `unconfirmed`" * (doubtful and column), []).append(key)
    return {reason: keys for reason, keys in found.items() if keys[0] not in proposed.doubtful or keys[0].startswith("columns.")}


def guess(inputs: Sequence[Path], robot_path: Path | None, folder: Path, replace_all: bool = False) -> Result:
    """Write FOLDER/map.yaml, proposed from headings and numbers, and a picture of the resulting states."""
    if robot_path is None:
        raise ConfigError(
            "--robot: give the robot.yaml of this robot; its length and actuators help to identify the columns. "
            "docs/tutorials/your-rig.md has an example to copy"
        )
    files = (MAP, PICTURE, "robot.yaml")
    demand_free(folder, files, replace_all, inputs)
    robot = load(robot_path, Robot)
    series, proposed = _first_proposal(inputs, robot)
    checks = [*series.notes, *proposed.doubts]
    result = None
    with whole(folder, files, replace_all, inputs) as (place, _):
        copied(robot_path, place / "robot.yaml")
        replaced(place / MAP, guess_text(proposed, Path("robot.yaml"), [series.path], series.form))
        try:
            result = imported(inputs, map_of(read_yaml(place / MAP), robot.actuators.words), robot)
            reading = judged(robot, result.table)
            if reading.refused:  # an import by this map would be, too
                unsettled = replace(proposed, doubts=[*proposed.doubts, *reading.refused])
                replaced(place / MAP, guess_text(unsettled, Path("robot.yaml"), [series.path], series.form))
            checks += (*reading.refused, *doubts(robot, result.table, str(robot_path)), *reading.asked)
            checks += (*result.questions, *result.unread)
            from ..pages.import_figure import draw

            draw(result, robot, place / PICTURE)
        except ConfigError as e:
            checks.append(str(e).replace(str(place), str(folder)))
    states = len(result.table) if result is not None else 0

    def show() -> None:
        for reason, keys in grouped(proposed).items():
            out.print(f"{', '.join(keys):24s} {reason}")
        note(f"check: {text}" for text in checks if text not in proposed.doubts)
        if proposed.doubts:
            points = counted(len(proposed.doubts), "point")
            note([f"{points} to check, listed under `unconfirmed` in {folder / MAP}: delete each once settled"])
        if result is not None:
            out.print(f"{counted(states, 'state')}; look at {folder / PICTURE} and {folder / MAP}, then:", soft_wrap=True)
        out.print(typed("lab", "import", *inputs, "--map", folder / MAP, "--out", "CASE"), soft_wrap=True)

    return Result({"map": str(folder / MAP), "reasons": proposed.reasons, "check": checks, "states": states}, show)


VERBS = (
    Verb(
        "import",
        lambda a: (
            guess(a.inputs, a.robot, a.out, a.replace) if a.guess else import_files(a.inputs, a.map, a.robot, a.out, a.replace)
        ),
        options=(
            *READS,
            inputs("files (CSV, MATLAB, NumPy, C3D, Parquet, MCAP) or a folder of them"),
            OneOf(
                path_option("--map", "MAP.yaml", "map.yaml: columns, units, frame (axes or directions), states"),
                option("--guess", action="store_true", help="propose a map with its reasons and a picture, for you to check"),
                required=True,
            ),
            path_option("--robot", "ROBOT.yaml", "robot.yaml (default: the one that the map names)"),
            path_option("--out", "FOLDER", "case folder to write; with --guess: where the map goes", required=True),
            REPLACE,
        ),
        examples=(
            "lab import table.csv --guess --robot robot.yaml --out map",
            "lab import table.csv --map map/map.yaml --robot robot.yaml --out case",
        ),
        page="docs/howto/other-data.md",
    ),
)
