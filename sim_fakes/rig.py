"""All fake instruments of one rig, the virtual robot behind them, and the door for the person and the tests.

The plant moves in a thread of this process.
"""

from __future__ import annotations

import contextlib
import json
import socket
import tempfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

import timing
from timing import RigClock

from .faults import Accidents, FaultSwitch
from .instrument import Fake, FakePart, FakeRegulators, Site
from .motive import MotiveFake
from .plant import Plant
from .pty_fake import PtyFake
from .punctual import punctual
from .registry import OWN, of_role
from .ur.process import UrFake, UrProcess, free_host
from .virtual_robot import RobotTruth, VirtualRobot

LOOK = 0.05
"""Host seconds between two looks whether it has been stopped."""


class BackDoor:
    """The door into a rig of fakes that no real instrument has: JSON lines over a Unix socket that only its own user can reach.

    {"prepare": {"mount": "spine", "tip_mass": 0.0, "roll_deg": 0.0, "vacuum": 80000.0}}   what the person at the rig does
    {"confirm": "what was wrong"}                    a person has put it right; sets free what was held by `person`
    {"state": true}                                                                      what the plant is doing
    {"faults": {"pressure": {"silent": true}}}                                           faults of a serial fake
    {"fault": ["spine", "half"]}, {"fault": null}                                        one of `faults.FAULTS`; none
    {"drop_out": ["pressure", 0.5]}                                                      a cable is out this long, host s
    {"panel": ["pressure", "A", "unit", "psi"]}, {"panel": ["pressure", "A", "unlock"]}                  a person at a panel
    {"accident": "burst"}, {"accident": null}                                            one of `faults.ACCIDENTS`; none
    {"tip_visible": false}                                                               hide the tip from the cameras
    {"ur": {"do": "protective_stop"}}                                                    passed on to the arm's controller

    Each line is answered by {"ok": true, ...} or {"error": "..."}.
    """

    def __init__(self, do: Callable[[str, Any], dict[str, Any]]) -> None:
        """`do` does one request and returns what more is answered."""
        self._do = do
        self._folder = tempfile.TemporaryDirectory(prefix="softlab-")  # of mode 0700
        self.path = Path(self._folder.name) / "operator.sock"
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listening.bind(str(self.path))
        self._listening.listen()
        self._running = True
        self._thread = timing.Thread(target=self._serve, name="fake-backdoor")

    def start(self) -> None:
        """Accept connections."""
        self._thread.start()

    def stop(self) -> None:
        """End; may be called twice and before start."""
        self._running = False
        if self._thread.is_alive():
            self._thread.join(1.0)
        self._listening.close()
        self._folder.cleanup()

    def _serve(self) -> None:
        while self._running:
            if timing.readable([self._listening], LOOK):
                caller, _ = self._listening.accept()
                timing.Thread(target=self._hear, args=(caller,), name="fake-backdoor-caller").start()

    def _hear(self, caller: socket.socket) -> None:
        heard = b""
        with caller, contextlib.suppress(OSError):
            while more := timing.recv(caller, 65536):
                *lines, heard = (heard + more).split(b"\n")
                for line in lines:
                    caller.sendall(json.dumps(self.answer(line)).encode() + b"\n")

    def answer(self, line: bytes) -> dict[str, Any]:
        """Do what one line asks."""
        try:
            request = json.loads(line)
            extra: dict[str, Any] = {}
            for what, value in request.items():
                extra |= self._do(what, value)
        except (ValueError, KeyError, TypeError, AttributeError, RuntimeError, OSError) as e:
            return {"error": f"{type(e).__name__}: {e}"}
        return {"ok": True, **extra}


PLANT_PERIOD, ARM_ERROR = 0.01, 1.3e-3
"""Host seconds between two steps of the plant; m, standard deviation along an axis of what `arm_errors` of 1 do at the stand."""
SENSORS = "sensors."
"""A sensor of the lab's own is this and its name, as in rig.yaml."""
USUAL = MappingProxyType(
    {"arm": "ur5", "force": "ft300s", "spine": "dynamixel", "valve": "numato", "gauge": "pfeiffer", "mocap": "natnet"}
)
"""Driver of each instrument unless another is asked for; of the regulators see `FakeRegulators`."""
SEEDS = MappingProxyType({"force": 1, "spine": 2, "valve": 3, "gauge": 4, "pressure": 5, "mocap": 6, "arm": 7})
"""What each adds to the rig's seed; the arm comes first, since it takes longest to start."""
OF_SPINE = ("spine", "valve", "gauge")
REQUESTS = ("prepare", "confirm", "state", "faults", "fault", "drop_out", "panel", "accident", "tip_visible")
"""Of the back door."""


class FakeRig:
    """The fakes of a whole rig, started together. `rig_file()` is what a person would write to reach them."""

    def __init__(
        self,
        *,
        speed: float = 1.0,
        effects: Mapping[str, float] | None = None,
        seed: int = 0,
        regulators: str | FakeRegulators = "alicat",
        spine: str = USUAL["spine"],
        truth: RobotTruth | None = None,
        others: Mapping[str, str] | None = None,
        without: Collection[str] = (),
        sensors: Mapping[str, str] | None = None,
        known: Mapping[str, Fake] = OWN,
    ) -> None:
        """`effects`: id -> size of what the virtual robot does beyond the paper's assumptions. `spine`: the length unit's
        driver, "" for none. `others`: key of rig.yaml -> driver of arm, force, valve, gauge and mocap if not the usual one.
        `without`: keys of rig.yaml that are left out; without `spine`, valve and gauge are too. `sensors`: name -> driver of
        sensors of the lab's own. `known`: the fakes that there are, by the name of their driver. Three of nine chambers share
        a channel.
        """
        self.truth = truth or RobotTruth()
        chambers = len(self.truth.chamber_azimuths_deg)
        self.plant = Plant(chambers, arm_errors=self.truth.arm_errors)
        self.clock = RigClock(speed)
        self.robot = VirtualRobot(self.truth, dict(effects or {}), seed)
        self._warm_up(dict(effects or {}))
        self.wiring = ((9, 1, 2), (3, 4, 5), (6, 7, 8)) if chambers == 9 else tuple((i,) for i in range(1, chambers + 1))
        self.host = free_host()
        self.regulators = FakeRegulators(regulators) if isinstance(regulators, str) else regulators
        self.parts: dict[str, FakePart] = {}
        """What the fakes are made of, by key of rig.yaml; numbered from 1 where an instrument has several."""
        self._known = known
        self.tables: dict[str, Callable[[], dict[str, Any]]] = {}
        """What rig.yaml says of each."""
        drivers = {**USUAL, **(others or {}), "spine": spine, "pressure": self.regulators.driver}
        without = {*without, *(() if spine else ("spine",))}
        for role in ("arm", *(r for r in SEEDS if r != "arm")):
            if role not in without and not ("spine" in without and role in OF_SPINE):
                self._plug(role, role, drivers[role], seed + SEEDS[role])
        for number, (name, driver) in enumerate((sensors or {}).items()):
            self._plug("sensor", f"{SENSORS}{name}", driver, seed + 100 + number)
        self.door = BackDoor(self.do)
        self._running = False
        self._moving = timing.Thread(target=self._move_plant, name="fake-plant", daemon=True)
        self.accidents = Accidents(self.wiring)
        self.switch = FaultSwitch(self.parts, self.plant, self.accidents)
        self.troubles: list[str] = []
        """What a person was asked to put right."""
        self.on_confirm: Callable[[str], None] | None = None
        """What that person does about it."""

    def _plug(self, role: str, instrument: str, driver: str, seed: int) -> None:
        """Plug in the fake of one driver; raises ValueError when there is none for this key of rig.yaml."""
        fake = self._known.get(driver)
        if fake is None or fake.role != role:
            raise ValueError(f"no fake {driver} for {role}; one of {', '.join(of_role(role, self._known))}")
        regulators = self.regulators
        site = Site(
            plant=self.plant,
            clock=self.clock,
            seed=seed,
            host=self.host,
            markers=len(self.truth.markers),
            hoses=regulators.hoses(self.wiring),
            full_scale=regulators.full_scale or fake.full_scale,
            regulators=regulators,
        )
        parts = fake.plug(site)
        self.parts |= {f"{instrument}{i}" if len(parts) > 1 else instrument: part for i, part in enumerate(parts, 1)}

        def table() -> dict[str, Any]:
            table: dict[str, Any] = {"driver": driver}
            if role == "pressure":
                stated, widest = self.truth.max_pressure or 300e3, min(site.full_scale, 1e6)  # 300 kPa: rig.yaml's default
                of_chamber = np.broadcast_to(stated, len(self.truth.chamber_azimuths_deg))
                limits = [min(widest, *(float(of_chamber[c - 1]) for c in group)) for group in self.wiring]
                most = limits if len(set(limits)) > 1 else limits[0]
                table |= {"chambers": [[*group] for group in self.wiring], "full_scale": site.full_scale, "max_pressure": most}
            return {**table, **fake.table(site, parts)}

        self.tables[instrument] = table

    @property
    def lines(self) -> dict[str, PtyFake]:
        """The parts that are serial lines."""
        return {name: part for name, part in self.parts.items() if isinstance(part, PtyFake)}

    @property
    def mocap(self) -> MotiveFake | None:
        """The cameras, where they are Motive's."""
        part = self.parts.get("mocap")
        return part if isinstance(part, MotiveFake) else None

    @property
    def ur(self) -> UrProcess | None:
        """The arm's controller once it is started, where it is a UR's."""
        part = self.parts.get("arm")
        return part.process if isinstance(part, UrFake) else None

    def _warm_up(self, effects: dict[str, float]) -> None:
        """Have the physics compiled before any instrument answers: a compiler holds the interpreter for seconds."""
        plant = Plant(self.plant.chambers)
        for plant.mount in ("robot", "body", "spine"):
            plant.regulator[:3], plant.valve_on, plant.spine_drive = 50e3, True, 0.1
            robot = VirtualRobot(self.truth, effects)
            plant.probe_position = np.array(self.truth.stand)[:3, 3] + np.array(self.truth.stand)[:3, :3] @ [0.0, 0.0, 0.1]
            for _ in range(5):
                robot.advance(plant, 0.1)

    def start(self) -> FakeRig:
        """Start everything; returns when every instrument answers."""
        self._running = True
        for part in self.parts.values():
            part.start()
        self._moving.start()
        self.door.start()
        return self

    def stop(self) -> None:
        """End everything; may be called twice."""
        self._running = False
        self.door.stop()
        for part in self.parts.values():
            part.stop()
        if self._moving.is_alive():
            self._moving.join(1.0)

    def __enter__(self) -> FakeRig:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def prepare(self, mount: str, tip_mass: float, roll_deg: float, vacuum: float) -> None:
        """What the person at the rig does before a run. SI units, roll in degrees."""
        if mount not in ("robot", "body", "spine"):
            raise ValueError(f"mount {mount!r} must be robot, body or spine")
        with self.plant.lock:
            self.plant.mount = mount
            self.plant.tip_mass = float(tip_mass)
            self.plant.roll = float(np.radians(roll_deg))
            self.plant.vacuum_supply = float(vacuum)

    def confirm(self, trouble: str) -> dict[str, Any]:
        """A person is asked to put something right: does what `on_confirm` says, or nothing, and says it is done."""
        self.troubles.append(trouble)
        if self.on_confirm is not None:
            self.on_confirm(trouble)
        return {}

    # -- the plant
    def _move_plant(self) -> None:
        punctual()
        last = self.clock.now()
        while self._running:
            due = timing.now() + PLANT_PERIOD
            now = self.clock.now()
            with self.plant.lock:
                self.accidents.advance(self.robot, self.plant, now - last)
            last = now
            timing.sleep(max(0.0, due - timing.now()))

    # -- rig.yaml
    def rig_file(self, robot: str = "robot.yaml") -> dict[str, Any]:
        """The contents of the rig.yaml that reaches these instruments."""
        stand = np.array(self.truth.stand)
        sensors = {key.removeprefix(SENSORS): table() for key, table in self.tables.items() if key.startswith(SENSORS)}
        table: dict[str, Any] = {
            "name": "virtual rig",
            "robot": robot,
            "clock": {"speed": self.clock.speed},
            "operator": f"unix:{self.door.path}",
            "instruments": {
                **{key: table() for key, table in self.tables.items() if not key.startswith(SENSORS)},
                **({"sensors": sensors} if sensors else {}),
            },
        }
        if "arm" in self.tables:
            table["stand"] = {
                "origin": stand[:3, 3].tolist(),
                "axis": stand[:3, 2].tolist(),
                "push": stand[:3, 0].tolist(),
                "tool_rotation": [0.0, float(np.pi / 2), 0.0],
                "position_sd": ARM_ERROR * self.truth.arm_errors,
            }
        return table

    # -- the back door
    def do(self, what: str, value: Any) -> dict[str, Any]:
        """Do one request of the back door; returns what more is answered. Raises ValueError for what is not known."""
        if what == "prepare":
            self.prepare(**value)
        elif what == "confirm":
            return self.confirm(str(value))
        elif what == "state":
            return {"state": self.state()}
        elif what == "faults":
            for name in value:
                self._line(name)
            for name, faults in value.items():
                self.set_faults(name, faults)
        elif what == "fault":
            self.switch.begin(*value) if value else self.switch.end()
        elif what == "drop_out":
            self.switch.drop_out(*value)
        elif what == "panel":
            name, *change = value
            return {"changed": self._line(name).panel(*change)}
        elif what == "accident":
            self.accidents.begin(value) if value else self.accidents.end()
        elif what == "tip_visible":
            with self.plant.lock:
                self.plant.tip_visible = bool(value)
        elif what == "ur" and self.ur is not None:
            return {"ur": self.ur.backdoor(**value)}
        else:
            raise ValueError(f"unknown request {what!r}; one of {', '.join(REQUESTS)}, and ur where the arm is a UR")
        return {}

    def _line(self, name: str) -> PtyFake:
        """Return the serial line of this name; raises ValueError that names those that there are."""
        if name not in self.lines:
            raise ValueError(f"no serial line {name!r}; one of {', '.join(self.lines)}")
        return self.lines[name]

    def set_faults(self, line: str, values: Mapping[str, Any]) -> None:
        """Switch faults of one serial fake, by the names of `Faults` and of its module."""
        faults = self.lines[line].faults
        for name, value in values.items():
            if hasattr(faults, name):
                setattr(faults, name, value)
            else:
                faults.extra[name] = value

    def state(self) -> dict[str, Any]:
        """What the plant is doing, for tests and the curious; SI units."""
        p = self.plant
        with p.lock:
            return {
                "time": p.time, "mount": p.mount, "chamber_pressure": p.chamber_pressure.tolist(), "spine_length": p.spine_length,
                "valve_on": p.valve_on, "vacuum_absolute": p.vacuum_absolute, "tip_position": p.tip_position.tolist(),
                "probe_position": p.probe_position.tolist(), "probe_force": p.probe_force.tolist(), "tip_mass": p.tip_mass,
                "roll": p.roll, "spine_blocked": p.spine_blocked,
            }  # fmt: skip
