"""The program dies, freezes, hangs or loses its guard: the rig lands, says why, and stays locked when it cannot be confirmed."""

import errno
import os
import pickle
import resource
import signal
import subprocess
import threading
from collections.abc import Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from house import House, inflate, until

import timing
from drivers.errors import DeviceFault, InstrumentError
from drivers.interfaces import JammingValve, PressureRegulators
from lab.cli import main
from lab.console import Screen
from lab.files.config import ConfigError
from lab.files.inputs import read_case
from lab.files.rig_file import load_rig
from lab.guard import new_guard
from lab.guard.child import start_child
from lab.guard.commands import Command, R, RemoteLengthUnit, RemoteRegulators, energises, moves
from lab.guard.door import names_of_path, owners
from lab.guard.guard import Guard
from lab.guard.latch import RigLocked
from lab.guard.messages import RigLanded, Start
from lab.priority import FIRST
from lab.rig.actuators import ActuatorsLost
from lab.rig.assembly import Rig
from lab.verbs.fakes import PATIENT
from protocols.actions import ramp
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from tests.simulated.bench import raises
from timing import RigClock

PROTECTIVE_STOP = 1 << 2
"""Of safety_status_bits."""


def journal(house: House) -> str:
    return house.rig.with_suffix(".guard.log").read_text()


@pytest.mark.real
def test_a_killed_program_leaves_the_rig_landed_and_free(house: House, tmp_path: Path) -> None:
    program = house.start(tmp_path)
    os.kill(program.pid, signal.SIGKILL)
    program.wait()
    assert house.landed()
    assert "the program ended" in journal(house)
    (file,) = tmp_path.glob("*.mcap")
    raises(Exception, "recover", Recording.open, file)
    assert len(Recording.open(file, truncated=True).states) > 0


@pytest.mark.real
def test_a_frozen_program_is_landed_and_finds_out_when_it_wakes(house: House, tmp_path: Path) -> None:
    program = house.start(tmp_path)
    os.kill(program.pid, signal.SIGSTOP)
    try:
        assert house.vented()
        timing.sleep(0.3)
    finally:
        os.kill(program.pid, signal.SIGCONT)
    output, _ = program.communicate(timeout=600)
    assert program.returncode == 1
    assert "no heartbeat" in output and "no heartbeat" in journal(house)
    assert "was lost" not in output  # the guard was sound: the program itself had been away


@pytest.mark.real
def test_a_guard_without_a_file_descriptor_left_hears_that_its_program_is_silent(small: House, rig: Rig) -> None:
    inflate(rig, small)
    before = resource.prlimit(rig.actuators._process.pid, resource.RLIMIT_NOFILE)
    resource.prlimit(rig.actuators._process.pid, resource.RLIMIT_NOFILE, (3, before[1]))
    rig.actuators.pulse._ended.set()  # no heartbeat any more
    try:
        assert small.vented()
    finally:
        resource.prlimit(rig.actuators._process.pid, resource.RLIMIT_NOFILE, before)


@pytest.mark.parametrize("failing", ["lab.guard.pulse.Listener.take", "lab.guard.limit_monitor.LimitMonitor.check"])
def test_a_watch_of_the_guard_that_fails_lands_the_rig(
    small: House, rig: Rig, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    inflate(rig, small)

    def fails(*_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(failing, fails)
    assert small.vented()
    monkeypatch.undo()
    assert until(lambda: "Too many open files" in journal(small))
    raises(RigLanded, "watch on the program|polling of", rig.actuators.pressure.set, (20e3, 20e3, 20e3))


@pytest.mark.real
@pytest.mark.parametrize("after", [0, 1], ids=["before it says which rig", "while the guard takes it over"])
def test_a_guard_whose_program_ends_while_it_starts_ends_without_a_traceback(small: House, after: int) -> None:
    commands, theirs = Pipe()
    reports, their_reports = Pipe(duplex=False)
    their_pulse, pulse = os.pipe()
    given = (theirs.fileno(), their_pulse, their_reports.fileno())
    guard = start_child("lab.guard.process", given, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    for end in (theirs, their_reports):
        end.close()
    os.close(their_pulse)
    if after:
        rig = load_rig(small.rig)
        commands.send(Start(str(rig.path), rig.sha256, None, timing.now(), False, "a test"))
    for end in (commands, reports):
        end.close()
    os.close(pulse)
    said, _ = guard.communicate(timeout=60)
    assert said == b"" and guard.returncode == 1 - after
    assert owners(names_of_path(small.rig)) == []


@pytest.mark.real
@pytest.mark.parametrize(
    ("how", "said"), [(signal.SIGKILL, "was lost"), (signal.SIGSTOP, "no heartbeat")], ids=["killed", "frozen"]
)
def test_a_program_without_its_guard_stops_lands_the_rig_anew_and_says_so(
    house: House, tmp_path: Path, how: signal.Signals, said: str
) -> None:
    program = house.start(tmp_path)
    children = Path(f"/proc/{program.pid}/task/{program.pid}/children").read_text().split()
    guard = next(pid for pid in children if b"lab.guard.process" in Path(f"/proc/{pid}/cmdline").read_bytes())
    os.kill(int(guard), how)
    output, _ = program.communicate(timeout=600)
    assert program.returncode == 1 and "guard" in output and said in output
    assert house.landed()


@pytest.mark.real
def test_regulators_that_can_be_reached_are_vented_though_one_of_them_is_dead(
    small: House, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(new_guard, "REACH_WITHIN", 3.0)
    inflate(rig, small)
    os.kill(rig.actuators._process.pid, signal.SIGKILL)
    small.fakes.lines["pressure"].faults.extra["dead"] = "B"
    report = rig.make_safe()
    (step,) = [s for s in report.steps if s.instrument == "pressure"]
    assert not step.confirmed and "B" in step.text
    assert {s.instrument for s in report.steps if s.confirmed} == {"spine", "valve"}
    regulator = small.fakes.plant.regulator
    groups = small.fakes.wiring
    told = {unit: max(regulator[c - 1] for c in group) for unit, group in zip("ABC", groups, strict=True)}
    assert told["A"] == told["C"] == 0.0 and told["B"] > 20e3
    assert small.latch.exists()


@pytest.mark.real
def test_when_both_are_killed_the_rig_is_locked_until_a_person_clears_it(
    small: House, rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    inflate(rig, small)
    os.kill(rig.actuators._process.pid, signal.SIGKILL)
    raises(ActuatorsLost, None, rig.actuators.pressure.read)
    assert small.latch.exists()
    with pytest.raises(RigLocked, match="interrupted.*lab safe --clear"), Rig(load_rig(small.rig)):
        pass
    assert main(["safe", "--rig", str(small.rig)]) == 1
    assert "stays locked" in capsys.readouterr().out
    assert small.vented()
    assert main(["safe", "--clear", "--rig", str(small.rig)]) == 0
    assert not small.latch.exists()


def test_an_unconfirmed_landing_locks_the_rig_and_clearing_needs_a_confirmed_one(
    small: House, rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    inflate(rig, small)
    small.fakes.switch.begin("pressure", "silence")
    report = rig.make_safe()
    assert {s.instrument for s in report.steps if not s.confirmed} == {"pressure"}
    rig.close()
    assert "pressure NOT CONFIRMED" in small.latch.read_text()
    small.change_instrument("pressure", timeout=0.1)  # for answers that do not come
    assert main(["safe", "--clear", "--rig", str(small.rig)]) == 1
    assert small.latch.exists()
    small.fakes.switch.end()
    small.change_instrument("pressure", **PATIENT["instruments"]["pressure"])
    assert main(["safe", "--clear", "--rig", str(small.rig)]) == 0
    assert not small.latch.exists()
    capsys.readouterr()


@pytest.fixture
def guard(small: House) -> Iterator[Guard]:
    """In this process."""
    guard = Guard(load_rig(small.rig), RigClock(20.0))
    guard.take_over()
    yield guard
    guard.close()


def test_a_landing_that_comes_after_the_last_one_does_not_judge_closed_drivers(small: House, guard: Guard) -> None:
    """The program's death is seen by two threads of the guard; the slower one must not lock a rig that was landed."""
    for name in ("gauge", "valve", "pressure", "spine"):
        guard.open(name)
    guard.do(Command("valve", JammingValve.set, (True,)))
    assert small.latch.exists()
    guard.close()
    report = guard.make_safe("the program ended", keep_vacuum=False)
    assert report.confirmed and not small.latch.exists()


def test_a_refused_command_raises_what_landed_the_rig_and_no_error_is_its_own_cause(guard: Guard) -> None:
    """Libraries that pickle causes too would follow it for ever, and the guard's process would end."""
    guard.open("pressure")
    why = DeviceFault("force", "too much")
    guard.land("force: too much", why)
    for _ in range(2):
        with pytest.raises(DeviceFault, match="too much") as caught:
            guard.do(Command("pressure", PressureRegulators.set, ((20e3,) * 3,)))
        assert caught.value is why and why.__cause__ is None


def test_a_set_point_that_is_confirmed_while_a_landing_begins_is_not_missed_afterwards(
    guard: Guard, monkeypatch: pytest.MonkeyPatch
) -> None:
    guard.open("pressure")
    driver = guard.own.drivers["pressure"]
    at_once = driver.set

    def meanwhile(pressures: tuple[float, ...]) -> tuple[float, ...]:
        held = at_once(pressures)
        guard.land("asked for")
        assert until(lambda: guard.landing.going)
        return held

    monkeypatch.setattr(driver, "set", meanwhile)
    assert max(guard.do(Command("pressure", PressureRegulators.set, ((20e3,) * 3,)))) > 0
    assert guard.monitor.setpoints_confirmed is None


class Mute:
    """A driver without the optional methods, which notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def set(self, pressures: tuple[float, ...]) -> tuple[float, ...]:
        self.asked.append(pressures)
        return pressures

    def home(self) -> None:
        self.asked.append("home")


def test_a_command_is_the_same_call_in_another_process() -> None:
    class Line:
        def ask(self, command: Command[R]) -> R:
            crossed: Command[R] = pickle.loads(pickle.dumps(command))
            assert crossed == command
            sent.append(crossed)
            return crossed.perform(driver)

    driver, sent = Mute(), list[Command[object]]()
    regulators, unit = RemoteRegulators(Line(), "pressure", 3), RemoteLengthUnit(Line(), "spine")
    assert regulators.set(np.array([1e3, 2e3, 0.0])) == (1e3, 2e3, 0.0) and regulators.take_notices() == []
    assert {type(p) for p in driver.asked[0]} == {float}, "a process that holds instruments knows no NumPy"
    assert regulators.confirm_settings() is None
    unit.home()
    assert driver.asked == [(1e3, 2e3, 0.0), "home"]
    assert [energises(c) for c in sent] == [True, False, False, True] and [moves(c) for c in sent] == [False] * 3 + [True]
    assert [str(c) for c in sent[:2]] == ["pressure.set", "pressure.take_notices"]
    raises(AttributeError, None, regulators.vent)


def test_a_rig_yaml_that_was_changed_after_it_was_read_is_refused(small: House) -> None:
    rig = load_rig(small.rig)
    small.change(limits={"max_force": 20.0})
    raises(ConfigError, "rig.yaml: was changed after the command had read it; repeat the command", Rig, rig)
    assert owners(names_of_path(small.rig)) == [] and not small.latch.exists()
    with small.opened():
        pass


def test_what_other_guards_have_left_of_a_rig_is_landed_without_its_latch(small: House) -> None:
    left = load_rig(small.rig).read_from(None)  # its path is theirs
    report = new_guard.make_safe_with_new_guard(left, RigClock(20.0), ["valve", "pressure"], "a test", unlock=True)
    assert report.confirmed and {step.instrument for step in report.steps} == {"valve", "pressure"}
    assert not small.latch.exists()


@pytest.mark.real
def test_what_holds_instruments_comes_first_from_its_start_where_the_system_allows_it() -> None:
    child = start_child("code", stdin=subprocess.PIPE)  # a module that knows nothing of places, and waits
    try:
        assert os.getsid(child.pid) == child.pid  # no Ctrl-C of the terminal reaches it
        may = subprocess.run(["nice", "-n", str(FIRST.process), "true"], capture_output=True, text=True, check=False).stderr == ""
        assert os.getpriority(os.PRIO_PROCESS, child.pid) == (FIRST.process if may else os.getpriority(os.PRIO_PROCESS, 0))
        scheduled = Path(f"/proc/{child.pid}/autogroup")
        if may and scheduled.exists():
            assert scheduled.read_text().endswith(f" nice {FIRST.session}\n")
    finally:
        child.kill()
        child.communicate()


def test_a_rig_that_was_closed_or_has_no_guard_leaves_no_file_open(small: House, monkeypatch: pytest.MonkeyPatch) -> None:
    def channels() -> int:
        links = [Path(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd")]
        return sum(str(link.readlink()).startswith(("pipe:", "socket:")) for link in links if os.path.lexists(link))

    before = channels()
    for _ in range(2):
        rig = Rig(load_rig(small.rig))
        rig.close()
        assert until(lambda: channels() == before)
    monkeypatch.setattr("lab.rig.actuators.start_child", lambda *_: os.posix_spawn("/none", ["/none"], {}))
    with pytest.raises(FileNotFoundError) as caught:
        Rig(load_rig(small.rig))
    assert caught.tb is not None and channels() == before  # the traceback keeps what was made


@pytest.mark.real
def test_a_guard_of_this_process_leaves_no_thread_behind(house: House) -> None:
    before = set(threading.enumerate())
    Guard(load_rig(house.rig), RigClock(20.0), despite_latch=True).close()
    assert until(lambda: set(threading.enumerate()) <= before)


def test_an_experiment_that_does_not_move_on_is_landed(small: House) -> None:
    small.change(safe={"hang": 1.0})
    with small.opened(inflated=True) as rig:
        assert small.vented()
        raises(RigLanded, "has made no progress", rig.actuators.pressure.set, (0.0, 0.0, 0.0))
        rig.actuators.resume()
        rig.actuators.pressure.set((0.0, 0.0, 0.0))


def test_waiting_for_a_person_is_no_hang(small: House) -> None:
    small.change(safe={"hang": 2.0})
    with small.opened(inflated=True) as rig:
        with rig.actuators.pulse.waiting_for_person():
            timing.sleep(3.0)
        rig.actuators.pressure.set((50e3, 50e3, 50e3))


def test_a_clipped_setpoint_is_returned_logged_and_told_by_its_ramp_until_the_next(rig: Rig, tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        rig.record_to(recorder)
        got = rig.actuators.pressure.set((300e3, 0.0, 0.0))
        assert got[0] < 299e3
        assert until(lambda: recorder.counts()["/log"].generated > 1)  # the first line is the recorder's own
        rig.record_to(None)
        bench = rig.bench(recorder, Screen("ramp", quiet=True), lambda: False)
        ramp(bench, (200e3, 0.0, 0.0), 2e6)  # max_rate lets 100 kPa through at once, however late the first is
        assert bench.clipped
        ramp(bench, (200e3, 0.0, 0.0), 25e3)
        assert not bench.clipped
    (line,) = [line.text for line in Recording.open(tmp_path / "a.mcap").log if "clipped" in line.text]
    assert "asked 300.0" in line


def test_the_robot_s_own_pressure_clips_and_lands(small: House) -> None:
    robot = small.rig.with_name("robot.yaml")
    robot.write_text(robot.read_text().replace("max_pressure: 250000.0", "max_pressure: 80000.0"))
    with small.opened(inflated=True) as rig:
        for _ in range(20):
            got = rig.actuators.pressure.set((200e3, 60e3, 60e3))
            timing.sleep(0.02)
        assert got[0] == pytest.approx(80e3, abs=100)
        small.fakes.set_faults("pressure", {"reading": 120e3})  # above 80 + 30 kPa, far below the regulators' 300
        assert until(lambda: rig.vital.landed is not None, 5.0)
        assert rig.vital.landed is not None and "limit 110.0 kPa" in rig.vital.landed.text
        small.fakes.switch.end()
        small.fakes.lines["pressure"].faults.extra.clear()


@pytest.mark.real
def test_the_arms_process_may_crash_and_nobody_else_does(house: House) -> None:
    house.change(without=("force", "mocap"))
    with house.opened() as rig:
        children = Path(f"/proc/{rig.actuators._process.pid}/task").glob("*/children")
        (host,) = [int(pid) for file in children for pid in file.read_text().split()]
        os.kill(host, signal.SIGSEGV)
        for _ in range(2):  # who asks later hears the cause as well, not that the arm is closed
            raises(InstrumentError, "SIGSEGV", rig.actuators.arm.moving)
        rig.actuators.valve.set(True)
        report = rig.make_safe()  # the arm is looked at from outside
        assert report.confirmed and {s.instrument for s in report.steps} == {"arm", "pressure", "spine", "valve"}


def test_an_arm_that_its_safety_system_holds_is_confirmed_at_rest_though_it_cannot_be_opened(house: House) -> None:
    house.change(without=("force", "mocap"))
    ur = house.fakes.ur
    assert ur is not None
    with house.opened() as rig:
        rig.actuators.valve.set(True)
        ur.backdoor("protective_stop")
        state = rig.streams["arm_state"]
        assert until(lambda: bool(state.latest().safety_bits & PROTECTIVE_STOP) and not state.latest().program_running)
        raises(DeviceFault, "protective stop", rig.actuators.resume)
        assert rig.make_safe().confirmed and not house.latch.exists()


@pytest.mark.real
def test_twenty_signals_during_the_clean_up_still_end_safe(house: House, tmp_path: Path) -> None:
    program = house.start(tmp_path)
    for i in range(20):
        program.send_signal(signal.SIGTERM if i % 2 else signal.SIGINT)
        timing.sleep(0.05)
    output, _ = program.communicate(timeout=600)
    assert program.returncode == 1, output
    assert house.vented() and not house.latch.exists()
    assert "stopped" in output and "Traceback" not in output
    (file,) = tmp_path.glob("*.mcap")
    assert read_case([file]).robot is not None


def test_an_instrument_that_is_read_at_less_than_half_of_poll_is_named_once_with_the_remedies(small: House) -> None:
    small.change_instrument("spine", timeout=1.0)
    with small.opened() as rig:
        assert until(lambda: rig.counts.get("/spine", 0) > 30) and not any("`poll" in text for text in rig.notices)
        small.fakes.lines["spine"].faults.delay = 0.15
        assert until(lambda: any("`poll" in text for text in rig.notices))
        timing.sleep(5.0)
        (told,) = [text for text in rig.notices if "`poll" in text]
        assert told.startswith("spine: ") and "`poll: 20` Hz" in told and "latency timer" in told
