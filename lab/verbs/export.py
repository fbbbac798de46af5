"""`lab export`: recordings and cases in the forms that other programs read.

An RO-Crate (https://w3id.org/ro/crate/1.1) is a folder that others understand without this software: beside copies of its files
stands `ro-crate-metadata.json`: what each file is, its columns with their units, the robot, the instruments, who recorded it
when, with which version of which software, and what the diagnosis says.

For ArviZ, xarray, Julia and R the probabilities of a diagnosis are an InferenceData, a NetCDF file. Group `posterior`: parameters
of the most probable hypothesis that names an effect, dimensions chain and draw. A diagnosis states each parameter's normal
posterior (for the leading hypothesis also the physical bounds at which it is cut) and no covariance: parameters are drawn
independently of each other. Group `evidence`: every hypothesis of the ranking with its probability, log evidence, error on unseen
states and sizes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import numpy as np
import yaml
from numpy.typing import NDArray

from diagnosis.answer.result import Diagnosis, Ranked
from diagnosis.errors import DiagnosisError
from model.robot import Robot
from recordings.campaign.export import export_case, export_streams
from recordings.campaign.info import Info
from recordings.campaign.info import info as summary
from recordings.campaign.labels import RECORD
from recordings.campaign.replay import tables
from recordings.file.reader import Recording
from recordings.own_files import copied, replaced, replacing
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table, unit_of

from ..console import note, out
from ..files.config import ConfigError, load
from ..files.inputs import marked_notes, same_body, without_torn
from ..files.output_folder import CRATE as METADATA
from ..files.output_folder import names_apart, whole
from ..options import ANY_SIZE, JSON, REPLACE, OneOf, Result, Verb, inputs, option
from ..version import NAME, installed, source

CHAINS, DRAWS, SEED = 4, 1000, 1
NORMAL = "normal of the stated standard deviation, each parameter drawn independently: no covariance is stated"
CUT = "normal posterior cut at the physical bounds, each parameter drawn independently: no covariance is stated"

Array = NDArray[np.float64]


def write_inference(path: Path, answer: Diagnosis, robot: Robot) -> Path:
    """Write a diagnosis as NetCDF and return the path; raises ConfigError without xarray, or where nothing was weighed."""
    try:
        xarray = import_module("xarray")
        import_module("h5netcdf")
    except ImportError as e:
        raise ConfigError(f"--arviz needs {e.name}, which is not installed; pip install 'softlab[arviz]'") from e
    if not answer.attribute.ranking:
        raise ConfigError(f"{path}: the diagnosis weighs no hypothesis")
    git = source()
    shared = {
        "created_at": datetime.now(UTC).isoformat(), "inference_library": NAME, "inference_library_version": installed(),
        "robot": robot.name, "statement": answer.statement, "verdict": answer.attribute.verdict, "states": answer.data.rows,
        "trials": answer.data.trials, **({"source_commit": git["commit"]} if git["commit"] else {}),
    }  # fmt: skip
    groups = {"evidence": _evidence(xarray, answer, shared)}
    named = next((r for r in answer.attribute.ranking if r.parameters), None)
    if named is not None:
        groups["posterior"] = _posterior(xarray, answer, named, shared)
    with replacing(path) as (file, new):
        file.close()
        xarray.Dataset(attrs=shared).to_netcdf(new, mode="w", engine="h5netcdf")
        for name, group in groups.items():
            group.to_netcdf(new, mode="a", group=name, engine="h5netcdf")
    return path


def _posterior(xarray: Any, answer: Diagnosis, named: Ranked, shared: Mapping[str, Any]) -> Any:
    """The Dataset `posterior`: (chains, draws) of each parameter of the hypothesis `named`, cut at its bounds where it leads."""
    leads = list(named.effects) == list(answer.detail.get("best_hypothesis", ()))
    cut = {s["name"]: s for s in answer.detail.get("sizes", ())} if leads else {}
    rng = np.random.default_rng(SEED)
    variables = {}
    for name, p in named.parameters.items():
        stated = cut.get(name, {"mean": p.value, "low": -np.inf, "high": np.inf})
        values = _drawn(stated["mean"], p.sd, stated["low"], stated["high"], rng)
        variables[name] = xarray.DataArray(values, dims=("chain", "draw"), attrs={"units": p.unit})
    source_of_draws = {
        "hypothesis": " + ".join(named.effects), "probability": named.probability, "seed": SEED,
        "drawn_from": CUT if cut else NORMAL,
    }  # fmt: skip
    counts = {"chain": np.arange(CHAINS), "draw": np.arange(DRAWS)}
    return xarray.Dataset(variables, coords=counts, attrs={**shared, **source_of_draws})


def _drawn(mean: float, sd: float, low: float, high: float, rng: np.random.Generator) -> Array:
    """(chains, draws) of a normal cut at low and high."""
    from scipy.stats import truncnorm  # slow to import

    if sd <= 0.0:
        return np.full((CHAINS, DRAWS), mean)
    cut = truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)
    return np.clip(cut.rvs(size=(CHAINS, DRAWS), random_state=rng), low, high)


def _evidence(xarray: Any, answer: Diagnosis, shared: Mapping[str, Any]) -> Any:
    """The Dataset `evidence`: by hypothesis its probability, evidence, error, effects (1 or 0) and parameters (NaN: has none)."""
    ranking = answer.attribute.ranking
    sizes = {name: p.unit for r in ranking for name, p in r.parameters.items()}
    effects = sorted({e for r in ranking for e in r.effects})

    def column(of: list[float | None], about: str, units: str = "1") -> Any:
        values = np.array([np.nan if v is None else v for v in of])
        return xarray.DataArray(values, dims="hypothesis", attrs={"units": units, "long_name": about})

    def table(of: str, about: str) -> Any:
        rows = [[getattr(r.parameters[n], of) if n in r.parameters else np.nan for n in sizes] for r in ranking]
        values = np.array(rows, np.float64).reshape(len(ranking), len(sizes))
        return xarray.DataArray(values, dims=("hypothesis", "parameter"), attrs={"long_name": about})

    named = np.array([[int(e in r.effects) for e in effects] for r in ranking], np.int8).reshape(len(ranking), -1)
    variables = {
        "probability": column([r.probability for r in ranking], "probability given the data"),
        "log_evidence": column([r.log_evidence for r in ranking], "log marginal likelihood, as computed"),
        "heldout_rmse": column([r.heldout_rmse_mm for r in ranking], "rms tip error on states that the fit did not see", "mm"),
        "named": xarray.DataArray(named, dims=("hypothesis", "effect"), attrs={"long_name": "1 where the hypothesis names it"}),
        "value": table("value", "fitted, in the parameter's unit"),
        "sd": table("sd", "standard deviation, in the parameter's unit"),
    }  # fmt: skip
    coords = {
        "hypothesis": [" + ".join(r.effects) or "none" for r in ranking],
        "effect": effects,
        "parameter": list(sizes),
        "unit": ("parameter", list(sizes.values())),
    }
    return xarray.Dataset(variables, coords=coords, attrs=dict(shared))


DIAGNOSIS = "diagnosis.json"
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
NO_LICENSE = "not stated: write one into this file before you publish"


def write_crate(folder: Path, files: Sequence[Path], table: Table, recordings: Mapping[str, Info], name: str) -> Path:
    """Copy files into a folder and describe them; `recordings` by file name. Returns the metadata file."""
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
    return folder / METADATA


def _ids(things: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """References to things that are described elsewhere in the crate."""
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


IN_A_CASE = ("map.yaml", "states.png", DIAGNOSIS, "diagnosis.html", "rig.yaml", "predicted.csv")
"""Files of a case folder that go into a crate beside the robot and the table."""


Form = Literal["streams", "case", "crate", "arviz"]


def export(inputs: Sequence[Path], folder: Path, form: Form, replace: bool = False) -> Result:
    """Files of each stream, one case folder, an RO-Crate, or diagnoses for ArviZ; raises ConfigError."""
    with whole(folder, replace=replace, inputs=inputs) as place:
        written, table = _export(without_torn(inputs), place, form, folder.resolve().name)
    advice = [f"{folder / METADATA}: license: {NO_LICENSE}"] if form == "crate" else []
    return _written([folder / path.relative_to(place) for path in written], table, advice)


def _export(inputs: Sequence[Path], folder: Path, form: Form, name: str) -> tuple[list[Path], Table | None]:
    """Write inputs in a form; returns the files written, and the table of trials where the form has one. Raises ConfigError."""
    cases = [p for p in inputs if p.is_dir()]
    names = dict(zip(inputs, names_apart(inputs), strict=True))
    if form == "crate":
        return _crate(inputs, folder, name)
    if form == "arviz":
        return _arviz(names, folder), None
    if cases:
        why = "is a case already; --case is for recordings" if form == "case" else "has no streams; use --crate or --arviz"
        raise ConfigError(f"{cases[0]}: {why}")
    recordings = {path: Recording.open(path) for path in inputs}
    if form == "case":
        table = _joined_case([*recordings.values()], folder)
        return [folder / "robot.yaml", folder / "trials.csv"], table
    places = {path: folder / names[path] if len(recordings) > 1 else folder for path in recordings}
    return [file for path, recording in recordings.items() for file in export_streams(recording, places[path])], None


def _arviz(names: Mapping[Path, str], folder: Path) -> list[Path]:
    """One NetCDF file for each case that was diagnosed."""
    written: list[Path] = []
    for place, name in names.items():
        answer_file = place / DIAGNOSIS
        if not answer_file.is_file():
            raise ConfigError(
                f"{place}: is no case folder with a {DIAGNOSIS}; first: lab diagnose {place} --json {answer_file}"
                if place.is_dir()
                else f"{place}: --arviz takes case folders that were diagnosed; first: lab export --case, lab diagnose"
            )
        try:
            answer = Diagnosis.from_json(answer_file.read_text(encoding="utf-8"))
        except (DiagnosisError, UnicodeDecodeError) as e:
            raise ConfigError(f"{answer_file}: {e}") from e
        written.append(write_inference(folder / f"{name}.nc", answer, load(place / "robot.yaml", Robot)))
    return written


def _joined_case(recordings: Sequence[Recording], folder: Path) -> Table:
    """robot.yaml and trials.csv of recordings of one robot."""
    first = recordings[0]
    for other in recordings[1:]:
        if not same_body(other.attachments.get("robot.yaml", b""), first.attachments.get("robot.yaml", b"")):
            raise ConfigError(f"{other.path}: was recorded with a different robot.yaml than {first.path}; export them separately")
    table = Table.joined(tables(recordings))
    export_case(first, folder, table)
    return table


def _crate(inputs: Sequence[Path], folder: Path, name: str) -> tuple[list[Path], Table]:
    """Copy one case, or recordings as one, and further files into a crate; returns files and table. Raises ConfigError."""
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
    further = [cases[0] / n for n in IN_A_CASE if (cases[0] / n).is_file()] if cases else []
    contents = [folder / "robot.yaml", folder / "trials.csv", *further, *files]
    twice = next((p for i, p in enumerate(contents) if any(p.name == q.name for q in contents[:i])), None)
    if twice is not None:
        raise ConfigError(f"{twice}: another file of this name is in the crate; rename one")
    infos = {file: summary(path) for file, path in recordings.items()}
    metadata = write_crate(folder, contents, table, infos, cases[0].resolve().name if cases else name)
    return [metadata, *(folder / p.name for p in contents)], table


def _written(files: Sequence[Path], table: Table | None = None, advice: Sequence[str] = ()) -> Result:
    def show() -> None:
        note(marked_notes(table) if table is not None else ())
        for path in files:
            out.print(str(path))
        note(advice)

    clipped = {} if table is None else {"clipped": int(table.clipped.sum())}
    return Result({"files": [str(path) for path in files], **clipped}, show)


def _export_verb(a: argparse.Namespace) -> Result:
    form: Form = "case" if a.case else "crate" if a.crate else "arviz" if a.arviz else "streams"
    return export(a.inputs, a.out, form, a.replace)


VERBS = (
    Verb(
        "export",
        _export_verb,
        options=(
            JSON,
            ANY_SIZE,
            inputs("recordings (.mcap); with --crate and --arviz also a case folder"),
            option("--out", type=Path, required=True, metavar="FOLDER", help="new or empty folder to write"),
            REPLACE,
            OneOf(
                (
                    option("--case", action="store_true", help="robot.yaml + trials.csv, as other tools take it"),
                    option("--crate", action="store_true", help="one described folder, as a paper's supplement"),
                    option("--arviz", action="store_true", help="each case's diagnosis.json as NetCDF for ArviZ"),
                )
            ),
        ),
        examples=("lab export runs/sweep.mcap --out csv", "lab export runs/*.mcap --case --out case"),
        page="docs/explanations/recordings.md",
    ),
)
