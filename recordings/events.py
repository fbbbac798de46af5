"""Messages of the experiment itself: /state (what is asked for), /trial (what was concluded), /progress (how much of the
plan is done), /request (what people asked of it), /log; and those for viewers.

They hold text, so their layout is not fixed and the protobuf runtime encodes them. On /state and /trial the flat
fields are for looking and plotting; the field `json` holds everything, exactly, and is what is read back, with what came
later: `clipped`, `repeats` (the number of the state that was read again, 0 where none was), and on /state the vacuum that
the spine must keep (`vacuum_since`, `vacuum_lowest`, `vacuum_highest`), `least_force`, and where the robot allows bodies
to be (`bodies_since`, `bodies_arcs`, `bodies_stretch`, `bodies_off`), where they were demanded.

What is only known at the end of a trial, or later than a row, is an event of its own, which tables apply to the rows: /zero
(how the force sensor's zero moved during a trial) and /mark (why the states of a trial up to then are in doubt).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from .errors import BadMessage, Damaged
from .messages import PACKAGE, SCHEMA_VERSION
from .states.demands import Bodies, VacuumBand
from .states.rules import LARGEST, State, checked
from .states.zeros import Drift, Zeros
from .trials import DOUBTS, TrialRow

CONFIRMED, UNCONFIRMED = "confirmed", "not confirmed"
"""The rig's safe state at the end of a run: `safe_state` of the metadata `outcome`."""


@dataclass(frozen=True)
class EventType:
    """A message encoded by the protobuf runtime: topic, full name, FileDescriptorSet and channel metadata."""

    topic: str
    full_name: str
    schema: bytes
    metadata: dict[str, str]
    message_class: type[Any]


def _ours(name: str, topic: str, fields: str) -> EventType:
    """A message of our own. `fields`: name, type (several: `*`) and unit of each, with commas between them."""
    file = FileDescriptorProto(name=f"{PACKAGE}/{name}.proto", package=PACKAGE, syntax="proto2")
    message, units = file.message_type.add(name=name), dict[str, str]()
    for number, (field, kind, *unit) in enumerate(map(str.split, fields.split(",")), 1):
        label = FieldDescriptorProto.LABEL_REPEATED if kind.endswith("*") else FieldDescriptorProto.LABEL_OPTIONAL
        field_type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.removesuffix('*').upper()}")
        message.field.add(name=field, number=number, label=label, type=field_type)
        units |= {f"unit.{field}": text for text in unit}
    pool = DescriptorPool()
    pool.Add(file)  # type: ignore[no-untyped-call]
    full_name = f"{PACKAGE}.{name}"
    schema = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
    message_class = GetMessageClass(pool.FindMessageTypeByName(full_name))  # type: ignore[no-untyped-call]
    return EventType(topic, full_name, schema, {"schema_version": SCHEMA_VERSION, **units}, message_class)


def _published(topic: str, message_class: type[Any]) -> EventType:
    """A message of a published schema, with the files that it depends on."""
    files: dict[str, FileDescriptorProto] = {}

    def add(file: FileDescriptor) -> None:
        for dependency in file.dependencies:
            add(dependency)
        if file.name not in files:
            files[file.name] = FileDescriptorProto()
            file.CopyToProto(files[file.name])

    add(message_class.DESCRIPTOR.file)
    schema = FileDescriptorSet(file=list(files.values())).SerializeToString(deterministic=True)
    return EventType(topic, message_class.DESCRIPTOR.full_name, schema, {}, message_class)


STATE = _ours(
    "State", "/state",
    "t double s, number int64, trial int64, step int64, protocol string, repeat int64, branch string, rule string, "
    "t_start double s, rate double Pa/s, targets double* Pa, spine_length double m, json string, clipped bool, repeats int64, "
    "vacuum_since double s, vacuum_lowest double Pa, vacuum_highest double Pa, least_force double N, bodies_since double s, "
    "bodies_arcs double* m, bodies_stretch double, bodies_off double* m",
)  # fmt: skip
TRIAL = _ours(
    "Trial", "/trial",
    "t double s, number int64, trial int64, step int64, pressures double* Pa, tip double* m, force double N, "
    "deflection double m, json string, clipped bool, repeats int64",
)  # fmt: skip
PROGRESS = _ours(
    "Progress", "/progress", "t double s, steps int64, steps_planned int64, seconds double s, seconds_planned double s"
)
REQUEST = _ours("Request", "/request", "t double s, kind string, by string, text string, done bool, trial int64, step int64")
ZERO = _ours(
    "Zero", "/zero",
    "t double s, trial int64, direction double*, before double* s, start double* s, end double* s, offset_at double s, "
    "drift double N, rate double N/s, linear bool",
)  # fmt: skip
MARK = _ours("Mark", "/mark", "t double s, trial int64, doubt string, text string")
LOG = _published("/log", Log)
POSE = _published("/tip/pose", PoseInFrame)
POSES = _published("/tip/markers", PosesInFrame)
JOINTS = _published("/arm/joints", JointStates)

EVENTS: dict[str, EventType] = {
    event.topic: event for event in (STATE, TRIAL, LOG, POSE, POSES, JOINTS, PROGRESS, REQUEST, ZERO, MARK)
}

_LEVELS: dict[int, str] = {number: name.lower() for name, number in Log.Level.items()}
LEVELS = ("debug", "info", "warning", "error", "fatal")
LONGEST_TEXT = 10_000
"""Characters of a line of /log and of the detail of an outcome; what instruments say ends up there."""
REQUESTS = ("note", "pause", "go on", "repeat", "skip", "finish")
"""What people may ask of a run: to write a note down, to pause before the next step, to go on, to read a state again, to leave
a trial out, to end after the present step."""


@dataclass(frozen=True)
class StateEvent:
    """What was asked for at rig time `t` (s); `number` counts the states of a recording."""

    t: float
    number: int
    state: State
    repeats: int = 0
    """Number of the state that is read again; 0: of none."""


@dataclass(frozen=True)
class TrialEvent:
    """The row that was concluded live for state `number`, recorded at rig time `t` (s)."""

    t: float
    number: int
    row: TrialRow
    repeats: int = 0
    """Number of the state that was read again; 0: of none."""


@dataclass(frozen=True)
class ZeroEvent:
    """How the force sensor's zero moved during a trial, as it was concluded live."""

    t: float
    zeros: Zeros
    drift: Drift


@dataclass(frozen=True)
class LogLine:
    """One line of /log, `log_time` ns since the epoch."""

    log_time: int
    level: str
    text: str


@dataclass(frozen=True)
class Request:
    """What somebody asked of a run at rig time `t` (s), or, when `done`, what was carried out then."""

    t: float
    kind: str
    """One of `REQUESTS`."""
    by: str
    """Where it was asked: "terminal", "page", or the name that a program gives."""
    text: str = ""
    """Of a note."""
    done: bool = False
    trial: int = 0
    """The trial that was under way, and the state of it that was asked for last; 0 before the first."""
    step: int = 0


@dataclass(frozen=True)
class Mark:
    """The states of a trial that were read before rig time `t` (s) are in doubt."""

    t: float
    trial: int
    doubt: str
    """One of `trials.DOUBTS`."""
    text: str
    """What was seen, for people."""


def marked(rows: Iterable[TrialRow], marks: Sequence[Mark]) -> list[TrialRow]:
    """Rows with the doubts that are recorded about them."""
    return [next((replace(row, doubt=m.doubt) for m in marks if m.trial == row.trial and row.t < m.t), row) for row in rows]


# -- to bytes
def encoded(event: EventType, source: object = None, **fields: object) -> bytes:
    """A message of these fields; any other is the attribute of its name of `source`, where that has one."""
    names = [field.name for field in event.message_class.DESCRIPTOR.fields]
    values = {name: fields[name] if name in fields else getattr(source, name, None) for name in names}
    return bytes(event.message_class(**values).SerializeToString())


def writable(text: str) -> str:
    """The text with halves of characters, which no file can hold, written out: bytes that are no UTF-8 come as such."""
    return text.encode("utf-8", "backslashreplace").decode()


def bounded(text: str) -> str:
    """The text as it is but for an end that is too long, and for halves of characters."""
    whole = writable(text)
    over = len(whole) - LONGEST_TEXT
    return whole if over <= 0 else f"{whole[:LONGEST_TEXT]} ... ({over} more characters)"


def encode_log(log_time: int, level: str, text: str, name: str) -> bytes:
    """`log_time` ns since the epoch, `level` one of `LEVELS`."""
    return _stamped(Log(level=Log.Level.Value(level.upper()), message=text, name=name), log_time)


# -- and back
def _state(log_time: int, m: Any) -> StateEvent:
    vacuum = bodies = None
    if m.HasField("vacuum_since"):
        vacuum = checked(VacuumBand(m.vacuum_since, m.vacuum_lowest, m.vacuum_highest))
    if m.HasField("bodies_since"):
        bodies = checked(Bodies(m.bodies_since, tuple(m.bodies_arcs), m.bodies_stretch, tuple(m.bodies_off)))
    least_force = m.least_force if m.HasField("least_force") else None
    state = replace(State.from_json(m.json), clipped=m.clipped, vacuum=vacuum, least_force=least_force, bodies=bodies)
    return StateEvent(m.t, m.number, checked(state), m.repeats)


def _trial(log_time: int, m: Any) -> TrialEvent:
    return TrialEvent(m.t, m.number, replace(TrialRow.from_json(m.json), clipped=m.clipped), m.repeats)


def _zero(log_time: int, m: Any) -> ZeroEvent:
    numbers = (*m.direction, *m.before, *m.start, *m.end, m.offset_at, m.drift, m.rate)
    if tuple(map(len, (m.direction, m.before, m.start, m.end))) != (3, 2, 2, 2) or not all(abs(x) <= LARGEST for x in numbers):
        raise BadMessage(f"/zero at {m.t:g} s: is not three spans of time, a direction and a drift")
    x, y, z = m.direction
    before, start, end = ((float(a), float(b)) for a, b in (m.before, m.start, m.end))
    return ZeroEvent(m.t, Zeros(m.trial, (x, y, z), before, start, end, m.offset_at), Drift(m.drift, m.rate, m.linear))


def _mark(log_time: int, m: Any) -> Mark:
    mark = Mark(m.t, m.trial, m.doubt, m.text)
    if mark.doubt not in DOUBTS:
        raise BadMessage(f"/mark at {mark.t:g} s: doubt {mark.doubt[:40]!r} is unknown; one of {', '.join(DOUBTS)}")
    return mark


READ: dict[str, Callable[[int, Any], Any]] = {
    STATE.topic: _state,
    TRIAL.topic: _trial,
    LOG.topic: lambda log_time, m: LogLine(log_time, _LEVELS.get(m.level, f"level {m.level}"), m.message),
    REQUEST.topic: lambda log_time, m: Request(m.t, m.kind, m.by, m.text, m.done, m.trial, m.step),
    ZERO.topic: _zero,
    MARK.topic: _mark,
}
"""Topic -> what a message with its log time (ns) says; see `read_event`."""


def read_event(topic: str, log_time: int, message: Any) -> Any:
    """What a message on a topic of `READ` says; raises `BadMessage`, `BadTable`, or `Damaged` where it holds no text."""
    try:
        return READ[topic](log_time, message)
    except UnicodeDecodeError as error:
        raise Damaged(f"a message of {topic} is not text ({error}); run `lab verify`") from error


# -- for viewers: a stream's messages again in published schemas. They serve the eye only; nothing is computed from them.
VIEW_PERIOD = 1 / 30
"""Rig seconds between two messages of a view."""
BASE_FRAME = "base"
"""Name of the robot's base frame in /tip/pose and /tip/markers."""
JOINTS_OF_ARM = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Names of the arm's joints in /arm/joints, from base to tool."""


def _stamped(message: Any, log_time: int) -> bytes:
    message.timestamp.FromNanoseconds(log_time)
    return bytes(message.SerializeToString())


def _placed(position: Sequence[float], orientation: Sequence[float]) -> Pose:
    (x, y, z), (qw, qx, qy, qz) = position, orientation
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=qw, x=qx, y=qy, z=qz))


def _pose(log_time: int, tip: np.void) -> bytes | None:
    if not tip["valid"]:
        return None
    place = _placed(tip["position"].tolist(), tip["orientation"].tolist())
    return _stamped(PoseInFrame(frame_id=BASE_FRAME, pose=place), log_time)


def _markers(log_time: int, tip: np.void) -> bytes | None:
    """Of body markers only the positions: a marker has no orientation of its own."""
    seen = [_placed(marker, (1.0, 0.0, 0.0, 0.0)) for marker in tip["markers"].tolist() if all(map(math.isfinite, marker))]
    return _stamped(PosesInFrame(frame_id=BASE_FRAME, poses=seen), log_time) if seen else None


def _joints(log_time: int, arm: np.void) -> bytes | None:
    pairs = zip(JOINTS_OF_ARM, arm["joints"].tolist(), strict=True)
    return _stamped(JointStates(joints=[JointState(name=name, position=angle) for name, angle in pairs]), log_time)


VIEWS: dict[str, tuple[tuple[str, Callable[[int, np.void], bytes | None]], ...]] = {
    "/tip": ((POSE.topic, _pose), (POSES.topic, _markers)),
    "/arm": ((JOINTS.topic, _joints),),
}
"""Stream -> the topics that show it, each with its encoder: (log time ns, the stream's message) -> message, None when there is
nothing to see."""
