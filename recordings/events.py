"""Messages of the experiment itself: /state (what is asked for), /trial (what was concluded), /progress (how much of the
plan is done), /request (what people asked of it), /log; and those for viewers.

They hold text, so their layout is not fixed and the protobuf runtime encodes them. On /state and /trial the flat
fields are for looking and plotting; the field `json` holds everything, exactly, and is what is read back, with what came
later: `clipped`, `repeats` (the number of the state that was read again, 0 where none was), and on /state the vacuum that
the spine must keep (`vacuum_since`, `vacuum_lowest`, `vacuum_highest`), `least_force`, and where the robot allows bodies
to be (`bodies_since`, `bodies_arcs`, `bodies_stretch`), where they were demanded.

What is only known at the end of a trial, or later than a row, is an event of its own, which tables apply to the rows: /zero
(how the force sensor's zero moved during a trial) and /mark (why the states of a trial up to then are in doubt).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import ParseDict
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp

from .messages import PACKAGE, SCHEMA_VERSION
from .states.rules import State
from .states.zeros import Drift, Zeros
from .trials import TrialRow

CONFIRMED, UNCONFIRMED = "confirmed", "not confirmed"
"""The rig's safe state at the end of a run: `safe_state` of the metadata `outcome`."""
BASE_FRAME = "base"
"""Name of the robot's base frame in /tip/pose and /tip/markers."""
JOINTS_OF_ARM = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Names of the arm's joints in /arm/joints, from base to tool."""

_OPTIONAL, _REPEATED = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED
_DOUBLE, _INT64 = FieldDescriptorProto.TYPE_DOUBLE, FieldDescriptorProto.TYPE_INT64
_STRING, _BOOL = FieldDescriptorProto.TYPE_STRING, FieldDescriptorProto.TYPE_BOOL

_STATE = (
    ("t", _DOUBLE, _OPTIONAL, "s"),
    ("number", _INT64, _OPTIONAL, ""),
    ("trial", _INT64, _OPTIONAL, ""),
    ("step", _INT64, _OPTIONAL, ""),
    ("protocol", _STRING, _OPTIONAL, ""),
    ("repeat", _INT64, _OPTIONAL, ""),
    ("branch", _STRING, _OPTIONAL, ""),
    ("rule", _STRING, _OPTIONAL, ""),
    ("t_start", _DOUBLE, _OPTIONAL, "s"),
    ("rate", _DOUBLE, _OPTIONAL, "Pa/s"),
    ("targets", _DOUBLE, _REPEATED, "Pa"),
    ("spine_length", _DOUBLE, _OPTIONAL, "m"),
    ("json", _STRING, _OPTIONAL, ""),
    ("clipped", _BOOL, _OPTIONAL, ""),
    ("repeats", _INT64, _OPTIONAL, ""),
    ("vacuum_since", _DOUBLE, _OPTIONAL, "s"),
    ("vacuum_lowest", _DOUBLE, _OPTIONAL, "Pa"),
    ("vacuum_highest", _DOUBLE, _OPTIONAL, "Pa"),
    ("least_force", _DOUBLE, _OPTIONAL, "N"),
    ("bodies_since", _DOUBLE, _OPTIONAL, "s"),
    ("bodies_arcs", _DOUBLE, _REPEATED, "m"),
    ("bodies_stretch", _DOUBLE, _OPTIONAL, ""),
)
_TRIAL = (
    ("t", _DOUBLE, _OPTIONAL, "s"),
    ("number", _INT64, _OPTIONAL, ""),
    ("trial", _INT64, _OPTIONAL, ""),
    ("step", _INT64, _OPTIONAL, ""),
    ("pressures", _DOUBLE, _REPEATED, "Pa"),
    ("tip", _DOUBLE, _REPEATED, "m"),
    ("force", _DOUBLE, _OPTIONAL, "N"),
    ("deflection", _DOUBLE, _OPTIONAL, "m"),
    ("json", _STRING, _OPTIONAL, ""),
    ("clipped", _BOOL, _OPTIONAL, ""),
    ("repeats", _INT64, _OPTIONAL, ""),
)
_REQUEST = (
    ("t", _DOUBLE, _OPTIONAL, "s"),
    ("kind", _STRING, _OPTIONAL, ""),
    ("by", _STRING, _OPTIONAL, ""),
    ("text", _STRING, _OPTIONAL, ""),
    ("done", _BOOL, _OPTIONAL, ""),
    ("trial", _INT64, _OPTIONAL, ""),
    ("step", _INT64, _OPTIONAL, ""),
)
_ZERO = (
    ("t", _DOUBLE, _OPTIONAL, "s"),
    ("trial", _INT64, _OPTIONAL, ""),
    ("direction", _DOUBLE, _REPEATED, ""),
    ("before", _DOUBLE, _REPEATED, "s"),
    ("start", _DOUBLE, _REPEATED, "s"),
    ("end", _DOUBLE, _REPEATED, "s"),
    ("offset_at", _DOUBLE, _OPTIONAL, "s"),
    ("drift", _DOUBLE, _OPTIONAL, "N"),
    ("rate", _DOUBLE, _OPTIONAL, "N/s"),
    ("linear", _BOOL, _OPTIONAL, ""),
)
_MARK = (
    ("t", _DOUBLE, _OPTIONAL, "s"),
    ("trial", _INT64, _OPTIONAL, ""),
    ("doubt", _STRING, _OPTIONAL, ""),
    ("text", _STRING, _OPTIONAL, ""),
)
_PROGRESS = (
    ("t", _DOUBLE, _OPTIONAL, "s"),
    ("steps", _INT64, _OPTIONAL, ""),
    ("steps_planned", _INT64, _OPTIONAL, ""),
    ("seconds", _DOUBLE, _OPTIONAL, "s"),
    ("seconds_planned", _DOUBLE, _OPTIONAL, "s"),
)


@dataclass(frozen=True)
class EventType:
    """A message encoded by the protobuf runtime: topic, full name, FileDescriptorSet and channel metadata."""

    topic: str
    full_name: str
    schema: bytes
    metadata: dict[str, str]
    message_class: type[Any]


def _ours(name: str, topic: str, fields: Sequence[tuple[str, Any, Any, str]]) -> EventType:
    file = FileDescriptorProto(name=f"{PACKAGE}/{name}.proto", package=PACKAGE, syntax="proto2")
    message = file.message_type.add(name=name)
    for number, (field, kind, label, _) in enumerate(fields, 1):
        message.field.add(name=field, number=number, label=label, type=kind)
    pool = DescriptorPool()
    pool.Add(file)  # type: ignore[no-untyped-call]
    full_name = f"{PACKAGE}.{name}"
    units = {f"unit.{field}": unit for field, _, _, unit in fields if unit}
    schema = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
    message_class = GetMessageClass(pool.FindMessageTypeByName(full_name))  # type: ignore[no-untyped-call]
    return EventType(topic, full_name, schema, {"schema_version": SCHEMA_VERSION, **units}, message_class)


def _foreign(topic: str, message_class: type[Any]) -> EventType:
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


STATE = _ours("State", "/state", _STATE)
TRIAL = _ours("Trial", "/trial", _TRIAL)
PROGRESS = _ours("Progress", "/progress", _PROGRESS)
REQUEST = _ours("Request", "/request", _REQUEST)
ZERO = _ours("Zero", "/zero", _ZERO)
MARK = _ours("Mark", "/mark", _MARK)
LOG = _foreign("/log", Log)
POSE = _foreign("/tip/pose", PoseInFrame)
POSES = _foreign("/tip/markers", PosesInFrame)
JOINTS = _foreign("/arm/joints", JointStates)

EVENTS: dict[str, EventType] = {
    event.topic: event for event in (STATE, TRIAL, LOG, POSE, POSES, JOINTS, PROGRESS, REQUEST, ZERO, MARK)
}

LEVELS = ("debug", "info", "warning", "error", "fatal")
LONGEST_TEXT = 10_000
"""Characters of a line of /log and of the detail of an outcome; what instruments say ends up there."""


REQUESTS = ("note", "pause", "go on", "repeat", "skip", "finish")
"""What people may ask of a run: to write a note down, to pause before the next step, to go on, to read a state again, to leave
a trial out, to end after the present step."""


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


def encode_request(request: Request) -> bytes:
    """A message of /request."""
    texts = {name: bounded(getattr(request, name)) for name in ("kind", "by", "text")}
    message = REQUEST.message_class(t=request.t, done=request.done, trial=request.trial, step=request.step, **texts)
    return bytes(message.SerializeToString())


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
    return [
        next((replace(row, doubt=m.doubt) for m in marks if m.trial == row.trial and row.t < m.t), row) for row in rows
    ]


def encode_zero(t: float, zeros: Zeros, drift: Drift) -> bytes:
    """A message of /zero."""
    message = ZERO.message_class(t=t, drift=drift.force, rate=drift.rate, linear=drift.linear, **asdict(zeros))
    return bytes(message.SerializeToString())


def encode_mark(mark: Mark) -> bytes:
    """A message of /mark."""
    return bytes(MARK.message_class(**asdict(mark) | {"text": bounded(mark.text)}).SerializeToString())


def encode_state(t: float, number: int, state: State, repeats: int = 0) -> bytes:
    """`number` counts the states of a recording; the row that comes of it carries the same number."""
    message = STATE.message_class(
        t=t,
        number=number,
        trial=state.trial,
        step=state.step,
        protocol=state.protocol,
        repeat=state.repeat,
        branch=state.branch,
        rule=state.rule_name,
        t_start=state.t_start,
        rate=state.rate,
        targets=state.targets,
        spine_length=state.spine_length,
        json=state.to_json(),
        clipped=state.clipped,
        repeats=repeats,
        least_force=state.least_force,
        **({} if state.vacuum is None else {f"vacuum_{name}": x for name, x in asdict(state.vacuum).items()}),
        **({} if state.bodies is None else {f"bodies_{name}": x for name, x in asdict(state.bodies).items()}),
    )
    return bytes(message.SerializeToString())


def encode_trial(t: float, number: int, row: TrialRow, repeats: int = 0) -> bytes:
    """The row that was concluded for state `number`."""
    message = TRIAL.message_class(
        t=t,
        number=number,
        trial=row.trial,
        step=row.step,
        pressures=row.pressures,
        tip=row.tip or (),
        force=row.force,
        deflection=row.deflection,
        json=row.to_json(),
        clipped=row.clipped,
        repeats=repeats,
    )
    return bytes(message.SerializeToString())


def encode_progress(t: float, steps: int, steps_planned: int, seconds: float, seconds_planned: float) -> bytes:
    """So many of the planned steps are done, and so many of the planned seconds of rig time."""
    message = PROGRESS.message_class(
        t=t, steps=steps, steps_planned=steps_planned, seconds=seconds, seconds_planned=seconds_planned
    )
    return bytes(message.SerializeToString())


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
    message = Log(level=Log.Level.Value(level.upper()), message=text, name=name)
    message.timestamp.FromNanoseconds(log_time)
    return message.SerializeToString()


def _template(message: Any) -> tuple[struct.Struct, list[bytes]]:
    """How a message is packed whose numbers are all doubles (each 1.0 here): its layout and its constant bytes.

    Viewers get many such messages; this way one costs a microsecond instead of twenty.
    """
    parts = message.SerializeToString().split(_DOUBLE_BYTES.pack(1.0))
    return struct.Struct("<" + "d".join(f"{len(part)}s" for part in parts)), parts


def _filled(template: tuple[struct.Struct, list[bytes]], log_time: int, numbers: Sequence[float]) -> bytes:
    """The message of a template with its numbers, behind the time stamp that is its first field."""
    layout, parts = template
    stamp = Timestamp(seconds=log_time // 10**9, nanos=log_time % 10**9).SerializeToString()
    values: list[object] = [parts[0]]
    for number, part in zip(numbers, parts[1:], strict=True):
        values += (number, part)
    return b"\x0a" + bytes([len(stamp)]) + stamp + layout.pack(*values)


_DOUBLE_BYTES = struct.Struct("<d")
_ONE = {"x": 1.0, "y": 1.0, "z": 1.0}
_POSE = _template(
    ParseDict({"frame_id": BASE_FRAME, "pose": {"position": _ONE, "orientation": _ONE | {"w": 1.0}}}, PoseInFrame())
)
_JOINTS = _template(ParseDict({"joints": [{"name": name, "position": 1.0} for name in JOINTS_OF_ARM]}, JointStates()))


def encode_pose(log_time: int, position: Sequence[float], orientation: Sequence[float]) -> bytes:
    """Tip pose in the base frame: position (m), orientation (w, x, y, z)."""
    w, x, y, z = orientation
    return _filled(_POSE, log_time, (*position, x, y, z, w))


def encode_poses(log_time: int, positions: Sequence[Sequence[float]]) -> bytes:
    """Body markers in the base frame: positions (m); a marker has no orientation of its own."""
    message = PosesInFrame(frame_id=BASE_FRAME)
    message.timestamp.FromNanoseconds(log_time)
    for place in positions:
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = place
        pose.orientation.w = 1.0
    return message.SerializeToString()


def encode_joints(log_time: int, angles: Sequence[float]) -> bytes:
    """Angles of the arm's joints, rad."""
    return _filled(_JOINTS, log_time, angles)
