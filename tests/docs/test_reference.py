"""The reference pages hold what the code has, and the site is built of all pages without a warning."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.registry import OWN
from model.effects import CATALOGUE
from model.robot import Robot
from recordings.messages import STREAMS
from tests.docs.blocks import ROOT


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    spec = importlib.util.spec_from_file_location("reference_pages", ROOT / "docs/reference_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folder: Path = tmp_path_factory.mktemp("docs")
    module.write_all(folder / "reference")
    return {page.stem: page.read_text(encoding="utf-8") for page in folder.rglob("*.md")}


def test_each_key_effect_driver_and_stream_is_there(reference: dict[str, str]) -> None:
    assert all(f"\n- `{key}`" in reference["robot"] for key in Robot.model_fields)
    assert all(f"\n### {effect}\n" in reference["effects"] for effect in CATALOGUE)
    assert all(f"\n### {driver}\n" in reference["instruments"] for driver in OWN)
    assert all(f"\n## {topic}\n" in reference["streams"] for topic in STREAMS)


def test_what_a_driver_must_offer_is_there(reference: dict[str, str]) -> None:
    text = reference["instruments"]
    sensor = text[text.index("\n## sensor\n") :]
    assert text.index("\n- `open() ->") < text.index("\n## arm\n") and "\n- `latest() ->" in sensor
    of_force_mocap_and_sensor = [line for line in text.splitlines() if line.startswith("- `latest() ->")]
    assert len(of_force_mocap_and_sensor) == 3


def test_what_only_the_project_uses_is_left_out_of_the_calls_of_a_protocol(reference: dict[str, str]) -> None:
    text = reference["protocol-calls"]
    assert "\n- `pause(" in text and "`gauge`" in text
    assert "look_anew" not in text and "begin_again" not in text


def test_what_a_protocol_makes_is_shown_with_its_arguments_in_order(reference: dict[str, str]) -> None:
    calls = " ".join(reference["protocol-calls"].split())
    assert "`Window(delay, average=0.5, min_samples=3)`" in calls and "settle=Settle(), spine=SpineMotion()" in calls


def test_the_pages_in_the_repository_are_those_that_the_code_makes(reference: dict[str, str]) -> None:
    (glossary,) = (ROOT / "docs").glob("glossary.md")
    pages = {page.stem: page for page in (glossary, *(ROOT / "docs/reference").glob("*.md"))}
    stale = [name for name, text in reference.items() if pages[name].read_text(encoding="utf-8") != text]
    assert not stale, "write them anew: .venv/bin/python docs/reference_pages.py"


def test_a_field_has_its_unit_its_limits_its_default_and_its_meaning(reference: dict[str, str]) -> None:
    assert "- `standoff`: 0.08 m, (0, 0.3]. Distance from the specimen's axis" in reference["rig"]


def test_every_page_of_the_reference_is_in_its_list(reference: dict[str, str]) -> None:
    listed = (ROOT / "docs/reference/index.md").read_text(encoding="utf-8").splitlines()
    assert set(reference) - {"glossary"} <= set(listed)


def test_every_page_is_in_the_site() -> None:
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8").splitlines()
    folders = [ROOT / "docs" / kind for kind in ("tutorials", "howto", "explanations")]
    found = [f"{page.parent.name}/{page.stem}" for folder in folders for page in folder.glob("*.md")]
    assert [name for name in found if name not in index] == []


@pytest.mark.long
def test_the_site_is_built_without_a_warning_and_asks_nothing_of_the_network(tmp_path: Path) -> None:
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason="make docs installs it")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", "-d", tmp_path / "trees", ROOT / "docs", tmp_path / "site"]
    done = subprocess.run(build, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for page in (tmp_path / "site").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert 'src="http' not in text and not any("http" in line for line in text.splitlines() if "<link" in line), page
