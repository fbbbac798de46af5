"""A channel that does not follow is told while the others are ramped without a pause, through the real wire."""

import contextlib
import itertools
from typing import Any

import pytest
from house import House

import timing
from drivers.interfaces import PressureSample
from lab.files.rig_file import load_rig
from lab.guard.messages import Event
from lab.rig.actuators import Actuators
from timing import RigClock


@pytest.mark.parametrize("failure", ["burst", "stuck"])
def test_a_channel_that_fails_in_a_sweep_of_the_others_is_told_in_time(house: House, failure: str) -> None:
    """Channel 1 bursts where it is held, or its regulator's reading stands still while it is ramped as well."""
    house.change(without=("arm", "force", "mocap"))
    rig = load_rig(house.rig)
    heard: list[Any] = []
    others: list[float] = []
    actuators = Actuators(rig, RigClock(rig.clock.speed), lambda name, sample: heard.append(sample), heard.append)
    try:
        actuators.open("pressure")
        give_up = timing.now() + 60.0
        for turn in itertools.count():
            theirs = (20e3, 60e3, 100e3, 60e3)[turn % 4]  # never steady for pressure_error_time
            mine = 80e3 if failure == "burst" or turn < 20 else 80e3 + 2e3 * min(turn - 20, 60)
            if turn == 20 and failure == "burst":
                house.fakes.accidents.begin("burst")
            elif turn == 20:
                house.fakes.lines["pressure"].faults.extra["stuck"] = "A"
            with contextlib.suppress(Exception):  # a regulator may be late on a busy computer
                others.append(actuators.call("pressure", "set", (mine, theirs, theirs))[1])
            if any(isinstance(h, Event) and h.kind in ("pause", "landed") for h in heard) or timing.now() > give_up:
                break
            timing.sleep(0.02)
    finally:
        actuators.close()
    told = next((i for i, h in enumerate(heard) if isinstance(h, Event) and h.kind != "clipped"), len(heard) - 1)
    assert isinstance(heard[told], Event) and heard[told].kind == "pause", heard[-20:]
    assert "channel 1" in heard[told].text and "instead of its set-point" in heard[told].text
    before = [h for h in heard[:told] if isinstance(h, PressureSample)]
    decisive = next(h for h in heard[told:] if isinstance(h, PressureSample))
    away = [abs(s.setpoint[0] - s.measured[0]) > rig.limits.pressure_error for s in before]
    since = before[len(away) - away[::-1].index(False)].t
    longest_gap = max(b.t - a.t for a, b in itertools.pairwise([*before, decisive]))
    assert decisive.t - since <= rig.limits.pressure_error_time + 1.0 + longest_gap
    assert max(others[-10:]) - min(others[-10:]) > 10e3, "the others were ramped meanwhile"
