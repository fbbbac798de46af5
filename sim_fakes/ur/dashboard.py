"""Dashboard, port 29999: one line of text a request, one line an answer."""

from __future__ import annotations

from .controller import SAFETY_MODE, FakeController, RobotMode, Runtime, Safety
from .wire import Connection

PORT = 29999
UNLOCKED_TOO_SOON = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
_MODE: dict[int, str] = {
    RobotMode.POWER_OFF: "POWER_OFF",
    RobotMode.POWER_ON: "POWER_ON",
    RobotMode.IDLE: "IDLE",
    RobotMode.RUNNING: "RUNNING",
}
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
        """Answer one line; False when none is complete or the connection ends."""
        line, newline, rest = self.buffer.partition(b"\n")
        if len(line) > 1024:
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


def answer(controller: FakeController, request: str) -> str:
    """What the dashboard says to a request; acts on the controller where the request asks for it."""
    key = request.lower()
    major = controller.version[0]
    if key in _SINCE and controller.version[:2] < _SINCE[key][0 if major == 3 else 1]:
        return f"could not understand: '{request}'"
    running = controller.runtime == Runtime.PLAYING
    answers = {
        "polyscopeversion": "URSoftware {}.{}.{}.{} (Sep 05 2022)".format(*controller.version),
        "robotmode": f"Robotmode: {_MODE[controller.robot_mode]}",
        "safetymode": f"Safetymode: {SAFETY_MODE[controller.safety][1]}",
        "safetystatus": f"Safetystatus: {SAFETY_MODE[controller.safety][1]}",
        "running": f"Program running: {'true' if running else 'false'}",
        "programstate": f"{controller.runtime.name} {'null' if controller.runtime == Runtime.STOPPED else 'rtde_control'}",
        "get loaded program": "No program loaded",
        "get serial number": controller.serial,
        "get robot model": controller.model,
        "is in remote control": str(controller.remote).lower(),
    }
    return answers[key] if key in answers else _act(controller, request, key)


def _act(controller: FakeController, request: str, key: str) -> str:
    """Do what a request (`key`: in lower case) asks for; the dashboard's answer."""
    match key:
        case "stop":
            if controller.runtime == Runtime.STOPPED:
                return "Failed to execute: stop"
            controller.end_program("stopped at the dashboard")
            return "Stopped"
        case "play" | "pause":  # a program that came over a network has no file to be played from
            return f"Failed to execute: {key}"
        case "unlock protective stop":
            return "Protective stop releasing" if controller.unlock() else UNLOCKED_TOO_SOON
        case "power on":
            controller.power(on=True)
            return "Powering on"
        case "power off" | "shutdown":
            controller.power(on=False)
            return "Powering off" if key == "power off" else "Shutting down"
        case "brake release":
            controller.power(on=True, release=True)
            return "Brake releasing"
        case "restart safety":
            controller.power(on=False)
            controller.safety = Safety.NORMAL
            return "Restarting safety"
    if key.startswith("load ") and (rest := request[5:].strip()):
        return f"File not found: {rest}"
    return f"could not understand: '{request}'"
