"""Declarations: what is refused, and effects that come from elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from model.effects import CATALOGUE, EffectSpec, Law, Parameter, effects_from_file, installed_effects
from model.effects.spine import shear_spine
from model.errors import BadEffect
from model.robot import Robot

OWN = """
from model.effects import EffectSpec, Law, Parameter
EFFECTS = (EffectSpec("{id}", "material", "", (Parameter("size", "1", 0.1, -1.0, 1.0),), Law(), "", ""),)
"""


def test_every_effect_says_what_it_is_and_where_it_is_seen() -> None:
    for spec in CATALOGUE.values():
        assert spec.equation and spec.citation and spec.seen_best_in
        assert all(p.low <= s <= p.high for p in spec.parameters for s in p.starts)
        positive = [p for p in spec.parameters if p.sign in ("positive", "blend")]
        assert all(p.low == 0 for p in positive)
        assert all(p.high == 1 for p in positive if p.sign == "blend")


def test_effects_of_one_family_are_forms_of_one_cause() -> None:
    assert CATALOGUE["pressure_offset"].family_id == CATALOGUE["pressure_deadband"].family_id
    assert CATALOGUE["contact"].family_id == "contact"


def test_effects_come_from_a_file_and_from_installed_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_effects.py").write_text(OWN.format(id="from_file"))
    assert [s.id for s in effects_from_file(tmp_path / "own_effects.py")] == ["from_file"]
    (tmp_path / "packaged_effects.py").write_text(OWN.format(id="from_package"))
    info = tmp_path / "packaged-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: packaged\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[softlab.effects]\nmine = packaged_effects:EFFECTS\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert [s.id for s in installed_effects()] == ["from_package"]


@pytest.mark.parametrize("text", ["EFFECTS = ()", "nothing = 1", "1 / 0"])
def test_a_file_without_good_effects_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "own.py"
    path.write_text(text)
    with pytest.raises(BadEffect, match=r"own\.py"):
        effects_from_file(path)


def test_declarations_that_could_never_be_absent_are_refused() -> None:
    with pytest.raises(BadEffect, match="must hold zero"):
        Parameter("size", "1", 0.1, 0.5, 1.0)
    with pytest.raises(BadEffect, match="no parameter is a size"):
        EffectSpec("own", "load", "", (Parameter("form", "1", 0.1, -1.0, 1.0, role="shape"),), Law(), "", "")
    with pytest.raises(BadEffect, match="stage"):
        EffectSpec("own", "weather", "", (Parameter("size", "1", 0.1, -1.0, 1.0),), Law(), "", "")  # type: ignore[arg-type]


def test_the_papers_table_asks_for_six_and_a_half_megapascal_and_a_soft_core(paper_robot: Robot) -> None:
    assert paper_robot.spine is not None
    found = shear_spine(paper_robot.spine)
    assert found.modulus == pytest.approx(6.6e6, rel=0.02)
    assert 3 * paper_robot.spine.radius**2 / (4 * found.shear) == pytest.approx(0.0070e-6, rel=0.02)
    engaged = found.engaged(np.array([0.05, 0.3]))
    assert 0.02 < engaged[0] < 0.06 and 0.5 < engaged[1] < 0.6
