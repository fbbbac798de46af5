"""Playing a recording: all messages, in the order of time, the same at any pace; and concluding as they come in."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import concluded

from recordings.campaign.replay import replay_states
from recordings.file.player import Played, play
from recordings.file.reader import Recording


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return concluded(tmp_path_factory.mktemp("played") / "run.mcap")


@dataclass
class Still:
    """A clock that moves only when it is slept on."""

    now: float = 100.0
    slept: list[float] = field(default_factory=list)

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


def lines(path: Path, speed: float = float("inf")) -> list[str]:
    out: list[str] = []
    play(Recording.open(path), lambda message: out.append(message.to_json()), speed, Still())
    return out


def test_every_message_is_played_once_in_the_order_of_time(path: Path) -> None:
    recording, played = Recording.open(path), [json.loads(line) for line in lines(path)]
    assert len(played) == sum(len(recording.log_times(topic)) for topic in recording.topics)
    assert (np.diff([message["log_time"] for message in played]) >= 0).all()
    for topic in ("/tip", "/force"):
        samples = [message["fields"] for message in played if message["topic"] == topic]
        assert [s["t"] for s in samples] == recording.stream(topic)["t"].tolist()
    assert played[-1]["topic"] == "/force" or played[-1]["t"] <= 7.0
    (trial,) = [message for message in played if message["topic"] == "/trial"]
    assert json.loads(trial["fields"]["json"])["trial"] == 1


def test_five_replays_at_five_paces_have_one_sha256(path: Path) -> None:
    digests = {hashlib.sha256("\n".join(lines(path, speed)).encode()).hexdigest() for speed in (0.1, 1, 7, 1e3, 1e9)}
    assert len(digests) == 1
    rows = {tuple(r.row.to_json() for r in replay_states(Recording.open(path)) if r.row) for _ in range(5)}
    assert len(rows) == 1


def test_messages_are_sent_at_the_pace_asked_for(path: Path) -> None:
    clock, sent = Still(), []
    play(Recording.open(path), lambda message: sent.append((clock.now, message.t)), 4.0, clock)
    first = sent[0][1]
    assert all(now == pytest.approx(100.0 + (t - first) / 4) for now, t in sent)


def test_a_slow_sink_delays_and_leaves_out_nothing(path: Path) -> None:
    clock, sent = Still(), []

    def slow(message: Played) -> None:
        clock.now += 0.05
        sent.append(message)

    assert play(Recording.open(path), slow, 1.0, clock) == len(sent) == len(lines(path))


def test_a_speed_that_is_none_is_refused(path: Path) -> None:
    with pytest.raises(ValueError, match="above 0"):
        play(Recording.open(path), print, 0.0)
