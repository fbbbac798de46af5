"""What every experiment shares: its plan, and the bookkeeping of trials, states and progress."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from recordings.campaign.journal import Journal
from recordings.errors import NotSettled, TooFewSamples
from recordings.states.concluding import conclude
from recordings.states.rules import AMBIENT, Crossing, Probe, Settled, State, Window
from recordings.trials import TrialRow

from .bench import Bench
from .errors import NotReached, Suspended
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
    """What a step asks of the rig, as far as that is known beforehand; SI units, None or empty where it asks nothing."""

    pressures: tuple[float, ...] = ()
    """By chamber, gauge."""
    pressure_rate: float | None = None
    spine_length: float | None = None
    spine_speed: float | None = None
    vacuum: float | None = None
    """Below ambient."""
    probe: tuple[tuple[float, float | None], ...] = ()
    """Where the arm's probe is sent in the stand's frame: along the specimen, and depth (None: as far off as the stand's
    standoff)."""
    arm_speed: float | None = None
    arm_acceleration: float | None = None
    push: Push | None = None


@dataclass(frozen=True)
class Step:
    """One thing that will be done, about how long it takes (s of rig time), and what it asks of the rig."""

    label: str
    seconds: float
    ask: Ask = Ask()


@dataclass(frozen=True)
class Plan:
    """All steps of a run, and the largest values it will ask of the rig (name with unit -> value)."""

    protocol: str
    steps: Sequence[Step]
    limits: dict[str, float]

    @property
    def seconds(self) -> float:
        """Expected duration, s of rig time."""
        return sum(s.seconds for s in self.steps)


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


class Trials:
    """Numbers trials and states, has each state read, tells how far the run is, and keeps the journal.

    `finished`: so many trials were done by the run that this one resumes.
    """

    def __init__(self, bench: Bench, plan: Plan, journal: Journal | None = None, finished: int = 0) -> None:
        self.bench, self.plan, self.journal = bench, plan, journal
        self.rows: list[TrialRow] = []
        self._trial = finished
        self._step = self._done = 0

    def remaining(self, trials: Iterable[T], steps: int) -> list[T]:
        """Of all trials of the protocol, in order, those that are not finished; each has so many planned steps."""
        self._done = self._trial * steps
        return list(trials)[self._trial :]

    def begin(
        self,
        *,
        repeat: int,
        spine: float,
        tip_mass: float = 0.0,
        roll_deg: float = 0.0,
        ambient: float = AMBIENT,
        specimen: str | None = None,
    ) -> Trial:
        """Start the next trial."""
        self._trial += 1
        self._step = 0
        return Trial(self._trial, repeat, spine, ambient, tip_mass, roll_deg, specimen)

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
    ) -> TrialRow:
        """Record what is asked for and wait until the samples that conclude it are there; NotReached after `wait` s.

        `repeatable`: nothing moves and nothing creeps, so a window in which a stream paused is read again from now on.
        """
        self._step += 1
        topics = (*filter(self.bench.has_topic, topics), *self.bench.sensors)
        targets = (*targets, *(0.0,) * (self.bench.chambers.count - len(targets)))
        judged = ", ".join(SENSORS.get(topic, topic) for topic in topics)
        for left in reversed(range(READINGS)):
            state = State(
                trial=trial.number, step=self._step, protocol=self.plan.protocol, repeat=trial.repeat, branch=branch, rule=rule,
                t_start=t_start, ramp_end=ramp_end, rate=rate, targets=tuple(targets), spine_length=trial.spine,
                tip_mass=trial.tip_mass, roll_deg=trial.roll_deg, ambient=trial.ambient, topics=topics,
                specimen=trial.specimen, probe=trial.probe, clipped=self.bench.clipped,
            )  # fmt: skip
            number = self.bench.recorder.state(self.bench.clock.now(), state)
            try:
                row = self._concluded(state, judged, wait)
                break
            except NotSettled as e:
                if not (left and repeatable and isinstance(e, TooFewSamples)):
                    raise NotReached(f"{e}; judged from {judged}") from e
                self.bench.say(f"{e}; the state is read again")
                t_start = self.bench.clock.now()
            except Suspended:
                self._step -= 1  # it will be read again after the pause
                raise
        self.bench.recorder.trial(self.bench.clock.now(), number, row)
        self.rows.append(row)
        if self.journal is not None:
            self.bench.recorder.sync()
            self.journal.step(trial.number, self._step)
        return row

    def _concluded(self, state: State, judged: str, wait: float) -> TrialRow:
        return self.bench.wait(
            f"trial {state.trial} state {state.step}, judged from {judged}",
            lambda: conclude(self.bench.recorder.buffers, state),
            wait,
        )

    def end(self, trial: Trial) -> None:
        """A trial is finished and will not be done again when the run is resumed."""
        if self.journal is not None:
            self.bench.recorder.sync()
            self.journal.done(trial.number, self._step)

    def step_done(self) -> None:
        """One planned step is finished."""
        self._done += 1
        done = sum(s.seconds for s in self.plan.steps[: self._done])
        self.bench.narrator.progress(done, self.plan.seconds)


def settled(rules: Settle) -> Settled:
    """The recording's rule for a settled state, from a protocol's parameters."""
    return Settled(
        band=rules.band, still=rules.still, still_distance=rules.still_distance, smooth=rules.smooth, average=rules.average,
        min_samples=rules.min_samples, max_gap=rules.max_gap, max_hidden=rules.max_hidden, timeout=rules.within,
    )  # fmt: skip


def with_probe(trial: Trial, probe: Probe) -> Trial:
    """The same trial, now that the probe touches."""
    return replace(trial, probe=probe)
