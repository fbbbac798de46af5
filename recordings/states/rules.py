"""What a protocol asks for: one `State` per row of the table, recorded on /state before the row is concluded.

A state holds everything a reading needs besides the samples: where to look in time (`rule`), which streams the reading
relies on (`topics`), and the columns that are set rather than measured. With it the reading can be done again from the
file.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, dataclass
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from ..ambient import AMBIENT
from ..errors import BadMessage
from ..json_text import read_json
from ..messages import STREAMS, is_stream
from ..trials import LARGEST_INTEGER
from .demands import Bodies, VacuumBand

PROTOCOL = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,39}")
PROTOCOL_IS = "must be letters, digits, _ and -, at most 40"
"""The name of a protocol; which there are is not known here."""
BRANCHES = ("load", "unload")
SPECIMENS = ("spine", "body")
LARGEST = 1e15
"""No number of a state is larger, in any unit; squares of such numbers are still finite."""
LONGEST_AVERAGE = 10_000
"""Samples of a moving average."""
BESIDE_JSON = ("clipped", "vacuum", "least_force", "bodies")
"""Fields of a state that came after its JSON text was first read key by key."""


@dataclass(frozen=True)
class Settled:
    """Read when pressures and tip have been at rest for `still` s; the mean of that time.

    In the window that is averaged: every pressure sample is within `band` (Pa) of its target; the tip is never unseen
    for longer than `max_hidden` (s); each axis of its moving average over `smooth` samples stays within
    `still_distance` (m) from peak to peak; no other stream pauses longer than `max_gap` (s). The window lasts at least
    `still` and `average` (s) and holds `min_samples` of every stream relied on. The first such window after `t_start`
    counts; `NotSettled` when there is none within `timeout` (s).
    """

    band: float = 1500.0
    still: float = 1.0
    still_distance: float = 0.5e-3
    smooth: int = 10
    average: float = 0.5
    min_samples: int = 5
    max_gap: float = 0.5
    max_hidden: float = 0.1
    timeout: float = 60.0


@dataclass(frozen=True)
class Window:
    """Read from `delay` to `delay + average` seconds after `t_start`; `NotSettled` with fewer than `min_samples`."""

    delay: float
    average: float = 0.5
    min_samples: int = 3


@dataclass(frozen=True)
class Crossing:
    """Read while ramping, where the mean pressure of `chambers` (0 = first) first crosses `level` (Pa), going up or
    down.

    Each quantity is the straight line through its samples in `average` s around the crossing. `NotSettled` with fewer than
    `min_samples`, or without a crossing within `timeout` s.
    """

    level: float
    chambers: tuple[int, ...]
    rising: bool
    average: float = 0.3
    min_samples: int = 2
    timeout: float = 60.0


Rule = Settled | Window | Crossing


def longest(rule: Rule) -> float:
    """Seconds after a state's `t_start` beyond which its rule looks at no sample."""
    return rule.average + (rule.delay if isinstance(rule, Window) else rule.timeout)


_RULES: dict[str, type[Rule]] = {"settled": Settled, "window": Window, "crossing": Crossing}


@dataclass(frozen=True)
class Probe:
    """How the arm pushes in a stiffness trial, in the arm's base frame.

    `direction`: unit vector of the push. `origin`: TCP position (m) where deflection is zero. `sensor_rotation`:
    rotation vector (rad) that turns vectors of the force sensor's frame into the TCP frame. `force_offset` (N): force
    along the push read at the origin, subtracted. The sensor measures what the specimen does to the probe, so the
    force on the specimen along the push is minus the measured force projected on `direction`.
    """

    direction: tuple[float, float, float]
    origin: tuple[float, float, float]
    sensor_rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force_offset: float = 0.0

    def __post_init__(self) -> None:
        length = math.sqrt(math.fsum(c * c for c in self.direction))
        if not abs(length - 1.0) < 1e-6:
            raise BadMessage(f"probe direction {self.direction} has length {length:.6g}; give a unit vector")


@dataclass(frozen=True)
class State:
    """One state to read. SI units; pressures Pa gauge.

    `t_start`: rig time (s) from which the rule looks; `ramp_end`: rig time (s) at which the last ramp ended (`hold`
    counts from it; a crossing has hold 0); `rate` (Pa/s): of the ramp that led here; `targets` (Pa): pressures asked
    for, by chamber; `spine_length` (m): length asked for, used when /spine is not among `topics`; `ambient` (Pa
    absolute): what `vacuum` counts from; `topics`: the streams that must reach the end of the window and are averaged
    into the row.

    Beside the JSON text, which older readers take apart key by key: `clipped`: the rig's limits clipped set-points on the
    way here; `vacuum`: what the jammed spine must have kept, None where it is not jammed; `least_force` (N): force on the
    specimen along the push, in excess of the probe's offset, below which it does not count as jammed; `bodies`: where the
    robot allows tip and markers to be, None where that is not known.
    """

    trial: int
    step: int
    protocol: str
    repeat: int
    branch: str
    rule: Rule
    t_start: float
    ramp_end: float
    rate: float
    targets: tuple[float, ...]
    spine_length: float
    tip_mass: float
    roll_deg: float = 0.0
    ambient: float = AMBIENT
    topics: tuple[str, ...] = ("/pressure", "/tip", "/spine", "/vacuum")
    specimen: str | None = None
    probe: Probe | None = None
    clipped: bool = False
    vacuum: VacuumBand | None = None
    least_force: float | None = None
    bodies: Bodies | None = None

    def __post_init__(self) -> None:
        if not PROTOCOL.fullmatch(self.protocol):
            raise BadMessage(f"protocol {self.protocol[:80]!r}: {PROTOCOL_IS}")
        _one_of("branch", self.branch, BRANCHES)
        for topic in self.topics:
            if not is_stream(topic):
                _one_of("topic", topic, tuple(STREAMS))
        if self.specimen is not None:
            _one_of("specimen", self.specimen, SPECIMENS)
        for what, demanded, needed in (
            ("rule settled needs", isinstance(self.rule, Settled), ("/pressure", "/tip")),
            ("rule crossing needs", isinstance(self.rule, Crossing), ("/pressure",)),
            ("a probe needs", self.probe is not None, ("/force", "/arm")),
            ("a vacuum to keep needs", self.vacuum is not None, ("/vacuum",)),
            ("bodies to judge need", self.bodies is not None, ("/tip",)),
        ):
            if demanded and not set(needed) <= set(self.topics):
                raise BadMessage(f"state {self.trial}/{self.step}: {what} {' and '.join(needed)} among the topics")
        if self.least_force is not None and self.probe is None:
            raise BadMessage(f"state {self.trial}/{self.step}: a least force needs a probe")

    @property
    def rule_name(self) -> str:
        """settled, window or crossing."""
        return next(name for name, kind in _RULES.items() if isinstance(self.rule, kind))

    def to_json(self) -> str:
        """Everything but `BESIDE_JSON`, exactly: floats are written so that they read back as the same number."""
        values = asdict(self) | {"rule": {"name": self.rule_name, **asdict(self.rule)}}
        return json.dumps({name: value for name, value in values.items() if name not in BESIDE_JSON})

    @classmethod
    def from_json(cls, text: str) -> State:
        """The state written by `to_json`; raises `BadMessage` when the text is another thing."""
        try:
            values: dict[str, Any] = {key: _tuples(value) for key, value in read_json(text).items()}
            rule = dict(values["rule"])
            values["rule"] = checked(_RULES[rule.pop("name")](**rule))
            if values["probe"] is not None:
                values["probe"] = checked(Probe(**values["probe"]))
            return checked(cls(**values))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BadMessage(f"not a state of this software: {error!r} in {text[:200]!r}") from error


def _one_of(what: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise BadMessage(f"{what} {value!r} is unknown; one of {', '.join(allowed)}")


_T = TypeVar("_T", bound=State | Settled | Window | Crossing | Probe | VacuumBand | Bodies)


def checked(value: _T) -> _T:
    """The value, when every field holds what it is annotated with, numbers finite; raises `BadMessage`."""
    for name, hint in _HINTS[type(value)].items():
        field_value = getattr(value, name)
        if not _is(field_value, hint):
            raise BadMessage(f"{name} = {repr(field_value)[:80]}: must be {hint}")
    if isinstance(value, Settled | Window | Crossing):
        for name, number in vars(value).items():
            if isinstance(number, int | float) and name != "level" and number < 0:
                raise BadMessage(f"{name} = {number}: must not be below 0")
        if value.min_samples < 1:
            raise BadMessage(f"min_samples = {value.min_samples}: must be at least 1")
    if isinstance(value, Settled) and not 1 <= value.smooth <= LONGEST_AVERAGE:
        raise BadMessage(f"smooth = {value.smooth}: must be 1 to {LONGEST_AVERAGE} samples")
    if isinstance(value, Crossing) and not (value.chambers and min(value.chambers) >= 0):
        raise BadMessage(f"chambers = {value.chambers}: must name at least one, the first is 0")
    return value


_HINTS: dict[object, dict[str, Any]] = {
    kind: get_type_hints(kind) for kind in (State, Settled, Window, Crossing, Probe, VacuumBand, Bodies)
}
"""What the fields are annotated with; finding out takes longer than reading a state."""


def _is(value: object, hint: Any) -> bool:
    """Whether a value read from JSON is what the annotation says; a whole number is a float too."""
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST_INTEGER
    parts = get_args(hint)
    if get_origin(hint) is tuple:
        if not isinstance(value, tuple):
            return False
        each = [parts[0]] * len(value) if parts[-1] is Ellipsis else list(parts)
        return len(value) == len(each) and all(_is(v, h) for v, h in zip(value, each, strict=True))
    if parts:
        return any(_is(value, h) for h in parts)
    return isinstance(value, hint)


def _tuples(value: object) -> object:
    """JSON's lists back to tuples, at any depth."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return value
