"""`lab export`: recordings and cases in the forms that other programs read."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from diagnosis.answer.result import Diagnosis
from diagnosis.errors import DiagnosisError
from model.robot import Robot
from recordings.campaign.export import StreamFormat, export_case, export_streams, write_mat
from recordings.campaign.info import info as summary
from recordings.campaign.replay import tables
from recordings.file.reader import Recording
from recordings.own_files import copied
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table

from ..console import note, out
from ..files.arviz_file import write_inference
from ..files.config import ConfigError, load
from ..files.crate import write_crate
from ..files.inputs import marked_notes, same_body, without_torn
from ..files.output_folder import names_apart, whole
from ..options import ANY_SIZE, JSON, REPLACE, OneOf, Result, Verb, inputs, option

DIAGNOSIS = "diagnosis.json"
IN_A_CASE = ("map.yaml", "states.png", DIAGNOSIS, "diagnosis.html", "rig.yaml", "predicted.csv")
"""Files of a case folder that go into a crate beside the robot and the table."""


@dataclass(frozen=True)
class Forms:
    """What is asked for."""

    case: bool = False
    crate: bool = False
    arviz: bool = False
    streams: StreamFormat = "csv"
    license: str | None = None
    name: str | None = None
    replace: bool = False


def export(inputs: Sequence[Path], folder: Path, forms: Forms) -> Result:
    """Files of each stream, one case folder, an RO-Crate, or diagnoses for ArviZ; raises ConfigError."""
    with whole(folder, replace=forms.replace, inputs=inputs) as place:
        written, table = _export(without_torn(inputs), place, forms, forms.name or folder.resolve().name)
    advice = ["no licence is stated; add --license URL before you publish"] if forms.crate and forms.license is None else []
    return _written([folder / path.relative_to(place) for path in written], table, advice)


def _export(inputs: Sequence[Path], folder: Path, forms: Forms, name: str) -> tuple[list[Path], Table | None]:
    """What was written, and the table of trials where it is one."""
    cases = [p for p in inputs if p.is_dir()]
    names = dict(zip(inputs, names_apart(inputs), strict=True))
    if forms.crate:
        return _crate(inputs, folder, forms, name)
    if forms.arviz:
        return _arviz(names, folder), None
    if forms.case:
        if cases:
            raise ConfigError(f"{cases[0]}: is a case already; --case is for recordings")
        table = _joined_case([Recording.open(f) for f in inputs], folder)
        return [folder / "robot.yaml", folder / "trials.csv"], table
    written: list[Path] = []
    for place in cases:
        if forms.streams != "mat":
            raise ConfigError(f"{place}: is a case folder, which has no streams; use --mat, --crate or --arviz")
        written.append(write_mat({"trials": _columns(read_csv(place / "trials.csv"))}, folder / f"{names[place]}.mat"))
    recordings = [path for path in inputs if not path.is_dir()]
    for path in recordings:
        apart = len(recordings) > 1 and forms.streams != "mat"
        own = folder / names[path] if apart else folder
        written += export_streams(Recording.open(path), own, forms.streams, names[path])
    return written, None


def _arviz(names: Mapping[Path, str], folder: Path) -> list[Path]:
    """One NetCDF file for each case that was diagnosed."""
    written: list[Path] = []
    for place, name in names.items():
        found = place / DIAGNOSIS
        if not found.is_file():
            raise ConfigError(
                f"{place}: is no case folder with a {DIAGNOSIS}; first: lab diagnose {place} --json {found}"
                if place.is_dir()
                else f"{place}: --arviz takes case folders that were diagnosed; first: lab export --case, lab diagnose"
            )
        try:
            answer = Diagnosis.from_json(found.read_text(encoding="utf-8"))
        except (DiagnosisError, UnicodeDecodeError) as e:
            raise ConfigError(f"{found}: {e}") from e
        written.append(write_inference(folder / f"{name}.nc", answer, load(place / "robot.yaml", Robot)))
    return written


def _columns(table: Table) -> dict[str, object]:
    return {name: table[name] for name in table.columns}


def _joined_case(recordings: Sequence[Recording], folder: Path) -> Table:
    """robot.yaml and trials.csv of recordings of one robot."""
    first = recordings[0]
    for other in recordings[1:]:
        if not same_body(other.attachments.get("robot.yaml", b""), first.attachments.get("robot.yaml", b"")):
            raise ConfigError(f"{other.path}: was recorded with a different robot.yaml than {first.path}; export them separately")
    table = Table.joined(tables(recordings))
    export_case(first, folder, table)
    return table


def _crate(inputs: Sequence[Path], folder: Path, forms: Forms, name: str) -> tuple[list[Path], Table]:
    """One folder with everything that a reader of a paper needs, described."""
    cases, files = [p for p in inputs if p.is_dir()], [p for p in inputs if not p.is_dir()]
    if len(cases) > 1:
        raise ConfigError(f"{cases[1]}: a crate holds one case; export them separately")
    recordings = {p.name: p for p in files if p.suffix == ".mcap"}
    if not cases and not recordings:
        raise ConfigError("--crate: give recordings (.mcap), a case folder, or both; further files go beside them")
    if cases:
        table = read_csv(cases[0] / "trials.csv")
        for file in ("robot.yaml", "trials.csv"):
            copied(cases[0] / file, folder / file)
    else:
        table = _joined_case([Recording.open(p) for p in recordings.values()], folder)
        write_csv(table, folder / "trials.csv")
    beside = [cases[0] / n for n in IN_A_CASE if (cases[0] / n).is_file()] if cases else []
    every = [folder / "robot.yaml", folder / "trials.csv", *beside, *files]
    twice = next((p for i, p in enumerate(every) if any(p.name == q.name for q in every[:i])), None)
    if twice is not None:
        raise ConfigError(f"{twice}: another file of this name is in the crate; rename one")
    infos = {file: summary(path) for file, path in recordings.items()}
    name = cases[0].resolve().name if cases and not forms.name else name
    made = write_crate(folder, every, table, infos, name, forms.license)
    return [made, *(folder / p.name for p in every)], table


def _written(files: Sequence[Path], table: Table | None = None, advice: Sequence[str] = ()) -> Result:
    def show() -> None:
        note(marked_notes(table) if table is not None else ())
        for path in files:
            out.print(str(path))
        note(advice)

    clipped = {} if table is None else {"clipped": int(table.clipped.sum())}
    return Result({"files": [str(path) for path in files], **clipped}, show)


def _export_verb(a: argparse.Namespace) -> Result:
    streams: StreamFormat = "mat" if a.mat else "parquet" if a.parquet else "csv"
    return export(a.inputs, a.out, Forms(a.case, a.crate, a.arviz, streams, a.license, a.name, a.replace))


VERBS = (
    Verb(
        "export",
        _export_verb,
        options=(
            JSON,
            ANY_SIZE,
            inputs("recordings (.mcap); with --mat, --crate and --arviz also a case folder"),
            option("--out", type=Path, required=True, metavar="FOLDER", help="new or empty folder to write"),
            REPLACE,
            OneOf(
                (
                    option("--case", action="store_true", help="robot.yaml + trials.csv, as other tools take it"),
                    option("--parquet", action="store_true", help="Parquet instead of CSV (needs pyarrow)"),
                    option("--mat", action="store_true", help="one MATLAB file for each recording or case instead of CSV"),
                    option("--crate", action="store_true", help="one described folder, as a paper's supplement"),
                    option("--arviz", action="store_true", help="each case's diagnosis.json as NetCDF for ArviZ"),
                )
            ),
            option("--license", metavar="URL", help="of the crate"),
            option("--name", help="of the crate (default: the folder's name)"),
        ),
        examples=("lab export runs/sweep.mcap --out csv", "lab export runs/*.mcap --case --out case"),
        page="docs/explanations/recordings.md",
    ),
)
