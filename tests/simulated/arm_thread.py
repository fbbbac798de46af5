"""The arm's controller in a thread of this process, and what drivers then use instead of ur_rtde.

The maker's library brings threads of its own, which know no simulated clock. Where drivers and fakes share one, its two
interfaces are played here: they read and write the controller's registers as the library does, cycle by cycle.
"""

import asyncio
import math
import selectors
from collections.abc import Callable, Sequence
from typing import Any

import rtde_control
import rtde_receive

import timing
from sim_fakes.ur import backdoor
from sim_fakes.ur.controller import FakeController, Runtime
from sim_fakes.ur.process import free_host
from sim_fakes.ur.script import DONE, READY
from sim_fakes.ur.server import Address, UrServer
from sim_fakes.ur.wire import Hub

SERVED: dict[str, Hub] = {}
"""Controllers in this process, by address."""
ANSWERED_WITHIN = 5.0
"""Host seconds after which the library gives up a command."""
_LIBRARY = rtde_control.RTDEControlInterface, rtde_receive.RTDEReceiveInterface
PROGRAM = "def rtde_control():\n  0\nend\n"


class _Selector(selectors.SelectSelector):
    """Waits on the clock that its thread lives in."""

    def select(self, timeout: float | None = None) -> Any:
        timing.readable(list(self.get_map()), math.inf if timeout is None else timeout)
        return super().select(0)


class _Loop(asyncio.SelectorEventLoop):
    """An event loop of that clock."""

    def __init__(self) -> None:
        super().__init__(_Selector())

    def time(self) -> float:
        return timing.now()


class UrThread:
    """Stands in for `sim_fakes.ur.process.UrProcess`: the same in a thread that lives in the clock of who makes it."""

    def __init__(
        self,
        host: str | None = None,
        *,
        speed: float = 1.0,
        version: str = "3.15.8.106339",
        pose_to: Address | None = None,
        dashboard: bool = True,
        seed: int = 0,
    ) -> None:
        self.host = host = host or free_host()
        a, b, c, d = (int(number) for number in version.split("."))
        self.server = UrServer(FakeController((a, b, c, d), speed, seed), host, timing.now(), dashboard)
        self._loop = _Loop()
        self._ready = timing.Event()
        self._pose_to = pose_to
        self._thread = timing.Thread(target=self._run, name="fake-arm-controller")
        SERVED[host] = self.server.hub
        rtde_control.RTDEControlInterface, rtde_receive.RTDEReceiveInterface = control, receive
        self._thread.start()
        self._ready.wait()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            self._task = self._loop.create_task(self.server.run(None, self._pose_to, self._ready.set))
            try:
                runner.run(self._until_cancelled())
            finally:
                SERVED.pop(self.host, None)

    async def _until_cancelled(self) -> None:
        try:
            await self._task
        except asyncio.CancelledError:
            return

    def backdoor(self, do: str = "state", **values: object) -> dict[str, Any]:
        outcome: list[dict[str, Any] | Exception] = []

        def act() -> None:
            try:
                backdoor.act(self.server.hub, {"do": do, **values})
                outcome.append(backdoor.state(self.server.hub))
            except (ValueError, KeyError, TypeError) as error:
                outcome.append(ValueError(f"{type(error).__name__}: {error}"))

        self._loop.call_soon_threadsafe(act)
        timing.wait(lambda: bool(outcome), ANSWERED_WITHIN)
        if not outcome:
            raise ConnectionError(f"the controller at {self.host} has gone")
        if isinstance(outcome[0], Exception):
            raise outcome[0]
        return outcome[0]

    def wait_for(self, what: str, value: object, timeout: float = 5.0) -> dict[str, Any]:
        if not timing.wait(lambda: bool(backdoor.state(self.server.hub)[what] == value), timeout):
            raise TimeoutError(f"{what} is not {value!r} after {timeout:g} s")
        return backdoor.state(self.server.hub)

    def stop(self) -> None:
        """End it; may be called twice."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._task.cancel)
            self._thread.join(1.0)


class _Link:
    """The library's connection to one controller: a client among its others, which may be cut off or not be heard."""

    def __init__(self, hub: Hub) -> None:
        self.hub = hub
        self.transport = self
        self.connected = True
        hub.connections.add(self)  # type: ignore[arg-type]

    def abort(self) -> None:
        """The controller cuts the connection."""
        self.connected = False
        self.hub.connections.discard(self)  # type: ignore[arg-type]

    def drain(self) -> None:
        """See Connection."""


def _register(name: str, kind: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda self: kind(self._value(name))


class Receive:
    """Plays RTDEReceiveInterface."""

    def __init__(self, hub: Hub, names: Sequence[str]) -> None:
        self._hub, self._names = hub, tuple(names)
        self._link = _Link(hub)
        self._values: dict[str, Any] = {}
        self._taken = -math.inf

    def _value(self, name: str) -> Any:
        """As of the newest package that has come."""
        hub = self._hub
        if self._link.connected and not hub.frozen and hub.controller.t != self._taken:
            self._taken = hub.controller.t
            self._values = {name: hub.controller.value(name) for name in self._names}
        return self._values[name]

    def isConnected(self) -> bool:  # noqa: N802 (the library's names)
        return self._link.connected

    def reconnect(self) -> bool:
        self._link = _Link(self._hub)
        return True

    def disconnect(self) -> None:
        self._link.abort()

    getTimestamp = _register("timestamp", float)
    getActualQ = _register("actual_q", list)
    getActualTCPPose = _register("actual_TCP_pose", list)
    getActualTCPSpeed = _register("actual_TCP_speed", list)
    getSafetyStatusBits = _register("safety_status_bits", int)
    getRobotStatus = _register("robot_status_bits", int)
    getSafetyMode = _register("safety_mode", int)
    getRuntimeState = _register("runtime_state", int)
    getSpeedScaling = _register("speed_scaling", float)
    getTargetSpeedFraction = _register("target_speed_fraction", float)


class _Progress:
    """Plays the library's AsyncOperationStatus."""

    def __init__(self, status: int) -> None:
        self._status = status

    def operationId(self) -> int:  # noqa: N802
        return self._status >> 24 & 127

    def isAsyncOperationRunning(self) -> bool:  # noqa: N802
        return bool(self._status >> 15 & 1)


class Control:
    """Plays RTDEControlInterface: one command at a time through the input registers."""

    def __init__(self, hub: Hub) -> None:
        controller = hub.controller
        if hub.owner and any(owner in hub.connections for owner in hub.owner.values()):
            raise RuntimeError("One of the RTDE input registers are already in use!")
        self._controller = controller
        self._link = _Link(hub)
        hub.owner["input_int_register_0"] = self._link  # type: ignore[assignment]
        self._write(0, 0)
        controller.load(PROGRAM)
        if controller.runtime != Runtime.PLAYING:
            self._link.abort()
            raise RuntimeError(f"Failed to start control script: {controller.ended[-1]}; is it in remote control?")
        self._await(READY)

    def _write(self, index: int, value: int) -> None:
        if self._link.connected and not self._link.hub.frozen:
            self._controller.write(f"input_int_register_{index}", value)

    def _await(self, said: int) -> bool:
        """Whether the script says so; False when its program has ended or it stays silent."""
        controller, hub = self._controller, self._link.hub
        timing.wait(
            lambda: (
                (controller.out_int[0] == said and not hub.frozen)
                or controller.runtime == Runtime.STOPPED
                or not self._link.connected
            ),
            ANSWERED_WITHIN,
        )
        return controller.out_int[0] == said and controller.runtime == Runtime.PLAYING and self._link.connected

    def _command(self, code: int, values: Sequence[float] = (), flag: int | None = None) -> bool:
        if not self._await(READY):
            return False
        for i, value in enumerate(values):
            self._controller.write(f"input_double_register_{i}", float(value))
        if flag is not None:
            self._write(1, flag)
        self._write(0, code)
        done = self._await(DONE)
        self._write(0, 0)
        return done and self._await(READY)

    def isConnected(self) -> bool:  # noqa: N802
        return self._link.connected

    def disconnect(self) -> None:
        self._link.abort()
        self._link.hub.owner = {k: v for k, v in self._link.hub.owner.items() if v is not self._link}  # type: ignore[comparison-overlap]

    def kickWatchdog(self) -> bool:  # noqa: N802
        self._write(0, 0)
        return True

    def setWatchdog(self, frequency: float) -> bool:  # noqa: N802
        return self._command(35, [frequency])

    def moveL(self, pose: Sequence[float], speed: float, acceleration: float, asynchronous: bool) -> bool:  # noqa: N802
        return self._command(3, [*pose, speed, acceleration], int(asynchronous))

    def stopL(self, deceleration: float, asynchronous: bool) -> None:  # noqa: N802
        self._command(33, [deceleration], int(asynchronous))

    def stopScript(self) -> None:  # noqa: N802
        self._write(0, 255)
        timing.wait(lambda: self._controller.runtime != Runtime.PLAYING or not self._link.connected, 1.0)
        self._write(0, 0)

    def setTcp(self, pose: Sequence[float]) -> bool:  # noqa: N802
        return self._command(29, pose)

    def getTCPOffset(self) -> list[float]:  # noqa: N802
        self._command(40)
        return self._controller.out_double[:6]

    def getAsyncOperationProgressEx(self) -> _Progress:  # noqa: N802
        return _Progress(self._controller.out_int[2])


def control(host: str, frequency: float = -1.0, flags: int = 0) -> Any:
    """A connection that commands the controller at an address; the library's own where none is in this process."""
    found = SERVED.get(host) if timing.together() else None
    return _LIBRARY[0](host, frequency, flags) if found is None else Control(found)


def receive(host: str, frequency: float = -1.0, names: Sequence[str] = ()) -> Any:
    """A connection that receives the state of the controller at an address; the library's own where none is here."""
    found = SERVED.get(host) if timing.together() else None
    return _LIBRARY[1](host, frequency, list(names)) if found is None else Receive(found, names)


for _name in ("FLAG_UPLOAD_SCRIPT", "FLAG_NO_EXT_FT"):
    setattr(control, _name, getattr(_LIBRARY[0], _name))
