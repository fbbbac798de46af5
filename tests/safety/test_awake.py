"""A silence counts only while this process was awake to hear something."""

import os

import pytest
from house import House

import timing
from lab.guard.pulse import LONGEST_LOOK, Awake
from lab.rig.actuators import ActuatorsLost
from lab.rig.assembly import Rig


class Host:
    """The time of a computer, as far as a test lets it go."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize(
    ("steps", "counted"), [([0.1] * 10 + [3600.0], 1.0 + LONGEST_LOOK), ([5.0] * 10, 10 * LONGEST_LOOK)], ids=["paused", "late"]
)
def test_time_that_the_process_was_away_does_not_count_and_each_look_does(steps: list[float], counted: float) -> None:
    host = Host()
    clock = Awake(host)
    for step in steps:
        host.now += step
        clock.look()
    assert clock.now == pytest.approx(counted)


def test_a_silence_on_a_busy_computer_is_put_down_to_it_before_a_cable(monkeypatch: pytest.MonkeyPatch) -> None:
    assert timing.busy_or("check its cable").endswith("check its cable")
    monkeypatch.setattr(os, "getloadavg", lambda: (1e4, 1.0, 1.0))
    cores = len(os.sched_getaffinity(0))
    assert timing.busy_or("check its cable") == (
        f"this computer is busy: load 10000 on {cores} core{'s' * (cores > 1)}, end other programs; if that does not help, "
        "check its cable"
    )


@pytest.mark.real
def test_a_guard_that_was_lost_tells_what_it_had_of_a_busy_computer(
    small: House, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getloadavg", lambda: (1e4, 1.0, 1.0))
    with pytest.raises(
        ActuatorsLost, match=r"no answer within 0 s; the guard has had \d+\.\d s of processor time; this computer is"
    ):
        rig.actuators._answer(-1, "start", 0.0)
