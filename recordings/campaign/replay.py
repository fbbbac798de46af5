"""The table of a recording: as it was concluded live, and as it follows from the samples in the file."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import events
from ..errors import Damaged, NotSettled, RecordingError
from ..events import StateEvent, TrialEvent, marked
from ..file.budget import Cost, ReadingBudget
from ..file.reader import Recording, Stretch
from ..states.buffer import KEEP
from ..states.concluding import SLOW_OLDEST, conclude, of_sensor, sensor_column
from ..states.rules import longest
from ..states.zeros import Drift, Zeros, drift, unloaded, without_drift
from ..trials import Table, TrialRow


@dataclass(frozen=True)
class Replayed:
    """A state read again: its row, or why there is none."""

    number: int
    row: TrialRow | None
    reason: str
    repeats: int = 0
    """Number of the state that this one repeats; 0: of none."""


@dataclass(frozen=True)
class ReplayComparison:
    """Live rows against replayed ones. `equal`: every live row came out the same to the last bit."""

    live: int
    replayed: int
    differences: tuple[str, ...]
    """Live rows that replay gives otherwise or not at all."""

    @property
    def equal(self) -> bool:
        """No differences."""
        return not self.differences


def table_of(recording: Recording) -> Table:
    """The rows as they were concluded live; raises `Foreign` for a file without states and rows.

    >>> len(table_of(Recording.open("run.mcap")))
    1
    """
    recording.need(events.STATE.topic, events.TRIAL.topic)
    drifts = [(event.zeros, event.drift) for event in recording.zeros]
    return _table(recording, [(event, event.row) for event in recording.trials], drifts)


def _table(
    recording: Recording, readings: Sequence[tuple[TrialEvent | Replayed, TrialRow]], drifts: Sequence[tuple[Zeros, Drift]]
) -> Table:
    """The table of readings, without drift and with doubts: of a state read again the last counts, of a skipped trial none."""
    again = {event.repeats for event, _ in readings if event.repeats}
    rows = [(event.number, row) for event, row in readings if row.trial not in recording.skipped]
    doubts = [
        f"trial {trial}: was skipped by a person; the {n} states read in it are left out"
        for trial in sorted(recording.skipped)
        if (n := sum(row.trial == trial for _, row in readings))
    ]
    doubts += [
        f"trial {row.trial} step {row.step}: was read again; the last reading counts" for number, row in rows if number in again
    ]
    kept = marked((row for number, row in rows if number not in again), recording.marks)
    return Table.of(without_drift(kept, drifts), tuple(doubts), units_of(recording))


def units_of(recording: Recording) -> dict[str, str]:
    """Unit of each column that a sensor of the lab's own fills."""
    topics = [topic for topic in recording.streams if of_sensor(topic)]
    units = ((topic, name, unit) for topic in topics for name, unit in recording.units(topic).items())
    return {sensor_column(topic, name): unit for topic, name, unit in units if name != "t"}


class _Counted:
    """The streams of a recording; what states look at is taken from a budget: many states may each look at all of it."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self.newest = recording, recording.newest
        self.budget = ReadingBudget(str(recording.path), recording.contents.size)

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        samples = self.recording.window(topic, t0, t1)
        self.budget.take(Cost.LOOKED_AT, len(samples))
        return samples

    def average(self, count: int) -> None:
        """Take the cost of averaging `count` samples from the budget."""
        self.budget.take(Cost.LOOKED_AT, 20 * count)  # averaging a sample costs twenty times what looking at it costs


class _Passing:
    """The streams of a recording that goes by: what came from `KEEP` seconds before the oldest state on that is still to be read,
    which is what its run had. Of a state that looks back farther, or at a stream with a fault, the whole recording is asked."""

    def __init__(self, recording: Recording) -> None:
        self.whole, self.faults = _Counted(recording), dict[str, RecordingError]()
        self.in_order = True
        self._held: dict[str, list[NDArray[np.void]]] = {}
        self._forgotten: dict[str, float] = {}
        """Stamp (s) of the newest sample of a stream that is no longer held."""

    def take(self, stretch: Stretch, oldest: float) -> None:
        """Add what follows, and forget what no state from `oldest` (rig time, s) on looks at."""
        for topic, samples in ((topic, samples) for topic, samples in stretch.samples.items() if len(samples)):
            held = self._held.setdefault(topic, [])
            self.in_order &= bool((np.diff(samples["t"]) >= 0).all() and (not held or held[-1]["t"][-1] <= samples["t"][0]))
            held.append(samples)
            while held[0]["t"][-1] < min(oldest, samples["t"][-1]) - KEEP:
                self._forgotten[topic] = float(held.pop(0)["t"][-1])

    def newest(self, topic: str) -> float:
        """Stamp (s) of the newest sample that has come; -inf while there is none."""
        if topic in self.faults or topic not in self.whole.recording.streams:
            return self.whole.newest(topic)
        return float(self._held[topic][-1]["t"][-1]) if topic in self._held else -math.inf

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The samples with t0 <= t <= t1, oldest first."""
        if topic in self.faults or topic not in self._held or t0 <= self._forgotten.get(topic, -math.inf):
            return self.whole.window(topic, t0, t1)
        held = self._held[topic]
        samples = np.concatenate([held[0][:0], *(part for part in held if part["t"][-1] >= t0 and part["t"][0] <= t1)])
        samples = samples[np.searchsorted(samples["t"], t0) : np.searchsorted(samples["t"], t1, side="right")]
        self.whole.budget.take(Cost.LOOKED_AT, len(samples))
        return samples


def _read_again(streams: _Passing | _Counted, average: Callable[[int], None], event: StateEvent) -> Replayed:
    """A state, concluded from samples."""
    try:
        row = conclude(streams, event.state, average)
        reason = "" if row else "the recording ends before the reading does"
    except NotSettled as error:
        row, reason = None, str(error)
    return Replayed(event.number, row, reason, event.repeats)


def replay_states(recording: Recording) -> list[Replayed]:
    """Read every recorded state again from the file's samples, in one pass over the file."""
    recording.need(events.STATE.topic, events.TRIAL.topic)
    recording.demand_version(events.STATE.topic)
    streams, waiting, read = _Passing(recording), list[StateEvent](), dict[StateEvent, Replayed]()
    for stretch in recording.sweep(streams.faults):
        waiting += recording.read_events(events.STATE, stretch.events.get(events.STATE.topic, []))
        streams.take(stretch, min((event.state.t_start for event in waiting), default=math.inf))
        for event in waiting if streams.in_order else ():
            # what is read does not depend on when one asks: once the rule has run out, nothing later counts
            over = event.state.t_start + longest(event.state.rule) + SLOW_OLDEST
            if min(streams.newest(topic) for topic in event.state.topics) > over:
                read[event] = _read_again(streams, streams.whole.average, event)
        waiting = [event for event in waiting if event not in read]
    if not streams.in_order:  # by their stamps, samples stand in another order than by their log times
        recording.load()
        return [_read_again(streams.whole, streams.whole.average, event) for event in recording.states]
    return [read.get(event) or _read_again(streams, streams.whole.average, event) for event in recording.states]


def replay(path: str | os.PathLike[str], *, truncated: bool = False) -> Table:
    """The table that follows from the samples of a recording alone; raises `RecordingError`.

    >>> replay("run.mcap")["p1"].shape
    (1,)
    """
    recording = Recording.open(path, truncated=truncated)
    rows = [(state, state.row) for state in replay_states(recording) if state.row is not None]
    drifts = [(zeros, zero_drift) for zeros, zero_drift in replay_zeros(recording) if zero_drift is not None]
    return _table(recording, rows, drifts)


def replay_zeros(recording: Recording) -> list[tuple[Zeros, Drift | None]]:
    """How the force sensor's zero moved during each trial, from the file's samples; None where they do not tell."""
    out: list[tuple[Zeros, Drift | None]] = []
    streams = _Counted(recording)
    for zeros in (event.zeros for event in recording.zeros):
        zero_drift = None
        with contextlib.suppress(NotSettled):
            before, start, end = (unloaded(streams, zeros.direction, span) for span in (zeros.before, zeros.start, zeros.end))
            zero_drift = drift(before, start, end) if before and start and end else None
        out.append((zeros, zero_drift))
    return out


def compare(recording: Recording, states: list[Replayed] | None = None) -> ReplayComparison:
    """Compare a recording's replayed rows with the live ones, bit by bit.

    `states`: the result of `replay_states` for this recording, if it is known already.

    >>> compare(Recording.open("run.mcap")).equal
    True
    """
    replayed_states = {replayed.number: replayed for replayed in (replay_states(recording) if states is None else states)}
    live = recording.trials
    differences = []
    for event in live:
        name = f"trial {event.row.trial} step {event.row.step}"
        replayed = replayed_states.get(event.number)
        if replayed is None:
            raise RecordingError(f"{recording.path}: {name} has no recorded state {event.number}")
        if replayed.row is None:
            differences.append(f"{name}: no row in replay: {replayed.reason}")
        elif replayed.row.to_json() != event.row.to_json() or replayed.row.clipped != event.row.clipped:
            differences.append(f"{name}: {_first_difference(event.row, replayed.row)}")
    for zero, (_, zero_drift) in zip(recording.zeros, replay_zeros(recording), strict=True):
        if zero_drift != zero.drift:
            differences.append(f"trial {zero.zeros.trial}: drift of the zero was {zero.drift} live, is {zero_drift} in replay")
    return ReplayComparison(len(live), sum(replayed.row is not None for replayed in replayed_states.values()), tuple(differences))


def _first_difference(live: TrialRow, replayed: TrialRow) -> str:
    a, b = live.cells(), replayed.cells()
    names = (name for name in (*a, *b) if repr(a.get(name)) != repr(b.get(name)))
    texts = (f"{name} was {a.get(name)!r} live and is {b.get(name)!r} in replay" for name in names)
    return next(texts, "order of the columns")


# -- recordings that belong together: a run that was broken off and those that resumed it make one table of trials
def metadata(campaign: str, journal: str, first_trial: int) -> dict[str, dict[str, str]]:
    """The metadata record of a recording that belongs to a campaign."""
    return {"campaign": {"id": campaign, "journal": journal, "first_trial": str(first_trial)}}


def campaign_of(recording: Recording) -> str | None:
    """The campaign that a recording belongs to; None for one that stands alone."""
    return recording.metadata.get("campaign", {}).get("id")


def first_trial(recording: Recording) -> int:
    """The number of the first trial that was done in a recording."""
    text = recording.metadata.get("campaign", {}).get("first_trial", "1")
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise Damaged(f"{recording.path}: its metadata 'campaign' has first_trial {text[:40]!r}, which is not a number")
    return int(text)


def campaigns(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Recordings of one campaign together, one that stands alone by itself, in the order of their first recording."""
    groups: dict[str, list[Recording]] = {}
    for number, recording in enumerate(recordings):
        groups.setdefault(campaign_of(recording) or f"alone {number}", []).append(recording)
    return list(groups.values())


def merged(recordings: Sequence[Recording]) -> Table:
    """The table of one campaign: a trial that was begun again counts as it was done last.

    `t` goes on from recording to recording: later ones count from the start of the first (wall time, but never
    backwards).
    """
    parts = sorted(recordings, key=lambda recording: (first_trial(recording), _span(recording)[0]))
    tables: list[Table] = []
    doubts: list[str] = []
    shift = 0.0
    for number, recording in enumerate(parts):
        if number:
            previous = parts[number - 1]
            ended = (_span(previous)[1] - previous.start_wall_ns) / 1e9
            shift = max((recording.start_wall_ns - parts[0].start_wall_ns) / 1e9, shift + ended)
            tables = [table.take(table.trial < first_trial(recording)) for table in tables]
        table = table_of(recording)
        tables.append(table.replaced({"t": table.get("t") + shift}) if shift and len(table) else table)
        doubts += table.warnings
    units = {column: unit for recording in parts for column, unit in units_of(recording).items()}
    return replace(Table.stacked(tables), warnings=tuple(doubts), sensor_units=units)


def _span(recording: Recording) -> tuple[int, int]:
    """Wall time (ns) of a recording's first and last message: rig time 0 may lie long before them."""
    return recording.contents.span or (recording.start_wall_ns, recording.start_wall_ns)
