"""What the model says on the page of `lab watch`: always of the tip that it comes with, and of every state, also of the last."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from page_events import events

import timing
from lab.live import show as shown
from lab.live.about import About
from lab.live.picture import SAME_MOMENT, Picture
from lab.live.show import Part, Show, place
from recordings.file.tail import Tail
from recordings.file.writer import Recorder
from recordings.states.rules import Settled, State
from recordings.trials import TrialRow

WITHIN = 60.0
OFF = 0.004
"""m by which the tip of these recordings misses the model."""
PRESSURE = tuple(2e3 + k for k in range(9))
ASKED = State(
    trial=1, step=1, protocol="bending", repeat=1, branch="load", t_start=0.0, ramp_end=1.0, rate=1.0, targets=PRESSURE,
    spine_length=0.1, tip_mass=0.0, rule=Settled(still=0.6, still_distance=1e-3, min_samples=3, average=0.4),
)  # fmt: skip


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

    async def stop(self) -> None:
        pass


@contextlib.contextmanager
def running(show: Show, stay: bool) -> Iterator[None]:
    thread = timing.Thread(target=show.run, args=(stay,))
    thread.start()
    try:
        yield
    finally:
        show.over()
        thread.join(WITHIN)
        assert not thread.is_alive()


def test_a_late_answer_of_the_model_comes_with_the_tip_that_it_is_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "Model", Answers)
    monkeypatch.setattr(shown, "ASK", 0.0)
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": b"name: r"}) as recorder:
        recorder.state(0.0, ASKED)
        for k in range(1, 101):
            moment(recorder, 0.1 * k, 1e3 * k)
    at = place()
    show = Show(at, Part(recorder.path), 20.0)
    newest = 0.0

    def gone_on() -> bool:
        """The replay is a second further than at the question."""
        nonlocal newest
        picture = show._picture
        if picture is None or (picture.t < newest + 1.0 and not picture.ended):
            return False
        newest = picture.t
        return True

    monkeypatch.setattr(Answers, "until", staticmethod(gone_on), raising=False)
    late, t = [], 0.0
    with at.listening, running(show, stay=True):
        for _, data in events(at.address):
            t = data.get("t", t)
            if "now" in data and data["now"] is not None:
                now = data["now"]
                late.append(t - now["t"])
                x, y, z = expected(1e4 * now["t"])
                assert now["tip"] == pytest.approx([x, y, z])
                assert now["measured"] == pytest.approx([x + OFF, y, z])
                if now["t"] == pytest.approx(10.0):
                    break
    assert max(late) > 0.5 and late[-1] == 0.0  # the last one is of the recording's end


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
    monkeypatch.setattr(shown, "Model", Answers)
    over = timing.Event()
    monkeypatch.setattr(Answers, "until", staticmethod(over.is_set), raising=False)
    at = place()
    recorder = Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": b"name: r"})
    show = Show(at, Part(recorder.path))
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
