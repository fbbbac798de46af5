"""Recording a run: messages from any thread, one writer thread, an MCAP file that survives the process.

A message that `push` accepted is in the file at most `FLUSH_PERIOD` (host time) later, as a finished chunk. Header,
metadata, attachments and schemas are there before the constructor returns. The file has its final name from the
start; the metadata record `outcome` is written by `close` alone, so a file without it ended abruptly.

With each chunk the recorder checks that its file and the journal are still what their paths name. A recording that was
deleted, renamed, replaced or truncated goes on in a rescue file: a recording of its own that holds all that the open file
still has, with the journal next to it.

Metadata records: `recording` (schema_version, start_wall_ns, chambers, markers), `sha256` (of each attachment), those
given by the caller, and at the end `counts` and `clocks` (one JSON text a topic) and `outcome`; in a rescue file `rescue`
(instead_of, why).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .. import events
from ..errors import BadMessage, RecordingError, WriteFailed
from ..messages import SCHEMA_VERSION, MessageType, streams
from ..states.buffer import KEEP, Buffers
from ..states.rules import Crossing, State
from ..states.zeros import Drift, Zeros
from ..trials import TrialRow
from .clocks import STAMP, fit, has_stamp
from .counts import StreamCounts, Tally
from .journal import Journal
from .mcap_file import Disk, McapFile

FLUSH_PERIOD = 0.1
"""Host seconds between finished chunks."""

QUEUE_LIMIT = 200_000
"""Messages waiting for the disk; beyond it they are dropped and counted."""

LOOK = 0.02
"""Host seconds between two looks of the writer thread at what has come. A producer never wakes it: waking a thread costs
the producer tens of microseconds, and up to hundreds where both then want the same processor."""


LIBRARY = "softlab recordings"

_Item = tuple[str, int, bytes]
"""Topic, rig time (ns), payload. A plain tuple, because one is made for every message."""


class Recorder(AbstractContextManager["Recorder"]):
    """One recording in progress.

    `start_wall_ns`: wall time (ns since the epoch) of rig time 0; log time = it + rig time. `attachments`: name -> bytes.
    `metadata`: record name -> texts. `chambers`, `markers`: how many of them samples hold. `sensors`: the messages of sensors of
    the lab's own. `keep`: rig seconds of samples that stay in `buffers`. `start`: rig time (s) now, the first stamp of the file.
    `journal`: stays next to the recording. `rescue`: folders for a rescue file, the first choice first; the system's temporary
    folder comes last. Raises `WriteFailed` when the file exists or cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        start_wall_ns: int,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        chambers: int = 9,
        markers: int = 0,
        sensors: Sequence[MessageType] = (),
        keep: float = KEEP,
        start: float = 0.0,
        journal: Journal | None = None,
        rescue: Sequence[Path] = (),
    ) -> None:
        self.path = Path(path)
        """Where the recording is now."""
        self.displaced: tuple[str, ...] = ()
        """What happened to the files under the recorder's hands, and where the recording is instead."""
        self._journal, self._rescue = journal, (*rescue, Path(tempfile.gettempdir()))
        self._stem = self.path.stem
        self.start_wall_ns = start_wall_ns
        self.messages: dict[str, MessageType] = streams(chambers, markers, sensors)
        self.buffers = Buffers(self.messages, keep, self._waiting)
        self._topics = {topic: Tally() for topic in (*self.messages, *events.EVENTS)}
        self._queue: deque[_Item | threading.Event | None] = deque()
        """Appending, taking and copying are atomic; None: the end. Only the writer takes, holding `buffers.lock`. `_wake` is
        set for what cannot wait for the next look."""
        self._wake = threading.Event()
        self._failure: BaseException | None = None
        self._outcome: dict[str, str] | None = None
        self._states = 0
        self._views_due = dict.fromkeys(events.VIEWS, -math.inf)
        """Stream -> rig time (s) of its next message that viewers see."""
        self._event_lock = threading.Lock()
        self._disk = Disk(self.path)
        facts = {"start_wall_ns": str(start_wall_ns), "chambers": str(chambers), "markers": str(markers)}
        self._metadata = {
            "recording": {"schema_version": SCHEMA_VERSION, **facts},
            **{name: dict(texts) for name, texts in (metadata or {}).items()},
        }
        self._attachments = dict(attachments or {})
        if self._attachments:
            self._metadata["sha256"] = {name: hashlib.sha256(data).hexdigest() for name, data in self._attachments.items()}
        try:
            self._begin(self._nanoseconds("/log", start))
        except OSError as error:
            self._disk.give_up()
            raise WriteFailed(f"{self.path}: cannot be written: {error.strerror}") from error
        self._thread = threading.Thread(target=self._run, name="recording-writer", daemon=True)
        self._thread.start()

    def _new_file(self, disk: Disk, metadata: Mapping[str, dict[str, str]]) -> McapFile:
        """A file with what stands before the messages."""
        mcap = McapFile(disk, LIBRARY)
        now = time.time_ns()
        for name, texts in metadata.items():
            mcap.metadata(name, {key: events.writable(text) for key, text in texts.items()})
        for name, data in self._attachments.items():
            mcap.attachment(name, "application/octet-stream", data, now, now)
        return mcap

    def _begin(self, ns: int) -> None:
        """Everything that must be on disk before the first sample; `ns`: rig time now."""
        self._mcap = mcap = self._new_file(self._disk, self._metadata)
        messages: list[MessageType | events.EventType] = [*self.messages.values(), *events.EVENTS.values()]
        for message in messages:
            tally, schema = self._topics[message.topic], mcap.schema(message.full_name, "protobuf", message.schema)
            tally.channel = mcap.channel(message.topic, "protobuf", schema, message.metadata)
            if isinstance(message, MessageType) and has_stamp(message.topic):
                fields: Any = message.wire_dtype.fields
                tally.stamp_at = fields[STAMP][1]
        # Schemas and channels reach the file with the first message's chunk.
        first_line = events.encode_log(self.start_wall_ns + ns, "info", "recording starts", "recorder")
        self._queue.append(("/log", ns, first_line))
        self._drain()
        self._flush()
        self._disk.sync()
        self._disk.sync_name()

    # -- from any thread
    def push(self, topic: str, t: float, values: tuple[object, ...] | None = None, /, **fields: object) -> None:
        """Record one message of a stream: `values` in the order of its fields after `t`, or each by name.

        `t`: rig time, s, not before the topic's previous one (a message that is, is dropped and counted). Raises
        `BadMessage` when it does not fit its definition, `WriteFailed` when the file can no longer be written.
        """
        try:
            message = self.messages[topic]
        except KeyError:
            raise BadMessage(f"no stream {topic}; there are {', '.join(self.messages)}") from None
        try:
            if values is None:
                values = self._in_order(message, fields)
            ns = self._nanoseconds(topic, t)
            payload = message.encode(ns / 1e9, values)
        except BadMessage:
            self._topics[topic].refuse()
            raise
        # All else is the writer's work: in a thread that has just woken, every line costs a microsecond (cold caches).
        if self._failure is None and self._outcome is None and len(self._queue) < QUEUE_LIMIT:
            self._queue.append((topic, ns, payload))
        else:
            self._topics[topic].refuse()
            self.check()

    def _in_order(self, message: MessageType, fields: Mapping[str, object]) -> tuple[object, ...]:
        if fields.keys() != set(message.value_names):
            missing = ", ".join(set(message.value_names) - fields.keys()) or "nothing"
            unknown = ", ".join(fields.keys() - set(message.value_names)) or "nothing"
            raise BadMessage(f"{message.topic}: missing {missing}, unknown {unknown}")
        return tuple(fields[name] for name in message.value_names)

    def _nanoseconds(self, topic: str, t: float) -> int:
        try:
            if 0 <= t < 1e9:  # neither NaN nor infinite
                return round(t * 1e9)
        except TypeError:
            pass
        raise BadMessage(f"{topic}: t = {t!r} is not a rig time in seconds")

    def sink(self, topic: str) -> Callable[[Any], None]:
        """A function that records samples: objects with `t` and attributes named like the stream's fields.

        It never raises, because it runs in the driver's thread: a sample that cannot be recorded is dropped and
        counted, the first one of a topic is reported on /log. Body markers that were not seen are filled up with NaN.
        """
        message = self.messages[topic]
        marker_counts = {f.name: f.shape[0] for f in message.fields if len(f.shape) == 2}
        nan = (math.nan,) * 3

        def take(sample: Any) -> None:
            values = [getattr(sample, name) for name in message.value_names]
            for index, name in enumerate(message.value_names):
                if name in marker_counts:
                    values[index] = (*values[index], *(nan,) * (marker_counts[name] - len(values[index])))
            try:
                self.push(topic, sample.t, tuple(values))
            except WriteFailed:
                return
            except BadMessage as error:
                if not self._topics[topic].complained:
                    self._topics[topic].complained = True
                    self.log("error", str(error))

        return take

    def note_lost(self, topic: str, count: int) -> None:
        """A driver knows that this many samples of its stream never arrived; raises `BadMessage` for fewer than none."""
        if count < 0:
            raise BadMessage(f"{topic}: {count} lost samples, must not be below 0; give the number since the recording began")
        tally = self._topics[topic]
        with tally.lock:
            tally.lost += count

    def log(self, level: str, text: str, t: float | None = None) -> None:
        """A line on /log; `level` one of debug, info, warning, error, fatal; `t` (s) defaults to the newest stamp.

        The text is kept as it is, up to `events.LONGEST_TEXT` characters.
        """
        self.check()
        if level not in events.LEVELS:
            raise BadMessage(f"log level {level!r} is unknown; one of {', '.join(events.LEVELS)}")
        ns = self._newest() if t is None else self._nanoseconds("/log", t)
        self._queue.append(("/log", ns, events.encode_log(self.start_wall_ns + ns, level, events.bounded(text), "lab")))

    def state(self, t: float, state: State, repeats: int = 0) -> int:
        """Record what is asked for, before it is read; returns the state's number in this recording. `repeats`: the number
        of the state that is read again.

        Raises `BadMessage` when the state does not fit the number of chambers.
        """
        chambers = self.messages["/pressure"].dtype["measured"].shape[0]
        if len(state.targets) != chambers:
            raise BadMessage(f"/state: {len(state.targets)} target pressures for {chambers} chambers")
        if isinstance(state.rule, Crossing) and not all(0 <= chamber < chambers for chamber in state.rule.chambers):
            raise BadMessage(f"/state: crossing of chambers {state.rule.chambers}, there are 0 .. {chambers - 1}")
        with self._event_lock:
            self._states += 1
            number = self._states
        demands = (("vacuum", state.vacuum), ("bodies", state.bodies))
        limits = {f"{of}_{name}": x for of, demand in demands if demand is not None for name, x in asdict(demand).items()}
        fields = {"t": t, "number": number, "rule": state.rule_name, "json": state.to_json(), "repeats": repeats}
        self._event(events.STATE, t, state, **fields, **limits)
        return number

    def trial(self, t: float, number: int, row: TrialRow, repeats: int = 0) -> None:
        """Record the row that was concluded for state `number`."""
        self._event(events.TRIAL, t, row, t=t, number=number, json=row.to_json(), repeats=repeats)

    def zero(self, t: float, zeros: Zeros, drift: Drift) -> None:
        """Record how the force sensor's zero moved during a trial."""
        self._event(events.ZERO, t, zeros, t=t, drift=drift.force, rate=drift.rate, linear=drift.linear)

    def mark(self, mark: events.Mark) -> None:
        """Record why the states that a trial has up to now are in doubt."""
        self._event(events.MARK, mark.t, mark, text=events.bounded(mark.text))

    def request(self, request: events.Request) -> None:
        """Record what somebody asked of the run, or that it was carried out; from any thread."""
        texts = {name: events.bounded(getattr(request, name)) for name in ("kind", "by", "text")}
        self._event(events.REQUEST, request.t, request, **texts)

    def progress(self, t: float, steps: int, steps_planned: int, seconds: float, seconds_planned: float) -> None:
        """Record how much of the plan is done: steps, and s of rig time."""
        planned = {"steps_planned": steps_planned, "seconds_planned": seconds_planned}
        self._event(events.PROGRESS, t, t=t, steps=steps, seconds=seconds, **planned)

    def _newest(self) -> int:
        with self.buffers.lock:
            return max(*(ns for _, ns, _ in self._not_taken()), *(tally.last for tally in self._topics.values()))

    def _event(self, event: events.EventType, at: float, source: object = None, **fields: object) -> None:
        """Record an event of rig time `at` (s), see `events.encoded`. They are few, and neither dropped for their order nor for
        a full queue."""
        self.check()
        self._queue.append((event.topic, self._nanoseconds(event.topic, at), events.encoded(event, source, **fields)))

    def _waiting(self, topic: str) -> list[tuple[float, bytes]]:
        """What the writer has not taken yet of a stream, in order: stamps (s) and payloads; `buffers.lock` is held."""
        last, samples = self._topics[topic].last, []
        for name, ns, payload in self._not_taken():
            if name == topic and ns >= last:  # one that goes back in time will be dropped, see `_put`
                last = ns
                samples.append((ns / 1e9, payload))
        return samples

    def _not_taken(self) -> list[_Item]:
        """Messages that the writer has not taken yet, in order; `buffers.lock` is held."""
        return [item for item in self._queue.copy() if isinstance(item, tuple)]

    def sync(self) -> None:
        """Return when everything pushed so far is on the disk; raises `WriteFailed` when it does not get there."""
        self.check()
        done = threading.Event()
        self._queue.append(done)
        self._wake.set()
        while not done.wait(0.1):
            self.check()

    def check(self) -> None:
        """Raises `WriteFailed` when the file can no longer be written."""
        if self._failure is not None:
            raise WriteFailed(
                f"{self.path}: recording stopped: {self._failure}; what was written before stays readable with "
                "`lab recover`. Make room or choose another disk and resume the run"
            ) from self._failure
        if self._outcome is not None:
            raise WriteFailed(f"{self.path}: recording is closed ({self._outcome['outcome']})")

    # -- the writer thread
    def _run(self) -> None:
        """Write what comes until the end; a failure is kept for `check`."""
        try:
            due = time.monotonic() + FLUSH_PERIOD
            while self._drain():
                now = time.monotonic()
                if now >= due or self._mcap.full:
                    self._flush()
                    due = now + FLUSH_PERIOD
                if not self._queue:
                    self._wake.wait(min(LOOK, max(0.0, due - now)))
                    self._wake.clear()
            self._end()
        except Exception as error:
            self._failure = error
            self._disk.give_up()

    def _drain(self) -> bool:
        """Put what has come into memory and into the chunk in hand, a burst of it or until that is full; False at the end."""
        with self.buffers.lock:  # nothing in here waits for the disk
            for _ in range(min(len(self._queue), 1000)):
                item = self._queue.popleft()
                if not isinstance(item, tuple):
                    break
                self._put(*item)
                if self._mcap.full:
                    return True
            else:
                return True
        if item is None:
            return False
        self._flush()
        self._disk.sync()
        item.set()  # an event, for which `sync` waits
        return True

    def _put(self, topic: str, ns: int, payload: bytes) -> None:
        """Count a message and put it where it belongs, unless it is a sample from before its stream's previous one."""
        tally = self._topics[topic]
        tally.taken += 1
        if topic not in self.messages:  # an event: it may be recorded later than it happened
            tally.last = max(tally.last, ns)
        elif ns < tally.last:
            return
        else:
            tally.last = ns
            self.buffers[topic].append(ns / 1e9, payload)
        tally.note(ns, payload)
        self._mcap.message(tally.channel, tally.generated & 0xFFFFFFFF, self.start_wall_ns + ns, payload)
        if topic in events.VIEWS and ns / 1e9 >= self._views_due[topic]:
            self._views_due[topic] = ns / 1e9 + events.VIEW_PERIOD
            fields = self.messages[topic].decode(payload)[0]
            for place, encode in events.VIEWS[topic]:
                if (view := encode(self.start_wall_ns + ns, fields)) is not None:
                    self._put(place, ns, view)

    def _flush(self) -> None:
        self._check_files()
        self._mcap.flush()
        self._disk.commit()
        for topic in self._topics.values():
            topic.written += topic.pending
            topic.pending = 0

    # -- a file that is lost
    def _check_files(self) -> bool:
        """Check that both files are what their paths name, and replace one that is not; whether the recording is in another
        file since. Raises `WriteFailed` when it can be in none."""
        if why := self._disk.displaced():
            self._move(f"{self.path} {why} while it was being written")
            return True
        if self._journal is not None and (why := self._journal.displaced()):
            text = f"{self._journal.path} {why} while it was being written"
            if not self._journal.renew():
                self._move(text)
                return True
            self._note(f"{text}; it was written anew in its place")
        return False

    def _move(self, why: str) -> None:
        """Go on in a rescue file, with all that the open file still holds."""
        old_path, failures = self.path, []
        for path in self._rescue_paths():
            try:
                lost = self._continue_in(path, why)
            except (OSError, WriteFailed) as error:
                failures.append(str(error))
                continue
            tallies = {tally.channel: tally for tally in self._topics.values()}
            for channel, count in lost.items():
                tallies[channel].written -= count
            loss = f"{sum(lost.values())} of its messages are lost" if lost else "nothing of it is lost"
            self._note(f"{why}: {loss}, and the recording goes on in {path} instead of {old_path}")
            return
        raise WriteFailed(f"{why}, and no rescue file can be written: {'; '.join(failures)}")

    def _rescue_paths(self) -> Iterator[Path]:
        """Where a rescue file may be, the best first; nothing there is overwritten."""
        for folder in self._rescue:
            path = folder / f"{self._stem}-rescue.mcap"
            journal = [path.with_suffix(self._journal.path.suffix)] if self._journal is not None else []
            if any(map(os.path.lexists, (path, *journal))):
                path = path.with_stem(f"{path.stem}-{secrets.token_hex(4)}")
            yield path

    def _continue_in(self, path: Path, why: str) -> dict[int, int]:
        """Make a rescue file, copy what can be copied, and write on there; returns how many messages are lost, by channel."""
        metadata = {**self._metadata, "rescue": {"instead_of": str(self.path), "why": events.bounded(why)}}
        if self._journal is not None and "campaign" in metadata:
            metadata["campaign"] = {**metadata["campaign"], "journal": path.with_suffix(self._journal.path.suffix).name}
        disk = Disk(path)
        try:
            mcap = self._new_file(disk, metadata)
            lost = mcap.carry_on(self._mcap, self._disk.read)
            disk.commit()
            disk.sync()
            disk.sync_name()
            if self._journal is not None and not self._journal.follow(self.path, path):
                raise WriteFailed(f"the journal of {path} cannot be written")
        except BaseException:
            disk.give_up()
            path.unlink(missing_ok=True)
            raise
        self._disk.give_up(cut=False)
        self._disk, self._mcap, self._metadata, self.path = disk, mcap, metadata, path
        return lost

    def _note(self, text: str) -> None:
        """Log what happened, and have the run noticed."""
        self.displaced = (*self.displaced, text)
        with self.buffers.lock:
            ns = max(topic.last for topic in self._topics.values())
            payload = events.encode_log(self.start_wall_ns + ns, "error", events.bounded(text), "recorder")
            self._put("/log", ns, payload)

    def _end(self) -> None:
        self._finish()
        while self._check_files():  # lost in the moment of finishing
            self._finish()
        self._disk.close()

    def _finish(self) -> None:
        """The end of the file. In a rescue file it is written once more."""
        self._flush()
        counts = {topic: json.dumps(asdict(count)) for topic, count in self.counts().items()}
        self._mcap.metadata("counts", counts)
        self._mcap.metadata("clocks", self._clocks())
        self._mcap.metadata("outcome", self._outcome or {})
        self._mcap.finish()
        self._disk.commit()

    def _clocks(self) -> dict[str, str]:
        """The model of each instrument's clock, as JSON text by topic."""
        models = {
            name: fit(np.array(topic.device_stamps), np.array(topic.stamps, np.int64) / 1e9)
            for name, topic in self._topics.items()
            if topic.stamp_at is not None
        }
        return {name: json.dumps(asdict(model)) for name, model in models.items() if model is not None}

    def counts(self) -> dict[str, StreamCounts]:
        """Fate of each topic's messages up to here."""
        with self.buffers.lock:
            waiting = Counter(topic for topic, _, _ in self._not_taken())
            generated = {name: topic.generated + waiting[name] for name, topic in self._topics.items()}
        return {name: topic.counts(generated[name]) for name, topic in self._topics.items()}

    def close(self, outcome: str, detail: str = "", safe: bool | None = None) -> dict[str, StreamCounts]:
        """Write counts and outcome, finish the file, return the counts. A second call returns them again.

        `outcome`: completed, stopped or failed; `safe`: whether the rig's safe state was confirmed, where that is known. Raises
        `WriteFailed` when the file could not be finished.
        """
        if self._outcome is None:
            self._outcome = {
                "outcome": outcome,
                "detail": events.bounded(detail),
                "closed_wall_ns": str(time.time_ns()),
                **({} if safe is None else {"safe_state": events.CONFIRMED if safe else events.UNCONFIRMED}),
            }
            self._queue.append(None)
            self._wake.set()
        self._thread.join()
        if self._failure is not None:
            self.check()
        return self.counts()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.close("completed")
            return
        try:
            outcome = "stopped" if isinstance(error, KeyboardInterrupt) else "failed"
            self.close(outcome, f"{type(error).__name__}: {error}")
        except RecordingError as second:
            error.add_note(str(second))
