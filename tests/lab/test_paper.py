"""`lab paper`: the published numbers reproduced, figures and JSON written."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from lab.console import PlainConsole
from lab.verbs.paper import PaperReport, main, run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("paper") / "new" / "folder"


@pytest.fixture(scope="module")
def report(folder: Path) -> PaperReport:
    return run(folder)


def test_the_figures_are_pictures_of_some_size(report: PaperReport) -> None:
    assert len(report.figures) == 7
    for path in report.figures:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000


def test_without_spine_the_converged_tip_is_the_known_one(report: PaperReport) -> None:
    np.testing.assert_allclose(report.converged[0, -1], [-0.239509465, 0, 0.322875895], atol=2e-9)


def test_backbones_end_at_the_tips_of_the_highest_pressure(report: PaperReport) -> None:
    np.testing.assert_allclose(report.shapes[:, -1], report.converged[:, -1], atol=1e-9)


def test_the_integrators_own_error_is_a_visible_part_of_the_published_one(report: PaperReport) -> None:
    rows = report.integrator.rows
    assert rows[0].worst == pytest.approx(6.11e-3, rel=1e-3)
    share = np.array([row.mean_abs_x for row in rows]) / report.published_error[:, 0]
    assert (share > 0.05).all() and (share < 0.3).all()
    assert max(row.worst for row in report.integrator_fine.rows) < 0.7e-3


def test_the_converged_rod_needs_slightly_larger_areas_for_the_same_curves(report: PaperReport) -> None:
    np.testing.assert_array_equal(report.published_factor, [1.5, 1.5, 1.7, 1.9, 2.0, 2.15, 2.4])
    excess = report.converged_factor / report.published_factor
    assert (excess > 1.0).all() and (excess < 1.02).all()


def test_the_json_holds_the_numbers_of_the_report(report: PaperReport, folder: Path) -> None:
    data = json.loads((folder / "paper.json").read_text())
    assert data["schema"] == "paper/1"
    np.testing.assert_array_equal(data["tips_converged"], report.converged)
    assert [Path(p).name for p in data["figures"]] == [p.name for p in report.figures]


def test_the_tables_show_each_spine_length_with_published_and_computed_error(report: PaperReport) -> None:
    text = io.StringIO()
    report.print(PlainConsole(file=text, width=140))
    shown = text.getvalue()
    assert "239.5, 322.9" in shown
    assert "13.2" in shown and "6.11" in shown


def test_as_json_the_verb_prints_json_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(tmp_path, as_json=True) == 0
    assert json.loads(capsys.readouterr().out)["euler_steps"] == 100
