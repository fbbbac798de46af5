"""What the page of a run is told: numbers of the file, unchanged, text that does nothing, and what the model says of each tip."""

import asyncio
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import events, running

import timing
from lab.console import seconds_left
from lab.files.robot_file import paper_robot
from lab.live import show as shown
from lab.live.picture import PLAN, SAME_MOMENT, About, Picture, about
from lab.live.show import Show, ShownRecording, following, place
from lab.live.viewers import event
from recordings.file.contents import Contents
from recordings.file.tail import Tail
from recordings.file.writer import Recorder
from recordings.trials import TrialRow
from tests.recordings.synthetic_run import REST, state

# ------------------------------------------------------------------ numbers of the file
HOSTILE = "[/red] \x1b[2J <script>alert(1)</script>"
SHOWN = "[/red] \\x1b[2J <script>alert(1)</script>"
PROTOCOL = b"protocol: bending\n"


def picture(path: Path) -> Picture:
    """Of a whole file."""
    with Tail(path) as tail:
        pieces = tail.read()
        found = Picture(about(path, tail.contents))
        while pieces:
            found.take(pieces)
            pieces = tail.read()
        found.end(tail.contents.metadata, tail.contents.finished)
        return found


def sent(found: Picture) -> dict[str, Any]:
    """What a viewer is told at first."""
    _, data = event("whole", found.whole()).decode().split("\ndata: ")
    told: dict[str, Any] = json.loads(data)
    return told


def started(path: Path, **attachments: bytes) -> Recorder:
    return Recorder(path, start_wall_ns=10**18, attachments={name.replace("_", "."): data for name, data in attachments.items()})


def test_the_newest_samples_are_those_of_the_file_to_the_last_bit_and_no_peak_of_the_force_is_missed(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    with started(tmp_path / "run.mcap") as recorder:
        peaks = []
        for piece in range(5):
            raw = random.normal(size=(20, 6))
            for k, values in enumerate(raw):
                recorder.push("/force", piece + 0.01 * k, (tuple(values), (0.1,) * 6))
            peaks.append(np.sqrt(((raw[:, :3] - 0.1) ** 2).sum(axis=1)).max())
            recorder.push("/vacuum", piece + 0.3, (20e3 + random.normal(),))
            recorder.sync()
    with Tail(recorder.path) as tail:
        vacuum = [p.samples["/vacuum"]["absolute"][-1] for p in tail.read() if "/vacuum" in p.samples]
    seen = sent(picture(recorder.path))
    assert [p["force"]["peak"] for p in seen["points"] if "force" in p] == pytest.approx(peaks, rel=1e-15)
    assert [p["vacuum"]["absolute"] for p in seen["points"] if "vacuum" in p] == vacuum
    assert seen["newest"]["vacuum"] == {"t": 4.3, "absolute": vacuum[-1]}
    assert seen["streams"]["/force"]["count"] == 100 and seen["streams"]["/force"]["rate"] == pytest.approx(20, rel=0.05)
    assert seen["outcome"] == {"outcome": "completed", "detail": ""}


def tip(valid: bool, x: float = 0.0) -> tuple[object, ...]:
    return (0.0, 1, (x, 0.0, 0.4), (1.0, 0.0, 0.0, 0.0), 0.0, valid, ())


def test_a_hidden_tip_says_when_it_was_last_seen(tmp_path: Path) -> None:
    with started(tmp_path / "run.mcap") as recorder:
        recorder.push("/tip", 1.0, tip(True, 0.01))
        recorder.push("/tip", 1.1, tip(False, float("nan")))
        recorder.sync()
        recorder.push("/tip", 2.0, tip(False, float("nan")))
    newest = sent(picture(recorder.path))["newest"]["tip"]
    assert newest == {"t": 2.0, "position": [None, 0.0, 0.4], "valid": False, "seen": 1.0}


def test_samples_that_the_writer_dropped_are_counted_at_once(tmp_path: Path) -> None:
    with started(tmp_path / "run.mcap") as recorder:
        for t in (1.0, 2.0, 1.5, 1.6, 3.0):  # two are out of order
            recorder.push("/vacuum", t, (20e3,))
        recorder.note_lost("/vacuum", 7)
        recorder.sync()
        with Tail(recorder.path) as tail:
            now = Picture(about(recorder.path, tail.contents)).take(tail.read())["streams"]["/vacuum"]
    assert (now["count"], now["dropped"], now["lost"]) == (3, 2, None)
    after = picture(recorder.path).whole()["streams"]["/vacuum"]
    assert (after["dropped"], after["lost"]) == (2, 7)


def test_text_from_outside_does_nothing(tmp_path: Path) -> None:
    plan = json.dumps({"steps": [{"label": HOSTILE, "seconds": 1.0}]}).encode()
    with started(tmp_path / "run.mcap", plan_json=plan, protocol_yaml=PROTOCOL) as recorder:
        recorder.log("warning", HOSTILE)
    whole = picture(recorder.path).whole()
    assert whole["log"][-1]["text"] == SHOWN and whole["log"][-1]["level"] == "warning"
    assert whole["about"]["steps"] == [[SHOWN, 1.0]] and "\x1b" not in json.dumps(whole, ensure_ascii=False)


@pytest.mark.parametrize(
    "plan", [b"{", b"[]", b'{"steps": [{"label": 1}]}', b'{"steps": [{"label": "a", "seconds": NaN}]}', b"\xff"]
)
def test_attachments_that_cannot_be_understood_leave_out_what_they_would_tell(tmp_path: Path, plan: bytes) -> None:
    contents = Contents("", 0, attachments={PLAN: plan, "rig.yaml": b"name: [", "robot.yaml": b"\xff", "protocol.yaml": b"- 1"})
    found = about(tmp_path / "run.mcap", contents)
    assert found.steps == () and found.limits == {} and found.protocol == "" and found.robot == ""
    json.dumps(found.to_dict(), allow_nan=False)


def test_limits_are_the_lower_ones_of_rig_and_robot(tmp_path: Path) -> None:
    rig = b"""
name: rig
robot: robot.yaml
limits: {max_force: 12 N}
instruments:
  pressure: {driver: alicat, port: /dev/null, units: [A, B, C], chambers: [[1, 2, 3], [4, 5, 6], [7, 8, 9]], full_scale: 413 kPa}
"""
    robot = re.sub(rb"max_pressure: [^\n]*", b"max_pressure: 150 kPa", paper_robot().read_bytes())
    contents = Contents("", 0, attachments={"rig.yaml": rig, "robot.yaml": robot, "protocol.yaml": PROTOCOL})
    found = about(tmp_path / "run.mcap", contents)
    assert not [why for why in found.missing if "limits" in why], found.missing
    assert (found.limits["pressure"], found.limits["force"], found.protocol) == (150e3, 12.0, "bending")
    assert found.channels == ((1, 2, 3), (4, 5, 6), (7, 8, 9))


def test_time_left_follows_the_pace_of_this_run_also_when_it_resumes_another(tmp_path: Path) -> None:
    with started(tmp_path / "run.mcap") as recorder:
        recorder.push("/vacuum", 10.0, (20e3,))
        recorder.progress(10.0, 6, 12, 60.0, 120.0)
        recorder.sync()
        recorder.push("/vacuum", 30.0, (20e3,))
        recorder.progress(30.0, 7, 12, 70.0, 120.0)
    found = picture(recorder.path).progress
    assert found is not None and (found["steps"], found["planned"]) == (7, 12)
    assert found["left"] == pytest.approx(100.0)  # ten planned seconds took twenty
    assert seconds_left(0.0, 100.0, 5.0, 20.0) == 5.0


def test_numbers_that_are_none_are_null_and_end_nothing(tmp_path: Path) -> None:
    nan = float("nan")
    with started(tmp_path / "run.mcap") as recorder:
        recorder.push("/vacuum", 1.0, (nan,))
        recorder.push("/force", 1.0, ((nan,) * 6, (0.0,) * 6))
        recorder.progress(1.0, 1, 2, nan, nan)
    told = sent(picture(recorder.path))
    assert told["newest"]["vacuum"]["absolute"] is None and told["newest"]["force"]["peak"] is None
    assert told["progress"]["seconds"] is None and told["progress"]["steps"] == 1


def test_a_long_run_is_caught_up_with_whole_also_when_nothing_more_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.live.show.AT_ONCE", 3)
    recorder = started(tmp_path / "run.mcap")
    for k in range(20):
        recorder.push("/vacuum", 1.0 + k, (20e3,))
        recorder.sync()

    async def caught_up() -> int:
        with Tail(recorder.path) as tail:
            return sum([len(piece.samples.get("/vacuum", ())) async for some in following(tail, lambda: True) for piece in some])

    assert asyncio.run(caught_up()) == 20
    recorder.close("completed")


# ------------------------------------------------------------------ what the model says
WITHIN = 60.0
OFF = 0.004
"""m by which the tip of these recordings misses the model."""
PRESSURE = tuple(2e3 + k for k in range(9))
ASKED = state(rule=REST, ramp_end=1.0, rate=1.0, targets=PRESSURE)


def expected(pressure: float) -> list[float]:
    return [1e-6 * pressure, 0.0, 0.4]


def moment(recorder: Recorder, t: float, pressure: float, hidden: bool = False) -> None:
    """A sample of pressure and tip."""
    x, y, z = expected(pressure)
    recorder.push("/pressure", t, ((pressure,) * 9, (pressure,) * 9))
    recorder.push("/tip", t, (0.0, 1, (x + OFF, y, z), (1.0, 0.0, 0.0, 0.0), 0.0, not hidden, ()))
    recorder.sync()


class Answers:
    """A model that answers when `until` allows it."""

    until: Callable[[], bool]

    def __init__(self, robot: str) -> None:
        pass

    async def start(self) -> bool:
        return False

    async def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        until = type(self).until
        while not until():
            await asyncio.sleep(0.005)
        if "rows" in question:
            none = {"low": None, "high": None}
            return {"gaps": [{"tip": [0.0] * 3, "gap": [0.0] * 3, **none} for _ in question["rows"]]}
        return {"tip": expected(question["now"]["pressures"][0]), "low": None, "high": None}

    def stop(self) -> None:
        pass


def test_a_late_answer_of_the_model_comes_with_the_tip_that_it_is_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "ModelProcess", Answers)
    asked, over = timing.Event(), timing.Event()

    def answering() -> bool:
        asked.set()
        return over.is_set()

    monkeypatch.setattr(Answers, "until", staticmethod(answering), raising=False)
    at = place()
    recorder = Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": b"name: r"})
    recorder.state(0.0, ASKED)
    with at.listening, running(Show(at, ShownRecording(recorder.path)), stay=True):
        moment(recorder, 1.0, 1e4)
        assert asked.wait(60.0)
        moment(recorder, 2.0, 2e4)
        recorder.close("completed")
        newest, answers = 0.0, []
        for _, data in events(at.address):
            newest = data.get("t", newest)
            if newest == 2.0:
                over.set()
            if data.get("now") is not None:
                answers.append((newest, data["now"]["t"]))
                x, y, z = expected(1e4 * data["now"]["t"])
                assert data["now"]["tip"] == [x, y, z] and data["now"]["measured"] == [x + OFF, y, z]
                if data["now"]["t"] == 2.0:
                    break
    assert answers == [(2.0, 1.0), (2.0, 2.0)]


def test_a_prediction_has_no_tip_where_none_was_seen_at_its_moment(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        recorder.state(0.0, ASKED)
        moment(recorder, 1.0, 3e3)
        moment(recorder, 2.0, 4e3, hidden=True)
        moment(recorder, 3.0, 5e3)
        recorder.push("/pressure", 3.0 + 2 * SAME_MOMENT, ((6e3,) * 9, (6e3,) * 9))
    picture, found = Picture(About("run.mcap")), []
    with Tail(recorder.path) as tail:
        for piece in tail.read():
            picture.take([piece])
            if (question := picture.question()) is not None:
                found.append((question[0]["now"]["pressures"][0], question[1]["measured"]))
    seen = dict(found)
    assert seen[3e3] == [expected(3e3)[0] + OFF, 0.0, 0.4] and seen[5e3] == [expected(5e3)[0] + OFF, 0.0, 0.4]
    assert seen[4e3] is None and seen[6e3] is None


def test_the_page_of_a_run_that_ends_waits_for_what_the_model_says_of_its_last_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shown, "ModelProcess", Answers)
    over = timing.Event()
    monkeypatch.setattr(Answers, "until", staticmethod(over.is_set), raising=False)
    at = place()
    recorder = Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": b"name: r"})
    show = Show(at, ShownRecording(recorder.path))
    with at.listening, running(show, stay=False):
        stream = events(at.address)
        known = next(stream)[1]
        for step in (1, 2):
            number = recorder.state(float(step), ASKED)
            moment(recorder, step + 0.5, 3e3)
            row = TrialRow(1, step, "bending", 1, "load", step + 0.6, 0.1, PRESSURE, tip=(0.0, 0.0, 0.4))
            recorder.trial(step + 0.6, number, row)
        recorder.close("completed")
        for _, data in stream:
            known |= data
            if known.get("outcome"):  # the model has not said anything yet
                assert known["of"] == 2 and known["compared"] == 0
                show.over()
                over.set()
                break
        for _, data in stream:
            known |= data
    assert known["compared"] == known["of"] == 2 and len(known["gaps"]) == 2
