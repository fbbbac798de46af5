"""The notebooks run from their first cell to their last, and end in what they promise."""

import ast
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.diagnosis.small_campaigns import SOME
from tests.simulated.clock import SimulatedClock

EXAMPLES = Path(__file__).parents[2] / "examples"


def executed(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Execute a notebook in a copy of the examples, and show the value of each cell; returns its names."""
    shutil.copytree(EXAMPLES, folder / "examples")
    monkeypatch.chdir(folder / "examples/notebooks")
    names: dict[str, Any] = {}
    for cell in json.loads(Path(name).read_text(encoding="utf-8"))["cells"]:
        assert not cell.get("outputs"), "notebooks are kept without outputs"
        if cell["cell_type"] == "code":
            body = ast.parse("".join(cell["source"])).body
            last = body.pop() if isinstance(body[-1], ast.Expr) else None
            exec(compile(ast.Module(body, []), name, "exec"), names)
            if isinstance(last, ast.Expr):
                shown = eval(compile(ast.Expression(last.value), name, "eval"), names)
                getattr(shown, "_repr_html_", lambda shown=shown: repr(shown))()
    return names


def test_a_table_is_analysed_to_its_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", SOME)
    names = executed("analysis.ipynb", tmp_path, monkeypatch)
    assert "turned by 8" in repr(names["answer"]) and list(names["known"].effects) == ["chamber_azimuth"]
    assert names["reached"].reached.all() and names["longer"].length == 0.13


def test_a_protocol_runs_on_fakes(shared_clock: SimulatedClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = executed("protocol.ipynb", tmp_path, monkeypatch)
    assert names["recording"].outcome == "completed" and len(names["case"].table) == 7
    assert float(max(names["fakes"].plant.chamber_pressure)) < 5e3
