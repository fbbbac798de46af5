"""What the pendant and the safety system of the arm are set to: read at `open`, before each trial and before each motion."""

import re
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any

import pytest
from ur5_rig import Rig, a_rig, an_arm, discard, raised

import timing
from drivers.errors import DeviceFault, NotReady, Unreachable, WrongDevice
from drivers.ur5.driver import UR5, Config
from drivers.ur5.motion import top_speed
from drivers.ur5.safety import stop_text
from drivers.ur5.state import UR5State
from drivers.ur5.wire import UrController
from sim_fakes.ur import server
from tests.simulated.bench import raises, wait_until
from tests.simulated.clock import SimulatedClock
from timing import RigClock

E_SERIES = "5.11.0.108318"


@pytest.fixture(scope="module")
def rig(shared_clock: SimulatedClock) -> Iterator[Rig]:
    with a_rig(version=E_SERIES) as rig:
        yield rig


@pytest.fixture(autouse=True)
def as_delivered(rig: Rig) -> Iterator[None]:
    yield
    rig.process.backdoor("safety", name="NORMAL")
    rig.process.backdoor("clear")
    rig.process.backdoor("remote", on=True)
    rig.process.backdoor("starting", text="")
    rig.process.backdoor("stuck", variables={})
    rig.process.backdoor("set", slider=1.0, scaling=1.0, payload=0.8, payload_centre=[0, 0, 0.05], tcp=[0] * 6)


def a_ur5e(rig: Rig, **changes: Any) -> AbstractContextManager[UR5]:
    return an_arm(rig, **{"model": "UR5e", "timeout": 10.0} | changes)


@pytest.mark.parametrize("mode", ["NORMAL", "REDUCED"])
def test_what_nobody_changed_is_confirmed_again_and_again(rig: Rig, mode: str) -> None:
    rig.process.backdoor("safety", name=mode)
    with a_ur5e(rig) as arm:
        arm.confirm_settings()
        arm.confirm_settings()


@pytest.mark.parametrize(
    ("change", "message", "at_open"),
    [
        ({"do": "set", "slider": 0.0}, "speed slider is at 0%, needed at least 50%.*set it to 100 %", "speed slider is at 0%"),
        ({"do": "set", "slider": 0.3}, "speed slider is at 30%, needed at least 50%", "speed slider is at 30%"),
        (
            {"do": "set", "payload": 1.9},
            "payload is now 1.900 kg, needed as at open 0.800 kg; set it back",
            "payload is set to 1.900 kg, needed 0.800 kg",
        ),
        ({"do": "set", "payload_centre": [0, 0.02, 0.05]}, r"centre of gravity is now \(0.0, 20.0, 50.0\) mm, needed", None),
        ({"do": "set", "tcp": [0, 0, 0.1, 0, 0, 0]}, r"TCP is now \(0.0, 0.0, 100.0\) mm .*, needed as at open \(0.0", None),
        ({"do": "remote", "on": False}, "local mode, needed: remote control", "local mode"),
    ],
    ids=["slider at 0", "slider low", "payload", "centre", "tcp", "local"],
)
def test_what_the_pendant_changes_after_open_is_named_and_refused_at_open_where_rig_yaml_says_what_is_needed(
    rig: Rig, change: dict[str, Any], message: str, at_open: str | None
) -> None:
    with a_ur5e(rig) as arm:
        rig.process.backdoor(**change)
        raises((NotReady, WrongDevice), message, arm.confirm_settings)
    if at_open is not None:
        with pytest.raises((NotReady, WrongDevice), match=at_open), a_ur5e(rig, payload=0.8):
            pass


def test_a_speed_slider_at_0_is_named_before_and_during_a_motion(rig: Rig) -> None:
    with a_ur5e(rig, timeout=0.5) as arm:
        goal = raised(tuple(rig.process.backdoor()["pose"]), 0.01)
        rig.process.backdoor("set", slider=0.0)
        wait_until(lambda: arm._state.speed_slider == 0)
        raises(NotReady, "speed slider is at 0 %", arm.move_to, goal, 0.05, 0.5)
        rig.process.backdoor("set", slider=1.0)
        wait_until(lambda: arm._state.speed_slider == 1)
        arm.move_to(goal, 0.01, 0.5)
        rig.process.backdoor("set", slider=0.0)
        raises(DeviceFault, "speed slider is at 0%", wait_until, lambda: not arm.moving())


SCALED, REDUCED = {"do": "set", "scaling": 0.2}, {"do": "safety", "name": "REDUCED"}


def shown(**values: float) -> dict[str, Any]:
    """Variables of the state that keep one value, whatever is true."""
    return {"do": "stuck", "variables": values}


@pytest.mark.parametrize(
    ("before", "said", "unsaid"),
    [
        ([REDUCED, SCALED], "was in reduced mode .*scaled the speed to 20%", "slider"),
        ([shown(speed_scaling=1.0, safety_mode=2), SCALED], "was in reduced mode", "slider|scaled"),
        ([{"do": "set", "slider": 0.2}], "speed slider is at 20%: set it to 100 %", "reduced|scaled"),
        ([SCALED], "controller scaled the speed to 20%", "slider|reduced"),
        ([shown(speed_scaling=1.0), SCALED], "see the log", "slider|reduced"),
    ],
    ids=["reduced mode", "reduced by its mode alone", "slider", "scaling", "not told"],
)  # fmt: skip
def test_a_motion_slower_than_asked_is_reported_with_what_was_read_and_no_other_remedy(
    rig: Rig, before: list[dict[str, Any]], said: str, unsaid: str
) -> None:
    with a_ur5e(rig, timeout=0.5) as arm:
        for change in before:
            rig.process.backdoor(**change)
        arm.move_to(raised(tuple(rig.process.backdoor()["pose"]), 0.05), 0.05, 0.5)
        told = raises(DeviceFault, rf"slower than asked \((9|10|11) of 50 mm/s\).*{said}", wait_until, lambda: not arm.moving())
        assert not re.search(unsaid, told)


@pytest.mark.parametrize("state", ["RECOVERY", "SAFEGUARD_STOP", "PROTECTIVE_STOP"])
def test_a_stop_during_a_slow_motion_is_named_and_not_the_speed(rig: Rig, state: str) -> None:
    with a_ur5e(rig) as arm:
        rig.process.backdoor("set", scaling=0.2)
        arm.move_to(raised(tuple(rig.process.backdoor()["pose"]), 0.05), 0.05, 0.5)
        rig.process.backdoor("safety", name=state)
        told = raises(DeviceFault, state.lower().replace("_", " "), wait_until, lambda: not arm.moving())
        assert "slower" not in told


def test_a_short_motion_is_measured_against_the_speed_that_it_can_reach() -> None:
    here = (0.0,) * 6
    assert top_speed(here, raised(here, 0.05), 0.05, 0.5) == 0.05
    assert top_speed(here, raised(here, 0.0005), 0.05, 0.5) == pytest.approx(0.0158, abs=1e-4)
    assert top_speed(here, (0.001, 0, 0, 0, 0, 0.5), 0.05, 0.5) == 0.0


def test_an_arm_that_was_pushed_away_from_its_target_is_a_fault(rig: Rig) -> None:
    with a_ur5e(rig, timeout=0.5) as arm:
        start = tuple(rig.process.backdoor()["pose"])
        arm.move_to(raised(start, 0.01), 0.05, 0.5)
        wait_until(lambda: rig.process.backdoor()["pose"][2] - start[2] > 0.0099)
        timing.sleep(0.1)
        rig.process.backdoor("set", tcp=[0, 0, 0.01, 0, 0, 0])  # as a push would move what it points at
        timing.sleep(0.1)
        with pytest.raises(DeviceFault, match="motion ended 10.* mm and .* from its target .* stopped or pushed"):
            wait_until(lambda: not arm.moving())


@pytest.mark.parametrize(
    ("state", "name"),
    [
        ("SYSTEM_EMERGENCY_STOP", "system emergency stop"),
        ("ROBOT_EMERGENCY_STOP", "robot emergency stop"),
        ("SYSTEM_THREE_POSITION_ENABLING_STOP", "three-position stop"),
        ("PROTECTIVE_STOP", "protective stop"),
        ("SAFEGUARD_STOP", "safeguard stop"),
        ("RECOVERY", "recovery mode"),
        ("VIOLATION", "safety violation"),
        ("FAULT", "safety fault"),
    ],
)
def test_each_stop_is_named_when_it_comes_and_at_open(rig: Rig, state: str, name: str) -> None:
    with a_ur5e(rig) as arm:
        rig.process.backdoor("safety", name=state)
        wait_until(lambda: not arm._state.latest().safety_bits & 1)
        raises(DeviceFault, f"^arm: {name}.*;", arm.moving)
        raises(DeviceFault, f"^arm: {name}.*;", arm.confirm_settings)
    with pytest.raises(DeviceFault, match=f"^arm: {name}.*;"), a_ur5e(rig):
        pass


def test_every_bit_that_is_no_running_mode_has_a_name_and_a_remedy() -> None:
    texts = {stop_text(1 << bit, 1) for bit in range(2, 12)}
    assert len(texts) == 10 and all("; " in text for text in texts)
    assert all("neither normal" in stop_text(1 << bit, 1) for bit in range(12, 32))
    assert stop_text(0, 0)
    assert not stop_text(1, 1) and not stop_text(2, 2)
    assert "three-position" in stop_text(1 << 10, 13) and "three-position" in stop_text(1, 13)


@pytest.mark.parametrize(
    ("version", "error", "message"),
    [
        ("10.7.0.0", WrongDevice, r"arm is on, but runs PolyScope X 10\.7\.0, which has no dashboard server"),
        (E_SERIES, Unreachable, r"arm is on \(PolyScope 5\.11\.0\), but its dashboard server .* enable it"),
    ],
)
def test_an_arm_without_a_dashboard_server_is_told_from_one_that_is_off(
    version: str, error: type[Exception], message: str
) -> None:
    with a_rig(version=version, dashboard=False) as bare:
        raises(error, message, UR5("arm", Config(host=bare.host), RigClock()).open)
        raises(error, message, UR5State(UrController("arm state", bare.host, 1.0), RigClock(), discard).open)


def test_an_arm_too_old_to_tell_its_payload_is_opened() -> None:
    with a_rig(version="3.10.0.1") as old, a_ur5e(old, model="") as arm:
        old.process.backdoor("set", payload=2.0)
        arm.confirm_settings()


def test_a_program_that_is_paused_while_nothing_moves_is_named(rig: Rig) -> None:
    with a_ur5e(rig, timeout=0.5) as arm:
        rig.process.backdoor("pause")
        wait_until(lambda: arm._state.runtime == 4)
        raises(DeviceFault, "paused at the pendant", arm.confirm_settings)


@pytest.mark.parametrize("halt", ["safeguard_stop", "emergency_stop", "pause"])
def test_a_motion_that_was_halted_does_not_go_on_by_itself(rig: Rig, halt: str) -> None:
    with a_ur5e(rig) as arm:
        arm.move_to(raised(tuple(rig.process.backdoor()["pose"]), 0.05), 0.02, 0.5)
        timing.sleep(0.3)
        rig.process.backdoor(halt)
        raises(DeviceFault, "safeguard stop|emergency stop|paused at the pendant", wait_until, lambda: not arm.moving())
        halted = rig.process.backdoor()["pose"]
        rig.process.backdoor("clear")
        timing.sleep(0.3)
        assert rig.process.backdoor()["pose"] == pytest.approx(halted, abs=1e-9)


def test_an_arm_of_the_other_series_is_told_although_its_dashboard_gives_the_same_name(rig: Rig) -> None:
    with pytest.raises(WrongDevice, match="model .* is 'UR5e', not 'UR5'"), a_ur5e(rig, model="UR5"):
        pass


def test_what_a_controller_says_in_place_of_data_is_passed_on(rig: Rig) -> None:
    rig.process.backdoor("starting", text="no data before the safety setup is confirmed")
    with pytest.raises(Unreachable, match="says 'no data before .*confirmed at the pendant"), a_ur5e(rig, timeout=0.5):
        pass


def test_a_service_that_is_switched_off_at_the_pendant_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "UPLOAD_PORTS", (30001, 30002))
    found = "nothing listens at .*:30003 .*enabled at the pendant"
    with a_rig(version=E_SERIES) as bare, pytest.raises(Unreachable, match=found), a_ur5e(bare):
        pass
