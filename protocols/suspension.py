"""Going on after a pause: a piece of work that the rig suspended is begun again, and nothing is read twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import InstrumentError

from .bench import Bench
from .errors import JamLost, NotReached, StoodStill, Suspended
from .experiment import Trial, Trials

T = TypeVar("T")
TRIES = 3
"""Pauses that one piece of work may need; what fails more often is not mended."""


def through_pauses(bench: Bench, work: Callable[[], T], back: Callable[[], None] | None = None) -> T:
    """Do a piece of work; after a pause, with the chambers vented, come `back` to where it begins and do it again.

    Raises an InstrumentError that stays or returns too often; Skipped when a person skips the trial.
    """
    paused, away = 0, False
    while True:
        try:
            bench.steering.check_skip()
            if bench.steering.wants("pause"):
                away = True
                bench.rest()
                continue
            if away:
                bench.look_anew()
                if back is not None:
                    back()
            with bench.repeatable():
                return work()
        except (Suspended, InstrumentError) as e:
            cause = e.cause if isinstance(e, Suspended) else e
            paused, away = paused + 1, True
            if paused > TRIES or not (isinstance(e, Suspended) or bench.recoverable(cause)):
                raise cause from e
            bench.recover(cause, not isinstance(e, StoodStill))


def through_jams(trials: Trials, trial: Trial, work: Callable[[], None]) -> None:
    """Read the states of a trial, all of them again after a new jamming. Raises NotReached if jamming is lost repeatedly."""
    for tries_left in reversed(range(TRIES + 1)):
        try:
            work()
            return
        except JamLost as e:
            if not tries_left:
                raise NotReached(
                    f"trial {trial.number}: {e} {TRIES} times, and lost each time; check pump, valve, hoses and gauge"
                ) from e
            trials.bench.say(f"Trial {trial.number} begins tries_left: {e}")
            trials.begin_again(trial)
