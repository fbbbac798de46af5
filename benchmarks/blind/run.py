"""Diagnose every case of a set without its seal, and give it the experiments it asks for."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.diagnose import Options, diagnose
from diagnosis.judgement import LEAST_BITS
from lab.files.baseline import from_table
from lab.files.config import ConfigError
from lab.files.inputs import read_case
from recordings.own_files import replaced
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table

from .answers import answer_from
from .folder import SetFolder
from .make import PREDICTED
from .sweeps import CHANNELS, MENU
from .workers import spread

Diagnose = Callable[[Path], dict[str, Any]]
"""A case folder in, diagnosis.json out."""
MENU_OF = {
    "unload": "unload", "orientation": "orientation", "markers": "markers", "elongation": "all_chambers",
    "other_chambers": "other_group", "roll": "roll", "tip_mass": "tip_mass", "hold": "hold", "rate": "fast", "vacuum": "vacuum",
}  # fmt: skip
"""What is on the menu, by the id that a diagnosis has for it."""


def diagnose_folder(folder: Path) -> dict[str, Any]:
    """Return diagnosis.json of a case folder, as `lab diagnose` writes it. Raises what the diagnosis raises."""
    return _answered(folder, Options())


def propose_folder(folder: Path) -> dict[str, Any]:
    """The same without held-out errors."""
    return _answered(folder, Options(quantify=False))


def attribute_folder(folder: Path) -> dict[str, Any]:
    """The same without held-out errors and without next experiments, for a quick look."""
    return _answered(folder, Options(quantify=False, experiments=False))


def _answered(folder: Path, options: Options) -> dict[str, Any]:
    case = read_case([folder])
    if (folder / PREDICTED).exists():
        options = replace(options, baseline=from_table(folder / PREDICTED, case))
    found: dict[str, Any] = json.loads(diagnose(case, options).to_json())
    return found


def run(root: Path, diagnose: Diagnose, most: int = 0, workers: int | str = 1) -> int:
    """Diagnose all cases that have no answer yet, giving each up to `most` experiments; returns how many.

    Raises ConfigError when the set has been scored already.
    """
    folder = SetFolder(root.resolve())
    folder.public()
    if folder.score.exists():
        raise ConfigError(f"{folder.score} exists: the seal was opened, answers given now are not blind; make a new set")
    todo = [n for n in folder.names() if not (folder.answers(n) / "rounds.json").exists()]
    done = spread(partial(answer, folder, diagnose, most), todo, workers, "cases diagnosed")
    return sum(1 for _ in done)


def answer(folder: SetFolder, diagnose: Diagnose, most: int, name: str) -> str:
    """Diagnose one case and write its rounds; a diagnosis that fails is an answer too. Returns the case's name."""
    found = rounds(folder.case(name), diagnose, most)
    target = folder.answers(name)
    target.mkdir(parents=True, exist_ok=True)
    replaced(target / "rounds.json", json.dumps(found, indent=1))
    return name


def rounds(case: Path, diagnose: Diagnose, most: int) -> list[dict[str, Any]]:
    """Diagnoses of a case folder (`asked`, `seconds`, `diagnosis`), each after one experiment more, until it is settled, asks
    for nothing more or had the most."""
    table, menu = read_csv(case / "trials.csv"), case / "menu"
    found: list[dict[str, Any]] = []
    asked: tuple[str, ...] = ()
    while True:
        began = time.monotonic()
        answered = _diagnosed(diagnose, [case / "robot.yaml", case / PREDICTED], table)
        found.append({"asked": asked, "seconds": time.monotonic() - began, "diagnosis": answered})
        wish = wanted(answered, asked, case.name) if len(asked) < most and menu.is_dir() else None
        if wish is None:
            return found
        table, asked = granted(table, menu, wish), (*asked, wish)


def _diagnosed(diagnose: Diagnose, files: Sequence[Path], table: Table) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="case-") as place:
        for file in files:
            if file.exists():
                shutil.copy(file, place)
        write_csv(table, Path(place) / "trials.csv")
        try:
            return diagnose(Path(place))
        except Exception as e:  # noqa: BLE001 - whatever goes wrong counts against the diagnosis, not against the bench
            return {"error": f"{type(e).__name__}: {e}"}


def wanted(diagnosis: dict[str, Any], had: Sequence[str], name: str) -> str | None:
    """As `lab investigate` chooses: the first experiment of `next_experiment` that is worth doing, on the menu and not done
    yet; None when none is, or when the answer is settled."""
    if answer_from(name, diagnosis).settled:
        return None
    items = (i for i in diagnosis.get("next_experiment") or () if i.get("expected_bits", np.inf) >= LEAST_BITS)
    asked = (MENU_OF.get(item.get("id")) for item in items)
    return next((key for key in asked if key is not None and key not in had), None)


def granted(table: Table, menu: Path, wish: str) -> Table:
    """The campaign with one more experiment, seen through the channels that are measured by now."""
    if wish in CHANNELS:
        return _widened(table, read_csv(menu / "base.csv"), wish)
    extra = read_csv(menu / f"{wish}.csv")
    orientation = any(r.orientation is not None for r in table)
    markers = any(r.markers for r in table)
    rows = [replace(r, orientation=r.orientation if orientation else None, markers=r.markers if markers else ()) for r in extra]
    return Table.joined([table, Table.of(rows)])


def _widened(table: Table, base: Table, channel: str) -> Table:
    """The base sweep with one more channel, in front of whatever else was measured."""
    key = {(r.trial, r.step): r for r in base}
    trials = max(r.trial for r in base)
    rows = []
    for r in table:
        full = key.get((r.trial, r.step)) if r.trial <= trials else None
        if full is None or channel == "unload":
            rows.append(r)
        elif channel == "orientation":
            rows.append(replace(r, orientation=full.orientation))
        else:
            rows.append(replace(r, markers=full.markers))
    if channel == "unload":
        first = rows[0]
        there = {(r.trial, r.step) for r in rows}
        more = [
            replace(
                r,
                orientation=r.orientation if first.orientation is not None else None,
                markers=r.markers if first.markers else (),
            )
            for r in base
            if (r.trial, r.step) not in there
        ]
        own = sorted([*[r for r in rows if r.trial <= trials], *more], key=lambda r: (r.trial, r.step))
        rows = [*own, *[r for r in rows if r.trial > trials]]
    return Table.of(rows)


if set(MENU_OF.values()) != {s.name for s in MENU} | set(CHANNELS):
    raise RuntimeError("diagnosis and menu name different experiments")
