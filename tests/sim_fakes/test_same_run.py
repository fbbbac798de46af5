"""A run of simulated time is the same to the last bit whatever else the computer does."""

from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from lab.cli import main
from lab.verbs.fakes import write_rig
from recordings.file.reader import Recording
from sim_fakes.rig import FakeRig
from tests.simulated.clock import SimulatedClock

SHORT = ("steps=3", "min_samples=20", "zero_samples=20", "spine_lengths=[0.05]")


def recorded(folder: Path) -> Recording:
    with SimulatedClock() as clock, FakeRig(speed=20.0, seed=1) as fakes:
        write_rig(fakes, folder / "rig.yaml")
        settings = [word for setting in SHORT for word in ("--set", setting)]
        assert main(["run", "stiffness", "--rig", str(folder / "rig.yaml"), "--out", str(folder), *settings]) in (0, 3)
    clock.close()
    (file,) = folder.glob("*.mcap")
    return Recording.open(file)


def order(recording: Recording) -> list[str]:
    """What each message of the file is of, in the order in which they stand there."""
    with recording.path.open("rb") as file:
        return [channel.topic for _, channel, _ in make_reader(file).iter_messages(log_time_order=False)]


def test_two_runs_record_the_same_bits(tmp_path: Path) -> None:
    first, second = recorded(tmp_path / "first"), recorded(tmp_path / "second")
    assert order(first) == order(second)
    for topic in first.streams:
        np.testing.assert_array_equal(first.stream(topic), second.stream(topic), err_msg=topic)
    assert [event.row for event in first.trials] == [event.row for event in second.trials]
