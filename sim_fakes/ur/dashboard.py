"""Dashboard, port 29999: one line of text a request, one line an answer."""

from __future__ import annotations

from .controller import IDLE, NORMAL, PLAYING, POWER_OFF, PROTECTIVE_STOP, RUNNING, SAFETY_MODE, Controller
from .wire import Connection

PORT = 29999
LONGEST_LINE = 1024
_MODE = {POWER_OFF: "POWER_OFF", IDLE: "IDLE", RUNNING: "RUNNING"}
_SINCE = {
    "get serial number": ((3, 12), (5, 6)),
    "get robot model": ((3, 12), (5, 6)),
    "is in remote control": ((9, 9), (5, 6)),
    "safetystatus": ((3, 11), (5, 4)),
}
"""The PolyScope versions (CB3, e-Series) a request came with, from memory of the maker's table."""


class DashboardConnection(Connection):
    """One dashboard client."""

    def greet(self) -> None:
        self._say("Connected: Universal Robots Dashboard Server")

    def _say(self, line: str) -> None:
        if not self.hub.dashboard_silent:
            self.transport.write(line.encode() + b"\n")

    def take(self) -> bool:
        line, newline, rest = self.buffer.partition(b"\n")
        if len(line) > LONGEST_LINE:
            self.hub.violation("dashboard: line too long")
            self.transport.abort()
            return False
        if not newline:
            return False
        self.buffer = rest
        request = line.decode("ascii", "replace").strip()
        if request.lower() == "quit":
            self._say("Disconnected")
            self.transport.close()
            return False
        self._say(answer(self.hub.controller, request))
        return True


def answer(controller: Controller, request: str) -> str:
    """What the dashboard says to a request; acts on the controller where the request asks for it."""
    key = request.lower()
    major = controller.version[0]
    if key in _SINCE and controller.version[:2] < _SINCE[key][0 if major == 3 else 1]:
        return f"could not understand: '{request}'"
    running = controller.runtime == PLAYING
    told = {
        "polyscopeversion": "URSoftware {}.{}.{}.{} (Sep 05 2022)".format(*controller.version),
        "robotmode": f"Robotmode: {_MODE[controller.robot_mode]}",
        "safetymode": f"Safetymode: {SAFETY_MODE[controller.safety][1]}",
        "safetystatus": f"Safetystatus: {SAFETY_MODE[controller.safety][1]}",
        "running": f"Program running: {'true' if running else 'false'}",
        "programstate": "PLAYING rtde_control" if running else "STOPPED null",
        "get loaded program": "No program loaded",
        "get serial number": controller.serial,
        "get robot model": controller.model,
        "is in remote control": str(controller.remote).lower(),
        "close popup": "closing popup",
        "close safety popup": "closing safety popup",
    }
    return told[key] if key in told else _act(controller, request, key)


def _act(controller: Controller, request: str, key: str) -> str:
    match key:
        case "stop":
            controller.end_program("stopped at the dashboard")
            return "Stopped"
        case "unlock protective stop":
            if controller.safety == PROTECTIVE_STOP:
                controller.clear()
            return "Protective stop releasing"
        case "power on":
            controller.robot_mode = IDLE if controller.safety == NORMAL else controller.robot_mode
            return "Powering on"
        case "power off":
            controller.end_program("powered off")
            controller.robot_mode = POWER_OFF
            return "Powering off"
        case "brake release":
            controller.robot_mode = RUNNING if controller.safety == NORMAL else controller.robot_mode
            return "Brake releasing"
    return f"could not understand: '{request}'"
