"""What every experiment shares: its plan, and the bookkeeping of trials, states and progress."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeVar

from drivers.errors import DeviceFault
from drivers.interfaces import Vector6
from recordings.ambient import AMBIENT
from recordings.errors import Misplaced, NoResistance, NotSettled, TooFewSamples, VacuumLost
from recordings.events import Mark, marked
from recordings.file.journal import Journal
from recordings.messages import SENSORS as OWN
from recordings.states.concluding import SLOW_OLDEST, conclude, of_sensor
from recordings.states.demands import elsewhere
from recordings.states.rules import Crossing, Probe, Settled, State, Window
from recordings.states.zeros import TOLERATED, Drift, Zeros, without_drift
from recordings.trials import TrialRow

from .bench import Bench, Setup
from .errors import NotPushing, NotReached, Skipped, Suspended
from .parameters import Settle

T = TypeVar("T")
SENSORS = {
    "/pressure": "pressure", "/tip": "mocap", "/spine": "spine", "/vacuum": "gauge", "/force": "force", "/arm": "arm_state",
}  # fmt: skip
"""Which instrument of rig.yaml a topic comes from."""
READINGS = 3
"""Times that a reading is tried which a pause of a stream spoils."""


@dataclass(frozen=True)
class Push:
    """A specimen of the stiffness stand pushed at its end; SI units."""

    specimen: Literal["spine", "body"]
    spine: float
    """Length of the spine, also inside the body."""
    length: float
    """From the clamp to where it is pushed."""
    deflection: float
    max_force: float
    """At which the trial ends early."""


@dataclass(frozen=True)
class Ask:
    """What a step asks of the rig; None or empty where it asks nothing."""

    pressures: tuple[float, ...] = ()
    """By chamber, gauge."""
    pressure_rate: float | None = None
    spine_length: float | None = None
    spine_speed: float | None = None
    vacuum: float | None = None
    """Below ambient."""
    probe: tuple[tuple[float, float | None], ...] = ()
    """Where the probe goes in the stand's frame: along the specimen, and depth (None: the standoff)."""
    poses: tuple[Vector6, ...] = ()
    """Poses of the TCP (m, rotation vector rad, arm base frame) between which the arm goes straight."""
    arm_speed: float | None = None
    arm_acceleration: float | None = None
    push: Push | None = None
    setup: Setup | None = None
    """What a person prepares before."""


@dataclass(frozen=True)
class Reading:
    """A state that a step reads; columns of the table of trials."""

    branch: Literal["load", "unload"]
    hold: float
    """s from the ramp's end to the reading; 0: while ramping."""
    rate: float
    """Pa/s of the ramp before, negative downwards."""
    repeat: int = 1


@dataclass(frozen=True)
class Step:
    """One step, its rig time (s), and what it asks of the rig.

    A step that asks for a spine length begins a trial.
    """

    label: str
    seconds: float
    ask: Ask = Ask()
    reads: tuple[Reading, ...] = ()
    """The states that it reads; by default one for each step that ramps pressures."""


@dataclass(frozen=True)
class Plan:
    """All steps of a run, and the largest values that it asks of the rig."""

    protocol: str
    steps: Sequence[Step]
    limits: dict[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Expected duration, s of rig time."""
        return sum(s.seconds for s in self.steps)

    @property
    def states(self) -> int:
        """Number of states that it will read, as far as its steps state it (see `Step.reads`)."""
        if any(s.reads for s in self.steps):
            return sum(len(s.reads) for s in self.steps)
        return sum(bool(s.ask.pressures and s.ask.pressure_rate) for s in self.steps)


@dataclass(frozen=True)
class Trial:
    """What is the same for all states of one trial. SI units; ambient is Pa absolute."""

    number: int
    repeat: int
    spine: float
    ambient: float
    tip_mass: float
    roll_deg: float
    specimen: str | None = None
    probe: Probe | None = None


Concluded = tuple[int, TrialRow]
"""The number of a state in the recording, and the row that was concluded."""


class Trials:
    """Numbers trials and states, has each state read, reports progress, and keeps the journal.

    `finished`: trials done by the run that this one resumes.
    """

    def __init__(self, bench: Bench, plan: Plan, journal: Journal | None = None, finished: int = 0) -> None:
        self.bench, self.plan, self.journal = bench, plan, journal
        self.rows: list[TrialRow] = []
        self._trial = finished
        self._step = self._done = self._per_trial = 0
        self._latest: dict[int, Concluded] = {}
        """By step, the latest reading of each state of this trial: what is read once more takes its place."""
        self._rest: dict[tuple[object, ...], TrialRow] = {}
        """The first state at rest of each way in which the robot hangs."""
        self._void: set[int] = set()
        """Steps whose latest reading was before the trial was begun again."""

    def remaining(self, trials: Iterable[T], steps: int) -> list[T]:
        """Return the unfinished of all trials, in order; each has `steps` planned steps."""
        self._per_trial, self._done = steps, self._trial * steps
        self._tell_progress()
        return list(trials)[self._trial :]

    def begin(
        self,
        *,
        repeat: int = 1,
        spine: float = 0.0,
        tip_mass: float = 0.0,
        roll_deg: float = 0.0,
        ambient: float = AMBIENT,
        specimen: str | None = None,
    ) -> Trial:
        """Start the next trial; `ambient`: what `set_spine` returns."""
        self._trial += 1
        self._step, self._latest, self._void = 0, {}, set()
        self.bench.look_anew()
        self.bench.steering.at(self._trial, 0)
        return Trial(self._trial, repeat, spine, ambient, tip_mass, roll_deg, specimen)

    def begin_again(self, trial: Trial) -> None:
        """Read all states of a trial again; the last reading counts."""
        self._step, self._void = 0, set(self._latest)
        self._done = (trial.number - 1) * self._per_trial + 1
        self._tell_progress()

    @contextlib.contextmanager
    def doing(self, trial: Trial) -> Iterator[None]:
        """Finish the trial with the block, which ends early when a person skips it."""
        try:
            with self.bench.steering.skippable():
                yield
                self.bench.steering.check_skip()  # asked since the last look: of this trial, not of the next
        except Skipped:
            self._skip(trial)
        else:
            self.end(trial)
        if self._per_trial:
            self._done = trial.number * self._per_trial
            self._tell_progress()

    def _skip(self, trial: Trial) -> None:
        """The trial is left out: its rows stay in the recording, and no table takes them."""
        self.bench.steering.take("skip")
        self.rows = [row for row in self.rows if row.trial != trial.number]
        self.bench.say(f"Trial {trial.number} is left out; {self._step} states were asked for in it")
        if self.journal is not None:
            self.bench.recorder.sync()
            self.journal.skipped(trial.number, self._step)

    def read(
        self,
        trial: Trial,
        rule: Settled | Window | Crossing,
        *,
        branch: str,
        t_start: float,
        ramp_end: float,
        rate: float,
        targets: Sequence[float],
        topics: tuple[str, ...],
        wait: float,
        repeatable: bool = False,
        least_force: float | None = None,
    ) -> TrialRow:
        """Read a state: record what is asked for and wait up to `wait` s for the samples that conclude it.

        Raises NotReached; Suspended when a jammed spine has lost its vacuum or a body is where the robot cannot be; NotPushing
        when a specimen pushes back with less than `least_force` N. `repeatable`: nothing moves or creeps.
        """
        self._step += 1
        self.bench.steering.at(trial.number, self._step)
        topics = (*filter(self.bench.has_topic, topics), *self.bench.sensors)
        jammed = self.bench.jammed if "/vacuum" in topics else None
        targets = (*targets, *(0.0,) * (self.bench.chambers.count - len(targets)))
        state = State(
            trial=trial.number, step=self._step, protocol=self.plan.protocol, repeat=trial.repeat, branch=branch, rule=rule,
            t_start=t_start, ramp_end=ramp_end, rate=rate, targets=tuple(targets), spine_length=trial.spine,
            tip_mass=trial.tip_mass, roll_deg=trial.roll_deg, ambient=trial.ambient, topics=topics,
            specimen=trial.specimen, probe=trial.probe, clipped=self.bench.clipped,
            vacuum=None if jammed is None else jammed.vacuum, least_force=least_force,
            bodies=self.bench.bodies if "/tip" in topics else None,
        )  # fmt: skip
        reading = None if self._step in self._void else self._latest.get(self._step)  # counts if no newer one succeeds
        try:
            reading = self._read(state, wait, repeatable)
            while self._wanted_again(rule):
                reading = self._read(replace(state, t_start=self.bench.clock.now()), wait, repeatable)
        except (Suspended, NotPushing):
            self._step -= 1  # it will be read again
            raise
        except NotReached as e:
            if reading is None:
                raise
            self.bench.say(f"{e}; the reading before it counts")
        _, row = reading
        if jammed is not None:
            self.bench.jammed = replace(jammed, vacuum=replace(jammed.vacuum, since=row.t))
        if state.bodies is not None:
            self.bench.bodies = replace(self.bench.bodies or state.bodies, since=row.t)
        if self.journal is not None:
            self.bench.recorder.sync()
            self.journal.step(trial.number, self._step)
        return row

    def _read(self, state: State, wait: float, repeatable: bool) -> Concluded:
        """Record a state and the row it concludes, once more where a body is misplaced or, `repeatable`, a stream pauses."""
        judged = ", ".join(map(_instrument, state.topics))
        misplaced = False
        for tries_left in reversed(range(READINGS)):
            repeats, _ = self._latest.get(state.step, (0, None))
            number = self.bench.recorder.state(self.bench.clock.now(), state, repeats)
            try:
                row = self._concluded(state, judged, wait)
                self.bench.recorder.trial(self.bench.clock.now(), number, row, repeats)
                self.rows = [r for r in self.rows if (r.trial, r.step) != (row.trial, row.step)] + [row]
                self._latest[state.step] = number, row
                self._void.discard(state.step)
                self._demand_rest(state, row)
                return number, row
            except Misplaced as e:
                if misplaced or not tries_left or not isinstance(state.rule, Settled):
                    text = str(e)
                    self.mark(state.trial, "bodies", text)
                    raise Suspended(DeviceFault("mocap", text)) from e
                self.bench.say(f"{e}; the state is read again")
                misplaced, state = True, replace(state, t_start=self.bench.clock.now())
            except VacuumLost as e:
                raise Suspended(DeviceFault("gauge", str(e))) from e
            except NoResistance as e:
                raise NotPushing(str(e)) from e
            except NotSettled as e:
                if not (tries_left and repeatable and isinstance(e, TooFewSamples)):
                    raise NotReached(f"{e}; judged from {judged}") from e
                self.bench.say(f"{e}; the state is read again")
                state = replace(state, t_start=self.bench.clock.now())
        raise AssertionError("the last reading returns or raises")

    def _demand_rest(self, state: State, row: TrialRow) -> None:
        """Check a state at rest against the first of its set-up, which gives markers their arc lengths; raises Misplaced."""
        if state.bodies is None or state.branch != "load" or any(state.targets) or not isinstance(state.rule, Settled):
            return
        hangs = (state.spine_length, state.vacuum is None, state.tip_mass, state.roll_deg, state.specimen)
        first = self._rest.get(hangs)
        if first is not None and first.trial != row.trial and (difference := elsewhere(first, row)):
            raise Misplaced(
                f"trial {row.trial} step {row.step}: {difference} of trial {first.trial}; the cameras may have taken one body "
                "for another, or the robot or a camera was moved"
            )
        self._rest.setdefault(hangs, row)
        off = [math.hypot(x, y) for x, y, _ in row.markers]  # from the axis: a body at rest is about straight
        if len(state.bodies.arcs) == 1 and all(map(math.isfinite, off)):  # only the tip's arc length is known yet
            self.bench.bodies = replace(state.bodies, arcs=(*state.bodies.arcs, *(z for _, _, z in row.markers)), off=(0.0, *off))

    def _wanted_again(self, rule: Settled | Window | Crossing) -> bool:
        """Whether a person wants the state that was just read to be read once more."""
        if not self.bench.steering.take("repeat"):
            return False
        if isinstance(rule, Crossing):
            self.bench.say("A state that is read while ramping cannot be read once more")
            return False
        return True

    def _concluded(self, state: State, judged: str, wait: float) -> TrialRow:
        """Wait up to `wait` s for the samples that conclude a state; `judged`: its instruments, for the error NotReached."""
        buffers, concluded_up_to = self.bench.recorder.buffers, -math.inf

        def look() -> TrialRow | None:
            nonlocal concluded_up_to
            self.bench.steering.check_skip()
            previous, concluded_up_to = concluded_up_to, min(buffers.newest(topic) for topic in state.topics)
            return conclude(buffers, state) if concluded_up_to > previous else None  # it depends on nothing newer

        def describe() -> str:
            now = self.bench.clock.now()
            newest = {_instrument(topic): self.bench.recorder.buffers.newest(topic) for topic in state.topics}
            silent = {name: t for name, t in newest.items() if t <= max(state.t_start, now - SLOW_OLDEST)}
            alive = ", ".join(f"{name} at {t:.2f} s" for name, t in newest.items() if name not in silent)
            parts = [f"{name}: {_silence(now - t)}" for name, t in silent.items()]
            return "; ".join([*parts, *([f"newest samples{' of the others' * bool(parts)}: {alive}"] if alive else [])])

        return self.bench.wait(f"trial {state.trial} state {state.step}, judged from {judged}", look, wait, describe)

    def zero(self, zeros: Zeros, moved: Drift) -> None:
        """Record how the force zero moved during a trial."""
        self.bench.recorder.zero(self.bench.clock.now(), zeros, moved)
        self.rows = without_drift(self.rows, [(zeros, moved)])
        if not moved.linear:
            self.bench.say(
                f"Trial {zeros.trial}: the force sensor's zero moved by {moved.force:.2f} N, and not at a constant pace: its "
                'states are marked (doubt "drift"); let the sensor warm up, fasten its cable, and repeat the trial'
            )
        elif abs(moved.force) > TOLERATED:
            self.bench.say(
                f"Trial {zeros.trial}: the force sensor's zero moved by {moved.force:.2f} N ({moved.rate:.3g} N/s); this is "
                "removed from the forces"
            )

    def soft(self, trial: Trial, seen: str) -> Suspended:
        """Mark the states of a trial whose jammed spine is soft; returns the exception to raise."""
        if self.bench.jammed is not None:
            self.bench.jammed = replace(self.bench.jammed, soft=True)
        text = f"trial {trial.number}: the jammed spine is soft although the gauge shows its vacuum: {seen}"
        self.mark(trial.number, "soft", text)
        return Suspended(DeviceFault("gauge", f"{text}; check gauge, hoses and membrane, and how it is mounted"))

    def mark(self, trial: int, doubt: str, text: str) -> None:
        """Mark the states of a trial up to now; `doubt`: one of `recordings.trials.DOUBTS`."""
        mark = Mark(self.bench.clock.now(), trial, doubt, text)
        self.bench.recorder.mark(mark)
        self.rows = marked(self.rows, [mark])

    def end(self, trial: Trial) -> None:
        """Finish a trial; a resumed run does not repeat it."""
        if self.journal is not None:
            self.bench.recorder.sync()
            self.journal.done(trial.number, self._step)

    def step_done(self) -> None:
        """One planned step is finished."""
        self._done += 1
        self._tell_progress()

    def _tell_progress(self) -> None:
        done, planned = sum(s.seconds for s in self.plan.steps[: self._done]), self.plan.seconds
        self.bench.narrator.progress(done, planned)
        self.bench.recorder.progress(self.bench.clock.now(), self._done, len(self.plan.steps), done, planned)


def _instrument(topic: str) -> str:
    """Return the name that rig.yaml gives the instrument behind a topic."""
    return f"sensors.{topic.removeprefix(OWN)}" if of_sensor(topic) else SENSORS.get(topic, topic)


def _silence(age: float) -> str:
    """Say for how long (s) an instrument has sent nothing, and what to check."""
    if age == math.inf:
        return "no sample yet; check its power and cable, and that NEEDS of the protocol names it"
    return f"no sample for {age:.1f} s; check its power and cable"


def settled(rules: Settle) -> Settled:
    """The recording's rule for a settled state, from a protocol's parameters."""
    return Settled(
        band=rules.band, still=rules.still, still_distance=rules.still_distance, smooth=rules.smooth, average=rules.average,
        min_samples=rules.min_samples, max_gap=rules.max_gap, max_hidden=rules.max_hidden, timeout=rules.within,
    )  # fmt: skip
