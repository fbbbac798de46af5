"""What the guard makes of set-points and readings."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.errors import DeviceFault
from drivers.interfaces import GaugeSample, PressureSample, SpineSample
from lab.judge import Finding, Judge, NotHeld
from lab.rig_file import RigFile

RIG = RigFile.model_validate(
    {
        "name": "desk",
        "robot": Path("robot.yaml"),
        "instruments": {
            "pressure": {"driver": "alicat", "port": "/dev/null"},
            "spine": {"driver": "dynamixel", "port": "/dev/null", "metres_per_turn": 0.1},
        },
    }
)


def pressure(t: float, asked: float, measured: float) -> PressureSample:
    return PressureSample(t, (asked, 0.0, 0.0), (measured, 0.0, 0.0))


def steady(asked: float, measured: float, seconds: float) -> Finding | None:
    """The last finding of a steady set-point."""
    judge, found = Judge(RIG), None
    for i in range(round(seconds / 0.5) + 1):
        found = judge.judge("pressure", pressure(0.5 * i, asked, measured))
    return found


def test_setpoints_whose_sum_is_within_the_limit_pass_unchanged() -> None:
    assert Judge(RIG).setpoints((150e3, 150e3, 150e3)) == (150e3, 150e3, 150e3)


def test_setpoints_beyond_the_sum_over_the_chambers_are_scaled_down_together() -> None:
    allowed = Judge(RIG).setpoints((300e3, 300e3, 150e3))
    assert sum(3 * p for p in allowed) == pytest.approx(RIG.limits.max_total_pressure)
    assert allowed[0] / allowed[2] == pytest.approx(2.0)


def test_a_setpoint_that_is_no_number_is_left_to_the_driver_to_refuse() -> None:
    assert math.isnan(Judge(RIG).setpoints((math.nan, 0.0, 0.0))[0])


def test_a_pressure_that_is_held_is_fine() -> None:
    assert steady(200e3, 195e3, 20.0) is None


def test_a_pressure_that_lags_behind_a_ramp_is_fine() -> None:
    judge = Judge(RIG)
    assert [judge.judge("pressure", pressure(t, 25e3 * t, max(0.0, 25e3 * (t - 2)))) for t in range(10)] == [None] * 10


@pytest.mark.parametrize("measured", [0.0, 160e3])
def test_a_pressure_that_stays_below_its_setpoint_asks_for_a_pause(measured: float) -> None:
    found = steady(200e3, measured, 6.0)
    assert found is not None and found.act == "pause" and isinstance(found.error, NotHeld)
    assert "leak" in str(found.error) and "channel 1" in str(found.error)


def test_a_pressure_that_stays_above_its_setpoint_lands_the_rig() -> None:
    found = steady(0.0, 60e3, 6.0)
    assert found is not None and found.act == "land" and "does not let off" in str(found.error)


@pytest.mark.parametrize("measured", [math.nan, math.inf, 340e3])
def test_a_pressure_that_cannot_be_or_must_not_be_lands_the_rig_at_once(measured: float) -> None:
    found = Judge(RIG).judge("pressure", pressure(0.0, 300e3, measured))
    assert found is not None and found.act == "land" and isinstance(found.error, DeviceFault)


def test_chambers_that_hold_too_much_in_sum_land_the_rig() -> None:
    found = Judge(RIG).judge("pressure", PressureSample(0.0, (300e3,) * 3, (300e3,) * 3))
    assert found is not None and found.act == "land" and "sum" in str(found.error)


@pytest.mark.parametrize(("absolute", "lands"), [(20e3, False), (5e3, True), (math.nan, True)])
def test_a_vacuum_beyond_the_limit_lands_the_rig(absolute: float, lands: bool) -> None:
    assert (Judge(RIG).judge("gauge", GaugeSample(0.0, absolute)) is not None) is lands


@pytest.mark.parametrize(
    ("length", "homed", "lands"), [(0.3, True, False), (0.4, True, True), (-0.05, True, True), (9, False, False)]
)
def test_a_spine_outside_of_its_range_lands_the_rig_once_its_zero_is_known(
    length: float, homed: bool, lands: bool
) -> None:
    sample = SpineSample(0.0, length, 0.0, length, False, homed)
    assert (Judge(RIG).judge("spine", sample) is not None) is lands


def test_a_regulator_that_forgot_its_setpoint_lands_the_rig() -> None:
    judge = Judge(RIG)
    judge.told = (100e3, 0.0, 0.0)
    found = [judge.judge("pressure", pressure(t, held, 0.0)) for t, held in ((0.0, 100e3), (0.1, 0.0), (0.2, 0.0))]
    assert found[:2] == [None, None]
    assert found[2] is not None and found[2].act == "land" and "restarted" in str(found[2].error)
