"""`lab export`: write recordings and cases in formats that other programs read.

An RO-Crate (https://w3id.org/ro/crate/1.1) is a folder that others understand without this software. Its
`ro-crate-metadata.json` describes each file, columns with units, robot, instruments, operator, date, versions and diagnosis.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import yaml

from recordings.campaign.export import export_case, export_streams
from recordings.campaign.info import Info
from recordings.campaign.info import info as summary
from recordings.campaign.labels import RECORD
from recordings.campaign.replay import campaigns, merged
from recordings.file.reader import Recording
from recordings.own_files import copied, replaced
from recordings.table_file import read_csv
from recordings.trials import Table, counted, unit_of

from ..console import note, out
from ..files.config import ConfigError
from ..files.inputs import marked_notes, same_body, without_torn
from ..files.output_folder import CRATE as METADATA
from ..files.output_folder import names_apart, whole
from ..options import READS, REPLACE, OneOf, Option, Result, Verb, inputs, option, path_option
from ..version import NAME, installed, source

DIAGNOSIS = "diagnosis.json"
CONTEXT, PROFILE = "https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/crate/1.1"
FORMATS = {
    ".mcap": "application/octet-stream", ".csv": "text/csv", ".yaml": "application/yaml", ".json": "application/json",
    ".html": "text/html", ".svg": "image/svg+xml", ".png": "image/png", ".mat": "application/x-matlab-data",
    ".pdf": "application/pdf",
}  # fmt: skip
WHAT = {
    "robot.yaml": "the robot: geometry, material, chambers, spine; SI units",
    "trials.csv": "table of trials: one row per state; SI units",
    "diagnosis.json": "diagnosis of the gap between measurement and model",
    "diagnosis.html": "the same as a page",
    "rig.yaml": "instruments and limits of the rig",
    "map.yaml": "columns of the imported files",
}
UNIT_CODES = {"1": "C62", "m": "MTR", "Pa": "PAL", "s": "SEC", "kg": "KGM", "N": "NEW", "deg": "DD"}
"""UN/CEFACT, as schema.org asks for."""
NO_LICENSE = "not stated: write a licence into this file before you publish"


def write_crate(folder: Path, files: Sequence[Path], table: Table, recordings: Mapping[str, Info], name: str) -> None:
    """Copy files into a folder and describe them; `recordings` by file name."""
    folder.mkdir(parents=True, exist_ok=True)
    graph: list[dict[str, Any]] = []
    for path in files:
        copied(path, folder / path.name)
        graph.append(_file(folder / path.name, recordings.get(path.name)))
    columns = [
        {"@id": f"#column-{name}", "@type": "PropertyValue", "name": name, "unitText": (unit := unit_of(name))}
        | ({"unitCode": UNIT_CODES[unit]} if unit in UNIT_CODES else {})
        for name in table.columns
    ]
    for file in graph:
        if file["@id"] == "trials.csv":
            file["variableMeasured"] = _ids(columns)
    robot = _robot(folder / "robot.yaml")
    actions = _actions({str(f["@id"]) for f in graph}, recordings)
    root = {
        "@id": "./", "@type": "Dataset", "name": name, "license": NO_LICENSE,
        "description": f"{len(table)} states in {len(set(table.trial.tolist()))} trials of a soft continuum robot"
        + (f", {len(recordings)} recordings" if recordings else ""),
        "datePublished": datetime.now(UTC).date().isoformat(), "hasPart": _ids(graph), "about": _ids(robot[:1]),
        "mentions": _ids([a for a in actions if a["@type"] == "CreateAction"]),
    }  # fmt: skip
    crate = {"@id": METADATA, "@type": "CreativeWork", "about": {"@id": "./"}, "conformsTo": {"@id": PROFILE}}
    whole = {"@context": CONTEXT, "@graph": [crate, root, *graph, *columns, *robot, *actions]}
    replaced(folder / METADATA, json.dumps(whole, indent=1) + "\n")


def _ids(things: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """References to entities described elsewhere in the crate."""
    return [{"@id": thing["@id"]} for thing in things]


def _file(path: Path, recorded: Info | None) -> dict[str, Any]:
    """The entry of one file; of a recording with its streams, of a diagnosis with its statement."""
    about: dict[str, Any] = {
        "@id": path.name, "@type": "File", "name": path.name,
        "encodingFormat": FORMATS.get(path.suffix.lower(), "application/octet-stream"), "contentSize": str(path.stat().st_size),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "description": WHAT.get(path.name, path.suffix[1:]),
    }  # fmt: skip
    if recorded is not None:
        streams = ", ".join(f"{topic} {s.timing.count}" for topic, s in recorded.streams.items())
        text = f"MCAP recording: {recorded.duration:.0f} s, {recorded.rows} states; samples by stream: {streams}"
        about |= {"description": text, "dateCreated": recorded.start}
    if path.name == DIAGNOSIS:
        about["abstract"] = str(json.loads(path.read_text(encoding="utf-8")).get("statement", ""))
    return about


def _robot(path: Path) -> list[dict[str, Any]]:
    """The robot and its plain numbers."""
    if not path.is_file():
        return []
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    numbers = [
        {"@id": f"#robot-{key}", "@type": "PropertyValue", "name": key, "value": value}
        for key, value in data.items()
        if isinstance(value, int | float | str) and key != "name"
    ]
    about = {"@id": "#robot", "@type": "Thing", "name": str(data.get("name", "robot")), "description": WHAT["robot.yaml"]}
    return [about | {"additionalProperty": _ids(numbers), "subjectOf": {"@id": "robot.yaml"}}, *numbers]


def _actions(files: Collection[str], recordings: Mapping[str, Info]) -> list[dict[str, Any]]:
    """Entries of the software, the instruments and operators of recordings, and of who or what made which file."""
    commit = source()["commit"]
    software = {"@id": "#software", "@type": "SoftwareApplication", "name": NAME, "softwareVersion": installed()}
    things: list[dict[str, Any]] = [software | ({"identifier": commit} if commit else {})]
    for name, recorded in recordings.items():
        instruments = [
            {"@id": f"#{name}-{role}", "@type": "Thing", "name": role, "description": identity}
            for role, identity in recorded.metadata.get("instruments", {}).items()
        ]
        versions = ", ".join(f"{k} {v}" for k, v in recorded.metadata.get("versions", {}).items())
        action: dict[str, Any] = {
            "@id": f"#recorded-{name}", "@type": "CreateAction", "name": "recorded", "startTime": recorded.start,
            "instrument": _ids(instruments), "result": {"@id": name}, "description": versions,
        }  # fmt: skip
        people = []
        if operator := recorded.metadata.get(RECORD, {}).get("operator"):
            people = [{"@id": f"#operator-{quote(operator)}", "@type": "Person", "name": operator}]
            action["agent"] = _ids(people)[0]
        things += [*instruments, *(person for person in people if person not in things), action]
    if derived := [{"@id": n} for n in ("trials.csv", DIAGNOSIS, "diagnosis.html") if n in files]:
        read = [{"@id": n} for n in (*recordings, "robot.yaml") if n in files]
        things.append({"@id": "#analysed", "@type": "CreateAction", "name": "analysed", "instrument": {"@id": "#software"},
                       "object": read, "result": derived})  # fmt: skip
    return things


IN_A_CASE = ("robot.yaml", "trials.csv", "map.yaml", "states.png", DIAGNOSIS, "diagnosis.html", "rig.yaml", "predicted.csv")
"""Files of a case folder that go into a crate."""


Form = Literal["streams", "case", "crate", "lerobot"]
USUAL, FASTEST = 10, 1000
"""Frames per second of a LeRobot dataset."""


def export(inputs: Sequence[Path], folder: Path, form: Form, replace: bool, rate: int | None) -> Result:
    """Files of each stream, one case folder, an RO-Crate, or a LeRobot dataset of `rate` Hz; raises ConfigError."""
    if rate is not None and form != "lerobot":
        raise ConfigError(f"--rate {rate}: only --lerobot writes frames at a fixed rate; give --lerobot too, or leave --rate out")
    if not 1 <= (rate := USUAL if rate is None else rate) <= FASTEST:
        raise ConfigError(f"--rate {rate}: must be 1 to {FASTEST} frames per second")
    table: Table | None = None
    dataset: dict[str, Any] = {}
    with whole(folder, replace=replace, inputs=inputs) as (place, _):
        given = without_torn(inputs)
        if form == "crate":
            table = _crate(given, place, folder.resolve().name)
        elif form == "case":
            table = _joined_case(_recordings(given, "is already a case; --case is for recordings"), place)
        elif form == "lerobot":
            from ..lerobot_dataset import write_dataset  # with pandas, which no other format needs

            dataset = write_dataset(_of_one_robot(_recordings(given)), place, rate)
        else:
            for name, recording in zip(names_apart(given), _recordings(given), strict=True):
                export_streams(recording, place / name if len(given) > 1 else place)
        files = [str(folder / path.relative_to(place)) for path in sorted(place.rglob("*")) if path.is_file()]

    def show() -> None:
        note(marked_notes(table) if table is not None else ())
        for file in files:
            out.print(file)
        if form == "crate":
            note([f"{folder / METADATA}: license: {NO_LICENSE}"])
        if dataset:
            out.print(f"{counted(dataset['episodes'], 'episode')}, {dataset['frames']} frames at {rate} Hz")
            gaps = (f"{name} in {share:.1%}" for shares in dataset["missing"].values() for name, share in shares.items() if share)
            note([f"missing (NaN) in a share of the frames: {text}"] if (text := ", ".join(gaps)) else ())

    return Result({"files": files, **({} if table is None else {"clipped": int(table.clipped.sum())}), **dataset}, show)


def _recordings(paths: Sequence[Path], why: str = "has no streams; use --crate") -> list[Recording]:
    """Open recordings; raises ConfigError with the reason `why` a case will not do."""
    for case in filter(Path.is_dir, paths):
        raise ConfigError(f"{case}: {why}")
    names_apart(paths)  # none is given twice
    return [Recording.open(path) for path in paths]


def _of_one_robot(recordings: Sequence[Recording]) -> Sequence[Recording]:
    """Return recordings; raises ConfigError where they are of several robots."""
    first = recordings[0]
    for other in recordings[1:]:
        if not same_body(other.attachments.get("robot.yaml", b""), first.attachments.get("robot.yaml", b"")):
            raise ConfigError(f"{other.path}: was recorded with a different robot.yaml than {first.path}; export them separately")
    return recordings


def _joined_case(recordings: Sequence[Recording], folder: Path) -> Table:
    """robot.yaml and trials.csv of recordings of one robot."""
    table = Table.joined(map(merged, campaigns(_of_one_robot(recordings))))
    export_case(recordings[0], folder, table)
    return table


def _crate(inputs: Sequence[Path], folder: Path, name: str) -> Table:
    """Copy a case or recordings, and further files, into a crate; return the table. Raises ConfigError."""
    cases, files = [p for p in inputs if p.is_dir()], [p for p in inputs if not p.is_dir()]
    if len(cases) > 1:
        raise ConfigError(f"{cases[1]}: a crate holds one case; export them separately")
    recordings = {p.name: p for p in files if p.suffix == ".mcap"}
    if not cases and not recordings:
        raise ConfigError("--crate: give recordings (.mcap), a case folder, or both; other files may follow")
    if cases:
        table, name = read_csv(cases[0] / "trials.csv"), cases[0].resolve().name
    else:
        table = _joined_case([Recording.open(p) for p in recordings.values()], folder)
    place = cases[0] if cases else folder
    contents = [*(place / n for n in IN_A_CASE if (place / n).is_file()), *files]
    twice = next((p for i, p in enumerate(contents) if any(p.name == q.name for q in contents[:i])), None)
    if twice is not None:
        raise ConfigError(f"{twice}: another file in the crate has this name; rename one")
    write_crate(folder, contents, table, {file: summary(path) for file, path in recordings.items()}, name)
    return table


def _form(name: Form, text: str) -> Option:
    """Return the option of a format."""
    return option(f"--{name}", dest="form", action="store_const", const=name, default="streams", help=text)


VERBS = (
    Verb(
        "export",
        lambda a: export(a.inputs, a.out, a.form, a.replace, a.rate),
        options=(
            *READS,
            inputs("recordings (.mcap); with --crate also a case folder"),
            path_option("--out", "FOLDER", "new or empty folder to write", required=True),
            REPLACE,
            OneOf(
                _form("case", "write a case for other tools: robot.yaml and trials.csv"),
                _form("crate", "write one described folder, as a paper's supplement"),
                _form("lerobot", "write a dataset for LeRobot: one episode per trial, frames at a fixed rate"),
            ),
            option("--rate", type=int, metavar="HZ", help=f"frames per second of --lerobot (default {USUAL})"),
        ),
        examples=("lab export runs/sweep.mcap --out csv", "lab export runs/*.mcap --case --out case"),
        page="docs/explanations/recordings.md",
    ),
)
