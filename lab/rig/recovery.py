"""A pause: the rig vented and stopped, a person puts right what is wrong, and the readings show it before work goes on."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from contextlib import AbstractContextManager

import timing
from drivers.errors import DeviceFault, InstrumentError
from protocols.bench import Operator, Setup
from protocols.errors import Stopped, Suspended

from ..files.rig_file import Limits
from ..guard.messages import RigLanded
from ..guard.pulse import Pulse
from .actuators import Actuators
from .watch import Watch

LOOK = 0.05
STEADY = 1.0
"""Host seconds for which everything must be well before work goes on: longer than a stream may be late unnoticed."""


class PatientOperator:
    """An operator who may take as long as it takes: the guard does not mistake waiting for a person for a hang.

    `asked`: entered while the person answers, so that the keys typed are the answer and nothing else.
    """

    def __init__(
        self,
        operator: Operator,
        pulse: Pulse,
        asked: Callable[[], AbstractContextManager[object]] = contextlib.nullcontext,
    ) -> None:
        self._operator, self._pulse, self._asked = operator, pulse, asked

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare."""
        with self._asked(), self._pulse.waiting_for_person():
            self._operator.prepare(setup)

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm."""
        with self._asked(), self._pulse.waiting_for_person():
            self._operator.confirm(trouble)


class Recovery:
    """What `Bench.recover` does."""

    def __init__(
        self, actuators: Actuators, watch: Watch, operator: Operator, limits: Limits, say: Callable[[str], None]
    ) -> None:
        self._actuators, self._watch, self._operator, self._limits, self._say = actuators, watch, operator, limits, say

    def __call__(self, cause: InstrumentError, ask: bool = True) -> None:
        """Pause for `cause`, and return when the readings are good again; with `ask`, a person must confirm first.

        Raises the cause, with the reason added, when the pause is not confirmed safe or the readings do not recover.
        """
        self._say(f"Paused: {cause}")
        report = self._actuators.pause()
        if not report.confirmed:
            raise _with(cause, f"the pause is not confirmed safe: {report}")
        if ask:
            self._operator.confirm(str(cause))
        try:
            self._actuators.resume()
        except InstrumentError as e:
            raise e from cause
        self._await_health(cause)
        self._say("Resuming")

    def rest(self, over: Callable[[], bool], stopping: Callable[[], bool]) -> None:
        """The pause that a person asked for, until it is `over`; the instruments are watched all the while.

        Raises Stopped, or what has failed meanwhile or stays wrong after it.
        """
        for step in self._actuators.pause().steps:
            if not step.confirmed:
                raise DeviceFault(step.instrument, f"the pause is not confirmed safe: {step.text}")
        self._say("Paused: vented and stopped, the spine stays as it is")
        while not over():
            if stopping():
                raise Stopped("stopped by the operator during a pause; the steps finished so far are in the recording")
            self._actuators.pulse.mark()
            self._watch.look(resting=True)
            timing.sleep(LOOK)
        self._actuators.resume()
        self._await_health(None)
        self._say("Resuming")

    def _await_health(self, cause: InstrumentError | None) -> None:
        """Wait until nothing has been wrong for a while."""
        give_up = timing.now() + self._limits.resume_within
        well_since = timing.now()
        self._watch.forget()
        while timing.now() - well_since < STEADY:
            self._actuators.pulse.mark()
            try:
                self._watch.look(strict=True)
            except (InstrumentError, Suspended) as e:
                if timing.now() > give_up:
                    still = f"{self._limits.resume_within:g} s (limits.resume_within) after it was confirmed as fixed"
                    raise _with(cause or _cause(e), f"{still}, still {e}") from e
                self._watch.forget()
                well_since = timing.now()
            except RigLanded as e:
                if cause is None:
                    raise
                raise _with(cause, str(e)) from e
            timing.sleep(LOOK)


def _cause(error: InstrumentError | Suspended) -> InstrumentError:
    return error.cause if isinstance(error, Suspended) else error


def _with(cause: InstrumentError, more: str) -> InstrumentError:
    """The cause of a pause, and what then went wrong."""
    return type(cause)(cause.instrument, f"{cause.message}; {more}")
