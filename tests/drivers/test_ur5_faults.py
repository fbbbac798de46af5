"""What the arm driver does when things go wrong."""

import multiprocessing
import os
import signal
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

import pytest
from ur5_rig import Rig, a_rig, an_arm, discard, raised

import timing
from drivers.errors import DeviceFault, InstrumentError, NoReply, NotReady, Unreachable, WrongDevice
from drivers.ur5.control import ControlThread
from drivers.ur5.driver import UR5, Config
from drivers.ur5.state import UR5State
from drivers.ur5.wire import UrController
from sim_fakes.ur.process import free_host
from tests.simulated.bench import raises, wait_until
from timing import RigClock

SPEED, ACCELERATION = 0.05, 0.5
RTDE = 30004


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with a_rig() as rig:
        yield rig


@contextmanager
def holding_its_inputs(host: str) -> Iterator[socket.socket]:
    """A program that writes an input register of the arm."""
    with socket.create_connection((host, RTDE)) as line:
        line.settimeout(20.0)
        for kind, body in ((b"V", b"\x00\x02"), (b"I", b"input_int_register_0")):
            line.sendall(struct.pack(">H", 3 + len(body)) + kind + body)
        taken = b""
        while not taken.endswith(b"I\x01INT32"):
            taken += line.recv(4096)
        yield line


def fault_of(arm: UR5) -> DeviceFault:
    """The fault that watching a motion ends with."""
    with pytest.raises(DeviceFault) as caught:
        wait_until(lambda: arm.moving() is None, 5.0)
    return caught.value


def test_a_stop_by_the_safety_system_is_a_fault_until_it_is_cleared(rig: Rig) -> None:
    with an_arm(rig, watchdog_frequency=2.0) as arm:
        arm.move_to(raised(tuple(rig.process.backdoor()["pose"]), 0.1), SPEED, ACCELERATION)
        rig.process.backdoor("protective_stop")
        assert "protective stop" in str(fault_of(arm))
        with pytest.raises(DeviceFault, match="protective stop; .*open the arm"):
            arm.move_to(raised(tuple(rig.process.backdoor()["pose"]), 0.1), SPEED, ACCELERATION)
        arm.stop()  # it stands, and that is all that is asked
    raises(DeviceFault, "protective stop", arm.open)
    rig.process.backdoor("clear")


def test_a_target_out_of_reach_ends_the_program_and_is_a_fault(rig: Rig) -> None:
    with an_arm(rig, watchdog_frequency=2.0, workspace_max=(2.0, 2.0, 2.0), max_step=1.7, max_turn=3.2) as arm:
        with pytest.raises(DeviceFault, match="out of reach"):
            arm.move_to(raised(tuple(rig.process.backdoor()["pose"]), 0.9), SPEED, ACCELERATION)
            raise fault_of(arm)
        assert "no inverse kinematics solution" in rig.process.backdoor()["ended"][-1]


@pytest.mark.parametrize(
    ("wrong", "right", "error", "message"),
    [
        ({"do": "power", "on": False}, {"do": "power", "on": True}, NotReady, "robot mode 3; power the arm on"),
        ({"do": "dashboard", "silent": True}, {"do": "dashboard", "silent": False}, Unreachable, "dashboard {}:29999 is silent"),
    ],
    ids=["no power", "silent dashboard"],
)
def test_an_arm_that_cannot_be_used_yet_is_not_opened(
    rig: Rig, wrong: dict[str, Any], right: dict[str, Any], error: type[InstrumentError], message: str
) -> None:
    rig.process.backdoor(**wrong)
    try:
        raises(error, message.format(rig.host), UR5("arm", Config(host=rig.host, timeout=0.3), rig.clock).open)
    finally:
        rig.process.backdoor(**right)


def test_an_arm_that_another_program_controls_is_not_taken(rig: Rig) -> None:
    with holding_its_inputs(rig.host), pytest.raises(NotReady, match="another program controls the arm"):
        UR5("arm", Config(host=rig.host), rig.clock).open()


def test_what_a_program_that_has_just_ended_still_holds_is_waited_for(rig: Rig) -> None:
    control = ControlThread("arm", rig.host, 3.0)
    with holding_its_inputs(rig.host) as held:

        def end() -> None:
            timing.sleep(1.0)
            held.close()

        ended = timing.Thread(target=end)
        ended.start()
        control.start()
        ended.join()
    assert control.call(lambda arm: arm.isConnected())
    assert control.finish(10.0)


# -- something else, or nothing, at the address


def open_state(host: str) -> None:
    UR5State(UrController("arm state", host, 0.3), RigClock(), discard).open()


def open_arm(host: str) -> None:
    UR5("arm", Config(host=host, timeout=0.3), RigClock()).open()


@pytest.mark.parametrize("opener", [open_state, open_arm])
def test_nobody_at_the_address_is_unreachable(opener: Callable[[str], None]) -> None:
    host = free_host()
    raises(Unreachable, f"nothing listens at {host}:30004", opener, host)


@pytest.mark.parametrize("opener", [open_state, open_arm])
@pytest.mark.parametrize(
    ("greeting", "error"),
    [(b"", Unreachable), (b"220 mail server ready\r\n", WrongDevice), (b"\x00\x03V", WrongDevice)],
    ids=["silent", "mail", "empty"],
)
def test_something_else_at_the_port_is_told_apart_quickly(
    opener: Callable[[str], None], greeting: bytes, error: type[InstrumentError]
) -> None:
    host = free_host()
    with socket.create_server((host, 30004)) as server:

        def serve() -> None:
            line, _ = server.accept()
            line.sendall(greeting)
            line.recv(1024)
            timing.sleep(0.6)
            line.close()

        timing.Thread(target=serve, daemon=True).start()
        start = timing.now()
        raises(error, f"{host}:30004", opener, host)
        assert timing.now() - start < 3.0


# -- the process of the driver, or the controller, dies
def _hold_the_arm(host: str, line: Connection) -> None:
    """In a process of its own: open the arm, start a long move, close when told; answers with the time that took."""
    arm = UR5("arm", Config(host=host), RigClock())
    arm.open()
    line.send("open")
    arm.move_to(line.recv(), 0.01, ACCELERATION)
    line.send("moving")
    line.recv()
    start = timing.now()
    arm.close()
    arm.close()
    line.send(timing.now() - start)


def _moving(rig: Rig) -> tuple[multiprocessing.process.BaseProcess, Connection]:
    """A process that has started a slow move of 10 cm."""
    context = multiprocessing.get_context("spawn")
    line, far = context.Pipe()
    process = context.Process(target=_hold_the_arm, args=(rig.host, far), daemon=True)
    process.start()
    assert line.poll(20.0) and line.recv() == "open"
    line.send(raised(tuple(rig.process.backdoor()["pose"]), 0.1))
    assert line.poll(5.0) and line.recv() == "moving"
    return process, line


@pytest.fixture
def holder(rig: Rig) -> Iterator[tuple[multiprocessing.process.BaseProcess, Connection]]:
    """The arm moves, and kicks have kept the watchdog quiet for more than two of its limits. On a busy computer it may bite
    before: then once more."""
    for _ in range(10):
        rig.process.backdoor("forget")
        process, line = _moving(rig)
        timing.sleep(0.5)
        if not rig.process.backdoor()["ended"]:
            break
        process.kill()
        process.join()
        rig.process.wait_for("runtime", 1)
        ended = rig.process.backdoor()["ended"]
    else:
        raise AssertionError(f"the watchdog bites although it is kicked: {ended}")
    yield process, line
    process.kill()
    process.join()


Holder = tuple[multiprocessing.process.BaseProcess, Connection]


@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL], ids=["hangs", "is killed"])
def test_the_watchdog_stops_the_arm_when_the_drivers_process(rig: Rig, holder: Holder, how: signal.Signals) -> None:
    os.kill(holder[0].pid or 0, how)
    state = rig.process.wait_for("runtime", 1)
    assert state["ended"] == ["watchdog: input registers not written at 5 Hz"]
    assert state["tcp_speed"] == [0.0] * 6


def test_what_the_library_raises_when_it_loses_the_controller_is_no_reply(rig: Rig) -> None:
    def lose(library: object) -> None:
        raise RuntimeError("Timeout connecting to UR dashboard server.")

    control = ControlThread("arm", rig.host, 3.0)
    control.start()
    try:
        raises(NoReply, "Timeout connecting to UR dashboard server", control.call, lose)
        raises(NoReply, "close and open it again", control.operation)
    finally:
        assert control.finish(10.0)


def test_closing_is_bounded_after_the_controller_was_killed(rig: Rig, holder: Holder) -> None:
    _, line = holder
    rig.process.kill()
    line.send("close")
    assert line.poll(15.0)
    assert line.recv() < 10.0
