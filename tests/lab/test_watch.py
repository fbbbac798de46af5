"""`lab run --watch` and `lab watch`: what the page is told, and what a browser shows, are the values of the recording."""

import json
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import yaml
from commands import Cli, command
from pages import events
from virtual_lab import VirtualLab, recorded, settings

import timing
from benchmarks.browser import BROWSERS, Browser, installed
from benchmarks.faults.night import write_campaign
from lab.comparison import expected
from lab.files.checked import announce
from lab.files.inputs import read_case
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.file.reader import Recording
from recordings.file.writer import Recorder

SHORT = settings("spine_lengths=[0.05]", "pressures=[60 kPa, 90 kPa]", *PATIENT_SETTLE)
SAID = ["--operator", "Ada", "--specimen", "S 7", "--tag", "batch=<b>3</b>"]
HOSTILE = "<img src=x onerror=alert(1)> [/red] \x1b[2J"
SHOWN = "<img src=x onerror=alert(1)> [/red] \\x1b[2J"


def address(program: subprocess.Popen[str]) -> str:
    """The one that a program prints."""
    assert program.stdout is not None
    said = ""
    for line in program.stdout:
        said += line
        if found := re.search(r"http://\S+", line):
            return found[0]
    raise AssertionError(said)


def told(page: str) -> dict[str, Any]:
    """All that a viewer knows once the recording has ended, its rows and points one after the other."""
    known: dict[str, Any] = {"rows": [], "points": []}
    for name, data in events(page):
        if name == "whole":
            known = {"rows": [], "points": []}
        known["rows"] += data.pop("rows", [])
        known["points"] += data.pop("points", [])
        known |= data
        if known.get("outcome") and (known["compared"] == known["of"] or known["model"]["stands"] == "none"):
            break
    return known


def demand_equal(known: dict[str, Any], file: Path) -> None:
    """Rows, newest samples, points and counts are those of the file."""
    recording = Recording.open(file)
    rows = [event.row for event in recording.trials]
    assert known["of"] == len(rows) > 0
    assert [(r["trial"], r["step"], r["t"], r["spine"]) for r in known["rows"]] == [
        (r.trial, r.step, r.t, r.spine_length) for r in rows
    ]
    assert [tuple(r["tip"]) for r in known["rows"]] == [r.tip for r in rows]
    assert [tuple(r["pressures"]) for r in known["rows"]] == [r.pressures for r in rows]
    pressure, tip = recording.stream("/pressure"), recording.stream("/tip")
    assert known["newest"]["pressure"]["measured"] == pressure["measured"][-1].tolist()
    assert known["newest"]["pressure"]["setpoint"] == pressure["setpoint"][-1].tolist()
    assert known["newest"]["spine"]["length"] == recording.stream("/spine")["length"][-1]
    assert known["newest"]["vacuum"]["absolute"] == recording.stream("/vacuum")["absolute"][-1]
    assert known["newest"]["tip"]["valid"] == bool(tip["valid"][-1])
    at = {t: k for k, t in enumerate(pressure["t"].tolist())}
    seen = [p["pressure"] for p in known["points"] if "pressure" in p]
    assert seen and all(p["measured"] == pressure["measured"][at[p["t"]]].tolist() for p in seen)
    counts = {topic: len(recording.stream(topic)) for topic in recording.streams}
    assert {topic: s["count"] for topic, s in known["streams"].items()} == {t: n for t, n in counts.items() if n}


@pytest.fixture(scope="module")
def run(real_lab: VirtualLab, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What a viewer of a run was told, and its recording."""
    folder = tmp_path_factory.mktemp("watched")
    with command("run", "bending", "--rig", real_lab.rig, *SHORT, *SAID, "--out", folder, "--watch") as program:
        where = urlsplit(page := address(program))
        with (
            socket.create_connection((where.hostname, where.port)) as stuck,
            socket.create_connection((where.hostname, where.port)) as hostile,
        ):
            stuck.sendall(f"GET {where.path}events HTTP/1.1\r\n\r\n".encode())  # and takes nothing of it
            hostile.sendall(b"GET /" + b"x" * 5000)
            known = told(page)
        out, _ = program.communicate(timeout=300)
    assert program.returncode in (0, 3), out
    (file,) = folder.glob("*.mcap")
    return known, file


def test_a_viewer_of_a_run_is_told_what_is_in_its_recording(run: tuple[dict[str, Any], Path]) -> None:
    known, file = run
    demand_equal(known, file)
    assert known["outcome"] == {"outcome": "completed", "detail": ""} and known["steered"] is True
    assert known["progress"]["steps"] == known["progress"]["planned"] == len(known["about"]["steps"]) == 6
    assert known["about"]["missing"] == [] and known["about"]["limits"]["pressure"] == 250e3
    recording = Recording.open(file)
    clock, newest = known["clock"], max(recording.newest(topic) for topic in recording.streams)
    assert clock == pytest.approx(newest)


def test_what_is_said_of_a_run_is_on_its_page_and_finds_it(run: tuple[dict[str, Any], Path], cli: Cli) -> None:
    known, file = run
    assert known["about"]["labels"] == ["operator Ada", "specimen S 7", "batch <b>3</b>"]
    for words, found in ((["specimen=S 7", "--where", "batch=<b>3</b>"], [file.name]), (["operator=Eve"], [])):
        assert [one["path"] for one in cli("runs", file.parent, "--json", "--where", *words).json] == found
    path, seen, said = cli("runs", file.parent).out.splitlines()  # no path is cut where a table would be too wide
    assert (path, said) == (file.name, "  operator=Ada, specimen=S 7, batch=<b>3</b>")
    assert "5 of 5 planned states, completed" in seen
    assert "--where 'operator': write KEY=VALUE" in cli("runs", file.parent, "--where", "operator", code=2).flat_err


def test_gaps_told_are_those_of_compare(run: tuple[dict[str, Any], Path], real_lab: VirtualLab) -> None:
    _, file = run
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts a job in the background
    with command("watch", file, "--speed", "1000", "--no-browser") as program:
        signal.signal(signal.SIGINT, before)
        known = told(address(program))
        program.send_signal(signal.SIGINT)
        out, _ = program.communicate(timeout=60)
        assert program.returncode == 0, out
    demand_equal(known, file)
    case = read_case([file])
    own, prediction = expected(case, intervals=True)
    assert [g["tip"] for g in known["gaps"]] == prediction.tip.tolist()
    assert [g["gap"] for g in known["gaps"]] == (own.trials.tip - prediction.tip).tolist()


def test_the_run_of_a_rig_is_found_and_one_that_is_over_is_told(
    run: tuple[dict[str, Any], Path], real_lab: VirtualLab, tmp_path: Path, cli: Cli
) -> None:
    _, file = run
    assert "no run is active" in (said := cli("watch", real_lab.rig, code=2).flat_err) and file.name in said
    (rig := tmp_path / "rig.yaml").write_bytes(real_lab.rig.read_bytes())
    assert "has no known run" in cli("watch", rig, code=2).err
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        announce(rig, recorder.path)
        recorder.push("/vacuum", 1.0, (20e3,))
        recorder.sync()
        os.utime(recorder.path, (ahead := time.time() + 600.0, ahead))  # however long the program takes to start
        with command("watch", rig, "--json", "--no-browser") as program:
            assert program.stdout is not None
            answer = json.loads(program.stdout.readline())
            assert answer["live"] is True and answer["file"] == str(recorder.path)
            stream = events(answer["address"])
            until(stream, lambda d: d.get("streams", {}).get("/vacuum", {}).get("count") == 1)
            recorder.push("/vacuum", 2.0, (21e3,))
            recorder.sync()
            found = until(stream, lambda d: d.get("streams", {}).get("/vacuum", {}).get("count") == 2)
            assert found["newest"]["vacuum"] == {"t": 2.0, "absolute": 21e3} and found["outcome"] is None
            recorder.close("completed")
            assert until(stream, lambda d: d.get("outcome"))["outcome"]["outcome"] == "completed"
            with Recorder(tmp_path / "next.mcap", start_wall_ns=2 * 10**18) as following:
                announce(rig, following.path)
                following.push("/vacuum", 0.5, (22e3,))
                following.sync()
                found = until(stream, lambda d: d.get("about", {}).get("file") == "next.mcap")
                assert found["outcome"] is None and found["streams"] == {} and found["more"] is True
                assert found["clock"] == found["t"] == 0.0  # no age is counted from the run before
                found = until(stream, lambda d: "vacuum" in d.get("newest", {}))
                assert found["newest"]["vacuum"] == {"t": 0.5, "absolute": 22e3}


def until(stream: Iterator[tuple[str, dict[str, Any]]], fits: Any) -> dict[str, Any]:
    return next(data for _, data in stream if fits(data))


def test_the_page_of_a_campaign_goes_on_from_run_to_run_by_itself(
    real_lab: VirtualLab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_campaign(tmp_path / "night.yaml", (0.0,), 1, unload=False)
    wholes: list[dict[str, Any]] = []
    connected, prepare = timing.Event(), real_lab.fakes.prepare
    # the warm-up waits for its set-up until somebody looks, however long the page takes to start
    monkeypatch.setattr(real_lab.fakes, "prepare", lambda **setup: (connected.wait(300.0), prepare(**setup)))
    with command("campaign", file, "--rig", real_lab.rig, "--out", tmp_path / "night", "--watch") as program:
        for name, data in events(address(program)):  # one connection to the end
            connected.set()
            if name == "whole":
                wholes.append({"rows": []})
            if wholes:
                wholes[-1]["rows"] += data.pop("rows", [])
                wholes[-1] |= data
        out, _ = program.communicate(timeout=300)
    assert program.returncode in (0, 3), out
    parts = [known for known in wholes if "about" in known]  # an early viewer was told that nothing is there yet
    assert [known["part"].partition(":")[0] for known in parts] == ["Campaign night. Warm-up", "Campaign night. Run 1 of 1"]
    assert all(known["outcome"]["outcome"] == "completed" and known["steered"] for known in parts)
    assert [known["more"] for known in parts] == [True, False]
    before = [{"part": parts[0]["part"], "outcome": parts[0]["outcome"], "trouble": ""}]
    assert [known["before"] for known in parts] == [[], before]
    for known, folder in zip(parts, ("warm-up", "0001-bending"), strict=True):
        (recording,) = (tmp_path / "night" / folder).glob("*.mcap")
        assert known["about"]["file"] == recording.name
        assert [r["tip"] for r in known["rows"]] == [list(e.row.tip or ()) for e in Recording.open(recording).trials]
    assert [len(known["rows"]) for known in parts] == [0, 3]


# -- in a browser
@pytest.fixture
def page(tmp_path: Path) -> Iterator[Browser]:
    path = installed()
    if path is None:
        pytest.skip(f"none of {', '.join(BROWSERS)} is installed")
    with Browser(path, tmp_path / "profile") as browser:
        yield browser


@pytest.mark.long
def test_a_browser_shows_a_run_as_it_goes_and_what_it_shows_is_in_the_recording(
    real_lab: VirtualLab, tmp_path: Path, page: Browser
) -> None:
    words = (*SHORT, "--set", "settle.within=3600 s", "--out", tmp_path / "out", "--watch")
    with command("run", "bending", "--rig", real_lab.rig, *words) as program:
        try:
            shown_at = address(program)
            # No state can be read from now on, however long a browser takes.
            real_lab.fakes.door.answer(b'{"tip_visible": false}')
            page.open(shown_at)
            page.until("document.getElementById('lead').textContent.includes('hidden')", 120)
            real_lab.fakes.door.answer(b'{"tip_visible": true}')
            page.until("live.state", 120)
            page.until("live.outcome", 240)
            out, _ = program.communicate(timeout=120)
        finally:
            real_lab.fakes.door.answer(b'{"tip_visible": true}')
    assert program.returncode in (0, 3), out
    (file,) = (tmp_path / "out").glob("*.mcap")
    demand_equal(page.value("live"), file)
    page.until("document.getElementById('lead').textContent === 'Completed'")
    page.until("live.compared === live.of && document.querySelector('#rows tr').lastChild.textContent !== '–'")
    page.until("!document.getElementById('key-model').hidden && document.getElementById('key-interval').hidden")
    shown, rows = page.text(), Recording.open(file).trials
    assert "95 %" not in shown and "robot.yaml is not fitted" in shown
    x, y, z = (f"{1e3 * v:.2f}".replace("-0.00", "0.00") for v in rows[-1].row.tip or ())
    assert f"{x}\t{y}\t{z}" in shown and f"{len(rows)} states read" in shown
    assert page.said == []
    inked = "(id) => new Set(document.getElementById(id).getContext('2d').getImageData(0, 0, 300, 200).data).size"
    for canvas in ("plane-xy", "plane-xz", "plane-yz", "chart-pressure", "chart-spine", "chart-vacuum"):
        assert page.value(f"({inked})('{canvas}')") > 20, canvas


@pytest.mark.long
def test_buttons_pause_a_run_and_a_note_is_written_down(real_lab: VirtualLab, tmp_path: Path, page: Browser) -> None:
    words = ("--set", "spine_lengths=[0.0, 3 cm]", *SHORT[2:], "--set", "rate=1 kPa/s", "--out", tmp_path / "out", "--watch")
    press = "document.getElementById('{}').click()"
    with command("run", "bending", "--rig", real_lab.rig, *words) as program:
        page.open(address(program))
        page.until("live.steered", 120)
        page.value(press.format("pause"))
        page.until("live.pause && live.pause.begun", 120)
        page.until("document.getElementById('pause').textContent === 'Go on'")
        page.until("document.getElementById('lead').textContent.startsWith('Paused for')")
        assert float(real_lab.fakes.plant.regulator.max()) < 5e3
        page.value(f"document.getElementById('note').value = {json.dumps(HOSTILE)}")
        page.value("document.getElementById('note-form').requestSubmit()")
        page.until("live.log.some((line) => line.level === 'note')")
        page.until("document.getElementById('log').textContent.includes('note: <img src=x')")
        page.value(press.format("pause"))
        page.until("live.pause === null")
        page.value(press.format("skip"))
        page.until("live.log.some((line) => line.text === 'skip: done')", 120)
        page.value(press.format("finish"))
        page.until("live.outcome", 240)
        page.until("document.getElementById('steer').hidden")
        assert page.value("document.images.length") == 0 and page.said == []
        out, _ = program.communicate(timeout=120)
    assert "Note: " in out and "(page)" in out and "\x1b" not in out
    requests = Recording.open(recorded(tmp_path / "out")).requests
    assert {r.by for r in requests} == {"page"}
    assert [r.kind for r in requests if r.done] == ["pause", "note", "go on", "skip"]
    assert [r.text for r in requests if r.kind == "note"] == [HOSTILE]


@pytest.mark.long
def test_in_a_campaign_a_browser_goes_on_with_the_next_run_and_its_buttons_are_for_that(
    real_lab: VirtualLab, tmp_path: Path, page: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_campaign(tmp_path / "night.yaml", (0.0,), 1, unload=False)
    campaign = yaml.safe_load(file.read_text())
    (bending,) = campaign["protocols"]
    bending["parameters"]["settle"]["within"] = "3600 s"
    bending["conditions"] = {"tip_mass": ["0 g", "20 g"]}  # so that each run is prepared
    file.write_text(yaml.safe_dump(campaign))
    fakes = real_lab.fakes
    prepare = fakes.prepare

    def prepare_and_hide(*setup: Any, **named: Any) -> None:
        """No state of the second run can be read, however long a browser takes."""
        prepare(*setup, **named)
        if list(tmp_path.glob("night/0001-bending/*.mcap")):
            fakes.door.answer(b'{"tip_visible": false}')

    monkeypatch.setattr(fakes, "prepare", prepare_and_hide)
    with command("campaign", file, "--rig", real_lab.rig, "--out", tmp_path / "night", "--watch") as program:
        try:
            page.open(address(program))
            page.until("document.getElementById('part').textContent.includes('Run 2 of 2')", 240)
            page.until("document.getElementById('lead').textContent.includes('hidden')", 120)
            page.until("!document.getElementById('steer').hidden")
            page.value("document.getElementById('note').value = 'of the second'")
            page.value("document.getElementById('note-form').requestSubmit()")
            page.until("document.getElementById('log').textContent.includes('note: of the second (page)')", 120)
            fakes.door.answer(b'{"tip_visible": true}')
            page.until("live.more === false", 240)
            page.until("document.getElementById('lead').textContent === 'Completed'")
            out, _ = program.communicate(timeout=120)
        finally:
            fakes.door.answer(b'{"tip_visible": true}')
    assert program.returncode in (0, 3), out
    (recording,) = (tmp_path / "night" / "0002-bending").glob("*.mcap")
    assert [r.text for r in Recording.open(recording).requests if r.kind == "note"] == ["of the second"]
    assert page.said == []


@pytest.mark.long
def test_a_recording_has_no_buttons_and_says_what_is_silent_or_not_safe(tmp_path: Path, page: Browser) -> None:
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        for k in range(60):
            recorder.push("/pressure", 0.1 * k, ((0.0,) * 9, (0.0,) * 9))
            if k < 10:
                recorder.push("/vacuum", 0.1 * k, (20e3,))
            recorder.sync()
        recorder.close("failed", "gauge: no answer", safe=False)
    box = "[...document.querySelectorAll('#numbers .bad')].map((e) => e.innerText).join()"
    with command("watch", recorder.path, "--no-browser") as program:
        page.open(address(program))
        page.until("document.getElementById('lead').textContent.startsWith('No data on /vacuum for ')")
        page.until(f"/pressure in the spine.*20.0 kPa abs, .* old/s.test({box})")
        page.until("live.outcome")
        assert page.value("live.steered") is False and page.value("document.getElementById('steer').hidden")
        lead = "The safe state was not confirmed. Failed: gauge: no answer"
        page.until(f"document.getElementById('lead').textContent === {json.dumps(lead)}")
        page.until(f"/pressure in the spine.*20.0 kPa abs, .* before the end/s.test({box})")
        assert page.value("document.getElementById('planes').hidden") and page.said == []
        assert "no motion capture in this recording" in page.text()


@pytest.mark.long
def test_a_browser_shows_text_from_outside_as_text_and_asks_for_nothing_beyond_the_page(tmp_path: Path, page: Browser) -> None:
    plan = json.dumps({"steps": [{"label": HOSTILE, "seconds": 1.0}]}).encode()
    robot = json.dumps({"name": HOSTILE}).encode()
    attachments = {"plan.json": plan, "robot.yaml": robot, "protocol.yaml": json.dumps({"protocol": HOSTILE}).encode()}
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments=attachments) as recorder:
        recorder.push("/vacuum", 1.0, (20e3,))
        recorder.log("error", HOSTILE)
        recorder.close("failed", HOSTILE)
    with command("watch", recorder.path, "--speed", "1000", "--no-browser") as program:
        page.open(address(program))
        page.until("live.outcome")
        page.until(f"document.getElementById('lead').textContent === {json.dumps('Failed: ' + SHOWN)}")
        assert page.text().count(SHOWN) >= 3
        assert page.value("document.images.length + document.querySelectorAll('[onerror]').length") == 0
        asked = page.value("performance.getEntriesByType('resource').map((e) => e.name)")
        assert asked and all(name.startswith(page.value("location.origin")) for name in asked)
        assert page.said == []
