"""A folder that others understand without this software: an RO-Crate (https://w3id.org/ro/crate/1.1).

Beside copies of its files stands `ro-crate-metadata.json`: what each file is, its columns with their units, the robot, the
instruments, who recorded it when, with which version of which software, and what the diagnosis says.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import yaml

from recordings.campaign.info import Info
from recordings.campaign.labels import RECORD
from recordings.own_files import copied, replaced
from recordings.trials import Table, unit_of

from ..version import NAME, installed, source

METADATA = "ro-crate-metadata.json"
CONTEXT, PROFILE = "https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/crate/1.1"
FORMATS = {
    ".mcap": "application/octet-stream", ".csv": "text/csv", ".yaml": "application/yaml", ".json": "application/json",
    ".html": "text/html", ".svg": "image/svg+xml", ".png": "image/png", ".mat": "application/x-matlab-data",
    ".pdf": "application/pdf",
}  # fmt: skip
WHAT = {
    "robot.yaml": "the robot: geometry, material, chambers, spine; SI units",
    "trials.csv": "table of trials: one row for each state that was read; SI units",
    "diagnosis.json": "diagnosis of the gap between measurement and model",
    "diagnosis.html": "the same as a page",
    "rig.yaml": "instruments and limits of the rig",
    "map.yaml": "what the columns of the imported files were",
}
UNIT_CODES = {"1": "C62", "m": "MTR", "Pa": "PAL", "s": "SEC", "kg": "KGM", "N": "NEW", "deg": "DD"}
"""UN/CEFACT, as schema.org asks for."""
NO_LICENSE = "not stated: choose a licence before you publish"


def write_crate(
    folder: Path, files: Sequence[Path], table: Table, recordings: Mapping[str, Info], name: str, license: str | None
) -> Path:
    """Copy files into a folder and describe them; `recordings` by file name. Returns the metadata file."""
    folder.mkdir(parents=True, exist_ok=True)
    graph: list[dict[str, Any]] = []
    for path in files:
        target = folder / path.name
        copied(path, target)
        graph.append(_file(target, recordings.get(path.name)))
    columns = [_column(column) for column in table.columns]
    own = next((f for f in graph if f["@id"] == "trials.csv"), None)
    if own is not None:
        own["variableMeasured"] = [{"@id": c["@id"]} for c in columns]
    robot = _robot(folder / "robot.yaml")
    actions = _made(graph, recordings)
    root = {
        "@id": "./", "@type": "Dataset", "name": name, "license": license or NO_LICENSE,
        "description": f"{len(table)} states in {len(set(table.trial.tolist()))} trials of a soft continuum robot"
        + (f", {len(recordings)} recordings" if recordings else ""),
        "datePublished": datetime.now(UTC).date().isoformat(),
        "hasPart": [{"@id": f["@id"]} for f in graph], "about": [{"@id": r["@id"]} for r in robot[:1]],
        "mentions": [{"@id": a["@id"]} for a in actions if a["@type"] == "CreateAction"],
    }  # fmt: skip
    about = {"@id": METADATA, "@type": "CreativeWork", "about": {"@id": "./"}, "conformsTo": {"@id": PROFILE}}
    whole = {"@context": CONTEXT, "@graph": [about, root, *graph, *columns, *robot, *actions]}
    replaced(folder / METADATA, json.dumps(whole, indent=1) + "\n")
    return folder / METADATA


def _file(path: Path, recorded: Info | None) -> dict[str, Any]:
    out: dict[str, Any] = {
        "@id": path.name, "@type": "File", "name": path.name,
        "encodingFormat": FORMATS.get(path.suffix.lower(), "application/octet-stream"), "contentSize": str(path.stat().st_size),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "description": WHAT.get(path.name, path.suffix[1:]),
    }  # fmt: skip
    if recorded is not None:
        streams = ", ".join(f"{topic} {s.timing.count}" for topic, s in recorded.streams.items())
        out |= {
            "description": f"MCAP recording: {recorded.duration:.0f} s, {recorded.rows} states; samples by stream: {streams}",
            "dateCreated": recorded.start,
        }
    if path.name == "diagnosis.json":
        said = json.loads(path.read_text(encoding="utf-8"))
        out["abstract"] = str(said.get("statement", ""))
    return out


def _column(name: str) -> dict[str, Any]:
    unit = unit_of(name)
    code = {"unitCode": UNIT_CODES[unit]} if unit in UNIT_CODES else {}
    return {"@id": f"#column-{name}", "@type": "PropertyValue", "name": name, "unitText": unit} | code


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
    about = {
        "@id": "#robot",
        "@type": "Thing",
        "name": str(data.get("name", "robot")),
        "description": WHAT["robot.yaml"],
    }
    return [
        about | {"additionalProperty": [{"@id": n["@id"]} for n in numbers], "subjectOf": {"@id": "robot.yaml"}},
        *numbers,
    ]


def _made(graph: Sequence[Mapping[str, Any]], recordings: Mapping[str, Info]) -> list[dict[str, Any]]:
    """The software, the instruments, and which file was made by what."""
    git = source()
    software = {
        "@id": "#software", "@type": "SoftwareApplication", "name": NAME, "softwareVersion": installed(),
        **({"identifier": git["commit"]} if git["commit"] else {}),
    }  # fmt: skip
    out: list[dict[str, Any]] = [software]
    for name, recorded in recordings.items():
        instruments = [
            {"@id": f"#{name}-{role}", "@type": "Thing", "name": role, "description": identity}
            for role, identity in recorded.metadata.get("instruments", {}).items()
        ]
        versions = ", ".join(f"{k} {v}" for k, v in recorded.metadata.get("versions", {}).items())
        out += instruments
        action: dict[str, Any] = {
            "@id": f"#recorded-{name}", "@type": "CreateAction", "name": "recorded", "startTime": recorded.start,
            "instrument": [{"@id": i["@id"]} for i in instruments], "result": {"@id": name}, "description": versions,
        }  # fmt: skip
        if operator := recorded.metadata.get(RECORD, {}).get("operator"):
            person = {"@id": f"#operator-{quote(operator)}", "@type": "Person", "name": operator}
            out += [] if person in out else [person]
            action["agent"] = {"@id": person["@id"]}
        out.append(action)
    there = {str(f["@id"]) for f in graph}
    made = [n for n in ("trials.csv", "diagnosis.json", "diagnosis.html") if n in there]
    if made:
        read = [{"@id": n} for n in (*recordings, "robot.yaml") if n in there]
        result = [{"@id": n} for n in made]
        out.append({"@id": "#analysed", "@type": "CreateAction", "name": "analysed", "instrument": {"@id": "#software"},
                    "object": read, "result": result})  # fmt: skip
    return out
