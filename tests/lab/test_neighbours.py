"""Another package of the same name is noticed at the start and named."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import lab.neighbours
from lab.neighbours import strangers

FRONT_DOOR = "import lab; lab.load_robot"


def test_here_all_are_its_own() -> None:
    assert strangers() == ""


@pytest.mark.parametrize("words", [("-m", "lab.cli", "schema", "robot"), ("-c", FRONT_DOOR)])
@pytest.mark.parametrize("first", ["__init__.py", "data.csv", "../model.py"])
def test_another_model_on_the_path_is_named(tmp_path: Path, words: tuple[str, ...], first: str) -> None:
    """A package, a folder of data, a module."""
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / first).write_text("")
    if first.endswith("model.py"):
        (tmp_path / "model").rmdir()
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, *words], cwd="/", env=env, capture_output=True, text=True, timeout=600)
    told = " ".join(done.stderr.split())
    assert done.returncode == (1 if "-c" in words else 2), told
    assert f"another package called model, {tmp_path}/model" in told and "an environment of its own" in told


def test_a_package_that_was_written_over_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lab.neighbours, "_written", lambda: {"model": "another digest"})
    assert "another package has written into" in strangers() and "model" in strangers()
