"""The page of a diagnosis: whole without a network, with a picture in every frame, and drawn by a real browser."""

import base64
import json
import re
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import matplotlib.pyplot as plt
import numpy as np
import pytest
from diagnosed_case import Answered
from pages import read_as_text

from benchmarks.browser import BROWSERS, Browser, installed
from diagnosis.answer.result import Diagnosis
from lab.pages.diagnosis_figures import _curve
from lab.pages.diagnosis_report import alike, gap_numbers
from lab.pages.report import TERMS, Report

QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--host-resolver-rules=MAP * ~NOTFOUND",
    "--window-size=1200,4200",
)  # fmt: skip
"""No profile of a person, nothing looked up anywhere."""
OF_THE_BROWSER = "not an origin"
"""Initiator of what a browser asks for by itself, whatever page is open."""
SECTIONS = (
    "The answer in full", "The gap, step by step", "Where it is", "What to do next", "Evidence: which cause",
    "Evidence: a campaign that was not fitted", "How large the cause is",
    "The gap by spine length, pressure, branch and time", "Which effects these data can distinguish",
    "Stages and misfit diagnostics", "Terms",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser() -> str:
    if (found := installed()) is None:
        pytest.skip(f"none of {', '.join(BROWSERS)} is installed")
    return found


def opened(browser: str, page: Path, folder: Path, *what: str) -> str:
    """What a browser prints on opening a page."""
    command = [browser, *QUIET, f"--user-data-dir={folder / 'profile'}", *what, page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def asked_for(browser: str, page: Path, folder: Path) -> list[str]:
    """Addresses that the page made the browser ask for, other than of files and of data within it."""
    log = folder / "net.json"
    opened(browser, page, folder, f"--log-net-log={log}", "--virtual-time-budget=3000", "--dump-dom")
    requests = [e.get("params") or {} for e in json.loads(log.read_text())["events"]]
    return sorted(
        {
            r["url"]
            for r in requests
            if r.get("initiator", OF_THE_BROWSER) != OF_THE_BROWSER and not r["url"].startswith(("file:", "data:"))
        }
    )


def test_every_picture_of_the_page_shows_something(answered: Answered) -> None:
    pictures = re.findall(r'src="data:image/svg.xml;base64,([^"]+)"', answered.page.read_text())
    assert answered.page.read_text().count("<figure>") == 6 <= len(pictures)
    for picture in pictures:
        drawn = ElementTree.fromstring(base64.b64decode(picture))
        assert sum(element.tag.endswith(("}path", "}use")) for element in drawn.iter()) > 50


def test_a_setting_without_a_number_interrupts_a_curve_and_a_state_without_a_pressure_is_left_out() -> None:
    figure, axis = plt.subplots()
    pressure, gap = np.array([0.0, 100.0, 50e3, 90e3, np.nan]), np.array([1.0, 3.0, np.nan, 4.0, 50.0])
    with warnings.catch_warnings(action="error"):
        _curve(axis, pressure, 1e3, gap, "k", "-")
    (line,) = axis.lines
    assert np.asarray(line.get_xdata()) == pytest.approx([0.05, 50.0, 90.0])
    assert np.asarray(line.get_ydata()) == pytest.approx([2.0, np.nan, 4.0], nan_ok=True)
    plt.close(figure)


def test_the_page_points_nowhere(answered: Answered) -> None:
    text = answered.page.read_text()
    assert not re.search(r'(?:src|href|url\()\s*=?\s*["\']?\s*(?:https?:)?//', text)
    assert "<script" not in text


def test_page_json_statement_and_command_give_the_same_headline_and_numbers(answered: Answered) -> None:
    found, page = Diagnosis.from_json(answered.json.read_text()), answered.page.read_text()
    assert f'<p class="lead">{found.headline}</p>' in page and len(found.headline.split()) <= 20
    assert " ".join(answered.said.split()).startswith(found.headline)
    assert f"(p = {found.attribute.probability:.2f})" in found.headline and "area_moment" not in found.headline
    assert [name for name, _, _ in gap_numbers(found)] == [
        "uncalibrated", "calibrated", "with cause", "the robot of lab fit --with", "noise floor",
    ]  # fmt: skip
    shown = read_as_text(page)
    for name, value, how in gap_numbers(found):
        assert f"<dt>{name}</dt><dd>{value}</dd><dd>{how}</dd>" in shown
        assert name in ("noise floor", "the robot of lab fit --with") or "unseen" in how
    once = replace(found, waterfall=None)
    assert [(name, how) for name, _, how in gap_numbers(once)][0] == ("calibrated", "rms, in-sample")


def test_which_effect_would_be_taken_for_which_keeps_its_direction(answered: Answered, tmp_path: Path) -> None:
    found, report = Diagnosis.from_json(answered.json.read_text()), Report("t", "s", "a gap")
    table = {"effects": ["area_moment", "base_tilt"], "tied_below": 9.0, "separation": [[400.0, 27.0], [0.7, 5000.0]]}
    alike(report.section("Alike"), replace(found, detail={**found.detail, "distinguishability": table}))
    row = read_as_text(report.write(tmp_path / "page.html").read_text()).partition("taken for")[2]
    assert row.index("base_tilt") < row.index("area_moment")


def test_only_probable_hypotheses_are_said_to_be_separated(answered: Answered) -> None:
    found = Diagnosis.from_json(answered.json.read_text())
    probable = {" + ".join(r.effects) or "none" for r in found.attribute.ranking if r.probability > 0.02}
    assert all(probable.issuperset(pair) for p in found.next_experiment for pair in p.separates)
    page = answered.page.read_text()
    first = found.next_experiment[0]
    assert f"<b>Next:</b> {first.do} ({first.cost_min:.0f} min)." in page
    assert f"lab run {answered.protocols}/{first.id}.yaml --rig RIG.yaml" in page
    separating = any(p.separates for p in found.next_experiment[:6])
    assert ("; separates " in page) == separating and ("None of these experiments" in page) != separating
    assert all(f">{p.expected_bits:.2f}" in page for p in found.next_experiment[:6])


def test_the_first_use_of_a_term_in_a_section_is_linked_to_its_meaning(tmp_path: Path) -> None:
    report = Report("t", "s", "a gap")
    report.section("One").text("The noise floor of a trial; noise floors, no_trial, trial.csv, trials.")
    report.section("Two").table(("trial", "Reducible gap"), [["gap", "0.1"]])
    page = report.write(tmp_path / "page.html").read_text()
    links = re.findall(r'<a class="term" href="#(term-\d+)" title="([^"]+)">([^<]+)</a>', page)
    assert [word for _, _, word in links] == ["noise floor", "trial", "trial", "Reducible gap", "gap"]
    meaning = {term.words[0]: term.meaning for term in TERMS}
    assert [title for _, title, _ in links] == [
        meaning[word] for word in ("noise floor", "trial", "trial", "reducible gap", "gap")
    ]
    for place, title, _ in links:
        assert re.search(rf'<dt id="{place}">[^<]+</dt><dd>{re.escape(title)}</dd>', page)


def test_a_diagnosis_explains_each_term_that_it_uses_and_no_other(answered: Answered) -> None:
    page = answered.page.read_text()
    explained = set(re.findall(r'<dt id="(term-\d+)">', page))
    assert explained == set(re.findall(r'href="#(term-\d+)"', page)) and len(explained) > 15


def test_no_effect_is_known_by_its_identifier_alone(answered: Answered) -> None:
    found = Diagnosis.from_json(answered.json.read_text())
    page = re.sub(r'src="[^"]+"|<code>.*?</code>|<footer.*', "", answered.page.read_text(), flags=re.DOTALL)
    below = page[page.index("The answer in full") :]
    ids = "|".join(sorted(found.names, key=len, reverse=True))
    small = rf'<small class="soft">\[(?:{ids})(?:<wbr>\.\w+)?\]</small>'
    assert "bending by own area moments <small" in below and len(re.findall(small, below)) > 10
    assert [i for i in found.names if "_" in i and re.search(rf"\b{i}\b", re.sub(small, "", below))] == []


def test_the_browser_shows_title_verdict_and_all_sections(answered: Answered, browser: str, tmp_path: Path) -> None:
    dom = opened(browser, answered.page, tmp_path, "--dump-dom")
    assert "<title>The gap between model and robot</title>" in dom
    said = read_as_text(dom)
    assert "Cause: bending by own area moments [area_moment] (p = " in said and "On the held-out campaign" in said
    assert re.findall(r"<h2>([^<]+)</h2>", dom) == list(SECTIONS)


def test_the_browser_draws_the_page_from_top_to_bottom(answered: Answered, browser: str, tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    opened(browser, answered.page, tmp_path, f"--screenshot={picture}")
    drawn = matplotlib.image.imread(picture)
    assert drawn.shape[:2] == (4200, 1200)
    ink = drawn[..., :3].min(axis=-1) < 0.9  # not (nearly) white
    assert all(part.mean() > 0.01 for part in np.array_split(ink, 6))


def test_a_phone_shows_every_panel_whole_and_legible(answered: Answered, browser: str, tmp_path: Path) -> None:
    page = tmp_path / "phone.html"
    page.write_text(answered.page.read_text().replace("<details", "<details open"))
    with Browser(browser, tmp_path / "profile", width=390) as phone:
        phone.open(page.as_uri())
        phone.until("document.readyState === 'complete'")
        shown = phone.value(
            "[...document.querySelectorAll('img,p,dl,code,.scroll')].map(x=>[x.tagName,x.getBoundingClientRect().right,"
            "x.width/(x.naturalWidth||x.width),x.scrollWidth-x.clientWidth])"
        )
    assert len(shown) > 20 and all(right <= 390 for _, right, _, _ in shown)
    assert all(cut <= 0 for tag, _, _, cut in shown if tag == "DIV")  # no table has a column beyond the edge
    assert min(scale for tag, _, scale, _ in shown if tag == "IMG") > 0.65


def test_the_browser_is_asked_for_nothing_outside_the_page(answered: Answered, browser: str, tmp_path: Path) -> None:
    assert asked_for(browser, answered.page, tmp_path) == []
    leaking = tmp_path / "leaking.html"
    leaking.write_text(answered.page.read_text().replace("<h1>", '<img src="http://127.0.0.1:9/pixel.png"><h1>', 1))
    assert asked_for(browser, leaking, tmp_path) == ["http://127.0.0.1:9/pixel.png"]
