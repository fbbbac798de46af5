"""The notebooks run from their first cell to their last, and end in what they promise."""

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from tests.diagnosis.small_campaigns import SOME
from tests.simulated.clock import SimulatedClock

ROOT = Path(__file__).parents[2]


def executed(name: str) -> tuple[str, dict[str, Any]]:
    spec = importlib.util.spec_from_file_location("notebook", ROOT / "docs/notebook.py")
    assert spec is not None and spec.loader is not None
    spec.loader.exec_module(module := importlib.util.module_from_spec(spec))
    path = ROOT / "examples/notebooks" / name
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells), "notebooks are kept without outputs"
    page, names = module.executed(path)
    assert page.count("```python") == sum(cell["cell_type"] == "code" for cell in cells)
    return page, names


def test_a_table_is_analysed_to_its_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", SOME)
    page, names = executed("analysis.ipynb")
    assert "turned by 7.9" in repr(names["answer"]) and list(names["known"].effects) == ["chamber_azimuth"]
    assert names["reached"].reached.all() and names["longer"].length == 0.13
    assert "4 of 126 rows have no tip" in page and "<th>tip x [mm]</th>" in page


def test_a_protocol_runs_on_fakes(shared_clock: SimulatedClock) -> None:
    _, names = executed("protocol.ipynb")
    assert names["recording"].outcome == "completed" and len(names["case"].table) == 7
    assert float(max(names["fakes"].plant.chamber_pressure)) < 5e3
