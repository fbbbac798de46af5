"""The back door: JSON, one object a line, for tests and for whoever starts the rig. No part of any robot, and at a
Unix socket, so that only its own user can reach it.

Requests, `do` and its other keys:
- state; set (q [rad], pose [m, rotation vector], wrench [N, N m], slider 0..1, scaling 0..1, payload [kg],
  payload_centre [m], tcp [m, rotation vector]); forget (empties the logs)
- protective_stop; emergency_stop; clear; power (on)
- pause (at the pendant; clear lets the program go on); safeguard_stop (somebody opens the cell, the same)
- safety (name: any state, as the dashboard calls it); serial (text)
- starting (text: what it says in place of data, "" ends it); remote (on: the pendant is in remote control)
- drop (cuts all connections); freeze (seconds, 0 ends it); dashboard (silent); halt (on: no cycle passes)
- stuck (variables: names whose values stay, or a table of names and values)
- lag (seconds); mangle (how: half, split, garbage, flip, replay or ""); skew (factor of the controller's own time)
Every answer is the state, or {"error": why}.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from .controller import FakeController, RobotMode
from .kinematics import Array, pose_matrix
from .wire import Connection, Hub


class UrBackDoor(Connection):
    """One caller; `subject` is the hub whose robot is changed. Never frozen or dropped, as it has a hub of its own."""

    def __init__(self, hub: Hub, subject: Hub) -> None:
        super().__init__(hub)
        self.subject = subject

    def take(self) -> bool:
        line, newline, rest = self.buffer.partition(b"\n")
        if not newline:
            return False
        self.buffer = rest
        try:
            act(self.subject, json.loads(line))
            reply = state(self.subject)
        except (ValueError, KeyError, TypeError) as error:
            reply = {"error": f"{type(error).__name__}: {error}"}
        self.transport.write(json.dumps(reply).encode() + b"\n")
        return True


def state(hub: Hub) -> dict[str, Any]:
    """Everything a test may want to know."""
    controller = hub.controller
    return {
        "t": controller.t,
        "q": controller.arm.q.tolist(),
        "pose": controller.arm.pose_vector().tolist(),
        "tcp_speed": controller.arm.tcp_speed().tolist(),
        "runtime": controller.runtime,
        "safety": controller.safety,
        "slider": controller.slider,
        "commands": [dataclasses.asdict(command) for command in controller.commands],
        "ended": controller.ended,
        "violations": hub.violations,
        "connections": len(hub.connections),
        "heard": hub.heard,
    }


def act(hub: Hub, request: dict[str, Any]) -> None:
    """Do what a request asks for. Raises ValueError, KeyError or TypeError for a bad one."""
    controller = hub.controller
    match request["do"]:
        case "state":
            pass
        case "set":
            _set(controller, request)
        case "protective_stop":
            controller.protective_stop("back door")
        case "emergency_stop":
            controller.safety_stop("ROBOT_EMERGENCY_STOP")
        case "pause":
            controller.pause()
        case "safeguard_stop":
            controller.safety_stop("SAFEGUARD_STOP")
        case "safety":
            controller.safety_stop(str(request["name"]))
        case "remote":
            controller.remote = bool(request["on"])
        case "starting":
            controller.starting = str(request["text"])
        case "serial":
            controller.serial = str(request["text"])
        case "halt":
            controller.halted = bool(request["on"])
        case "lag":
            hub.lag = float(request["seconds"])
        case "mangle":
            hub.mangle = str(request["how"])
            for connection in hub.connections:
                connection.last = b""
        case "skew":
            controller.skew = float(request["factor"])
        case "clear":
            controller.clear()
        case "drop":
            hub.drop()
        case "freeze":
            hub.freeze(float(request["seconds"]))
        case "dashboard":
            hub.dashboard_silent = bool(request["silent"])
        case "power":
            if not request["on"]:
                controller.power(on=False)
            elif controller.robot_mode != RobotMode.RUNNING:
                controller.power(on=False)
                controller.robot_mode = RobotMode.RUNNING
        case "stuck":
            stuck = request["variables"]
            controller.stuck = stuck if isinstance(stuck, dict) else {name: controller.value(name) for name in stuck}
        case "forget":
            controller.commands.clear()
            controller.ended.clear()
            hub.violations.clear()
        case other:
            raise ValueError(f"unknown request {other!r}")


def _set(controller: FakeController, request: dict[str, Any]) -> None:
    """Put the arm and its settings where a request says."""
    unknown = set(request) - {"do", "q", "pose", "wrench", "slider", "scaling", "payload", "payload_centre", "tcp"}
    if unknown:
        raise ValueError(f"unknown keys {sorted(unknown)}")
    if "slider" in request:
        controller.slider = min(1.0, max(0.0, float(request["slider"])))
    if "scaling" in request:
        controller.scaling = min(1.0, max(0.0, float(request["scaling"])))
    if "payload" in request:
        controller.payload = float(request["payload"])
    if "payload_centre" in request:
        controller.payload_centre = np.asarray(request["payload_centre"], float)
    if "tcp" in request:
        controller.arm.tool = pose_matrix(_six(request["tcp"]))
    if "wrench" in request:
        controller.wrench = _six(request["wrench"])
    if "q" in request or "pose" in request:
        q = _six(request["q"]) if "q" in request else controller.arm.solve(pose_matrix(_six(request["pose"])))
        if q is None:
            raise ValueError(f"pose {request['pose']} is out of reach")
        controller.end_program("arm moved by hand")
        controller.arm.q = q


def _six(values: list[float]) -> Array:
    array = np.asarray(values, float)
    if array.shape != (6,) or not np.all(np.isfinite(array)):
        raise ValueError(f"six finite numbers are needed, not {values}")
    return array
