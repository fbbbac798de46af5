"""What was measured, read and drawn."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from benchmarks.commands import Wait
from benchmarks.cost import draw
from benchmarks.diagnosis_growth import Grown, by_rows, considered
from benchmarks.peers import Row, reached, shown, wait
from benchmarks.rod_growth import Taken

ROWS = [
    Row("rod, batch", "4 divisions", 1e-6, 0.3, 1e-3),
    Row("rod, batch", "8 divisions", 2e-6, 0.3, 1e-5),
    Row("collocation", "coarse", 1e-2, 0.0, 0.5),
    Row("collocation", "fine", 3e-2, 0.0, 0.05),
    Row("own law", "fine", 0.2, 1.0, 30.0, own_mm=0.5),
    Row("lost some", "fine", 0.1, 0.0, 1e-3, missed=2),
    Row("elsewhere", "any", absent="not installed"),
]
BATCHES = [
    Taken(rods, elements, start, threads, 1e-6 * rods * elements / threads)
    for rods, elements, threads in ((1, 2, 1), (1, 2, 2), (100, 2, 1), (100, 2, 2), (50, 2, 1), (50, 4, 1))
    for start in ("cold", "warm")
]
DIAGNOSES = [Grown(by, n, 1.0 * n, 2.0 * n, 100.0 + n) for by in ("rows", "effects", "workers") for n in (1, 2)]


def test_ways_are_compared_at_equal_error_by_their_own_law() -> None:
    at = {level: {m: row.setting for m, row in reached(ROWS, level).items()} for level in (1.0, 0.1)}
    assert at[1.0] == {"rod, batch": "4 divisions", "collocation": "coarse", "own law": "fine"}
    assert at[0.1] == {"rod, batch": "4 divisions", "collocation": "fine"}
    assert wait(ROWS[4], 231) == pytest.approx(47.2)
    assert [shown(s) for s in (900.0, 2.0, 0.02, 2e-6)] == ["15 min", "2 s", "20 ms", "2 us"]


def test_times_by_rows_are_those_of_whole_commands(tmp_path: Path) -> None:
    names = {
        "lab diagnose, 231 rows, first after installation": None,
        "lab diagnose, 231 rows, clean": 231,
        "lab diagnose, 539 rows": 539,
    }
    waits = [Wait(name, 9.0, 18.0, 512.0, 0, rows) for name, rows in names.items()]
    (tmp_path / "commands.json").write_text(json.dumps([asdict(wait) for wait in waits]))
    assert by_rows(tmp_path / "commands.json") == [Grown("rows", n, 9.0, 18.0, 512.0) for n in (231, 539)]
    assert by_rows(tmp_path / "none.json") == []


def test_the_cause_is_in_every_set_of_effects_and_sets_are_nested() -> None:
    known = [f"effect {k}" for k in range(8)]
    small, large = (considered(["effect 5"], known, n) for n in (3, 6))
    assert small[0] == "effect 5" and large[:3] == small and set(considered(["effect 5"], known, 8)) == set(known)


def test_what_was_measured_is_drawn_and_the_rest_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, key, listed in (("peers", "rows", ROWS), ("rod_growth", "batches", BATCHES)):
        (tmp_path / f"{name}.json").write_text(json.dumps({key: [asdict(each) for each in listed]}))
    assert [p.name for p in draw(tmp_path, tmp_path / "images")] == ["cost-peers.png", "cost-rod-growth.png"]
    assert "diagnosis_growth.json: not there, not drawn" in capsys.readouterr().out
    (tmp_path / "diagnosis_growth.json").write_text(json.dumps({"diagnoses": [asdict(g) for g in DIAGNOSES]}))
    assert len(draw(tmp_path, tmp_path / "images")) == 3
