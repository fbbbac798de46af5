"""`lab safe`: vent, stop and release every reachable actuator, confirmed by reading back; `--clear` then unlocks the rig.

A run in progress is ended: its guard is asked first, lands the rig at once and reports what it read back. This process lands
every actuator that no guard owns, by the readable part of rig.yaml.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..guard.door import Landed, land, names_of_path, owners
from ..guard.messages import SafeReport, SafeStep
from ..options import JSON, OneOf, Result, Verb, option, path_option
from ..plain import typed
from ..priority import coming_first

if TYPE_CHECKING:
    from ..files.rig_file import RigFile
    from ..guard.latch import Latch


@dataclass
class RigLanding:
    """Result at one rig."""

    steps: list[SafeStep] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    names: frozenset[str] = frozenset()
    """Names owned by the guards that answered."""
    locked: str = ""

    def ask(self, names: Iterable[str], rig: Path) -> None:
        """Have the guards that own these names land their rigs; kill a guard that does not answer, if permitted."""
        landed = land(names, rig)
        self.steps += landed.report.steps
        self.names |= landed.names_for(rig)
        self.locked = self.locked or "; ".join(answer.locked for _, answer in landed.answered if answer.locked)
        self.notes += _ended(landed)

    @property
    def report(self) -> SafeReport:
        """All steps."""
        return SafeReport(tuple(self.steps))

    @property
    def code(self) -> int:
        """The exit code."""
        return 0 if self.report.confirmed and not self.locked else 1

    @property
    def told(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"confirmed": self.report.confirmed, "locked": self.locked, "steps": [asdict(s) for s in self.steps]}


@coming_first()
def safe(rig_path: Path, clear: bool = False) -> Result:
    """Code 0 only when every actuator was read back safe, and the rig is not locked afterwards."""
    result = _landed(rig_path, clear)
    from ..console import warn

    warn(result.notes)
    return Result(result.told, lambda: _show(rig_path, result), result.code)


@coming_first()
def safe_all() -> Result:
    """Land every rig of this computer that a guard owns or that was not left safe; 0 only when all are confirmed."""
    live = land()
    landings = {owner.rig: RigLanding(list(answer.report.steps), locked=answer.locked) for owner, answer in live.answered}
    notes = _ended(live)
    from ..console import out, warn
    from ..guard.last_used import forget, remembered
    from ..rig.real_time import FakesEnded

    for rig in list(remembered()):
        if rig.path is not None and not names_of_path(rig.path) & live.names_for(rig.path):
            try:
                landings[str(rig.path)] = _landed(rig.path, clear=False)
            except FakesEnded as e:
                warn([str(e)])
                forget(rig)
    warn(notes)

    def show() -> None:
        for path, result in landings.items():
            out.print(f"{path}:")
            warn(result.notes)
            _show(Path(path), result)
        if not landings:
            out.print("No rig of this computer is in use or was left unsafe.")

    code = max([1 if notes else 0, *(result.code for result in landings.values())])
    return Result({"rigs": {path: result.told for path, result in landings.items()}}, show, code)


def _landed(rig_path: Path, clear: bool) -> RigLanding:
    """Land one rig by its guard, else by this process; `clear`: unlock it when all is confirmed. Raises ConfigError."""
    result = RigLanding()
    result.ask(names_of_path(rig_path), rig_path)
    # the rest is imported after the asking, which needs none of it
    from ..files.config import ConfigError
    from ..guard.latch import Latch
    from ..rig.interrupts import Shielded
    from ..rig.real_time import FakesEnded

    latch = Latch(rig_path)
    with Shielded():
        try:
            _land_rest(rig_path, latch, result, clear)
        except ConfigError as e:
            if not result.names:
                if isinstance(e, FakesEnded):
                    raise
                live = ", ".join(owner.rig for owner in owners()) or "none"
                raise ConfigError(
                    f"{e}\nno run owns this path; rigs in use on this computer: {live}. `lab safe --all` lands them, and those "
                    "that were not left safe"
                ) from e
            result.notes.append(str(e))
    if not result.names and not result.report.confirmed and os.path.exists(latch.path):
        result.notes.append(
            "cannot reach a guard of this rig. If a run is active in a container that does not share the rig's folder, enter "
            "`lab safe` there"
        )
    if not result.names or os.access(latch.path.parent, os.R_OK | os.X_OK):
        result.locked = latch.read() or ""
    return result


def _show(rig_path: Path, result: RigLanding) -> None:
    """Print each instrument's step and whether the rig is safe or locked, with what to do."""
    from ..console import out, styled

    for step in result.steps:
        state = "safe" if step.confirmed else styled("NOT CONFIRMED", "red")
        out.print(f"  {step.instrument}:", state, f"({step.text})")
    if not result.report.confirmed:
        out.print("Not confirmed safe: use the vent valve and the emergency stop.", style="red")
    elif not result.locked:
        out.print("Safe.")
    else:
        out.print(
            f"Safe now. The rig stays locked: {result.locked}. Once you have inspected it and nobody is within reach: "
            f"{typed('lab', 'safe', '--clear', '--rig', rig_path)}"
        )


def _ended(landed: Landed) -> list[str]:
    """Kill each trusted guard that did not answer, if permitted; return texts on what was done, and on guards in doubt."""
    texts = []
    for owner in landed.silent:
        if owner.pid in (0, os.getpid()):
            texts.append(f"{owner}; it does not answer and does not run in this container: end it where it runs")
            continue
        with contextlib.suppress(ProcessLookupError):
            try:
                os.kill(owner.pid, signal.SIGKILL)
                texts.append(f"process {owner.pid} of user {owner.user} owned the rig and did not answer; it was killed")
            except PermissionError:
                texts.append(
                    f"process {owner.pid} owns the rig and does not answer, but only user {owner.user} may kill it. Kill it, "
                    "then enter `lab safe` again"
                )
    asked = "It was asked to land; the safe state is read from the instruments alone"
    return texts + [f"{owner}. {asked}" for owner in landed.doubtful]


def _land_rest(rig_path: Path, latch: Latch, result: RigLanding, clear: bool) -> None:
    """Land the actuators that no guard has landed, into `result`; `clear`: then unlock. Raises ConfigError, FakesEnded."""
    from timing import RigClock

    from ..files.rig_file import rig_to_make_safe
    from ..guard.instruments import ACTUATORS, owned_names
    from ..guard.last_used import recall
    from ..guard.new_guard import make_safe_with_new_guard
    from ..rig.real_time import at_real_speed, demand_running

    readable = rig_to_make_safe(rig_path, recall(rig_path))
    result.notes += readable.notes
    # the guard of another rig may own a line of this one
    result.ask(owned_names(readable.rig) - result.names - names_of_path(rig_path), rig_path)
    demand_running(readable.rig)
    file, speed_note = at_real_speed(_without(readable.rig, result.names))
    result.notes += [speed_note] if speed_note else []
    actuators = [n for n in ACTUATORS if getattr(file.instruments, n) is not None]
    unusable = [SafeStep(n, False, f"{why}; make it safe by hand") for n, why in readable.missing.items() if n in ACTUATORS]
    if actuators or not result.names:
        report = make_safe_with_new_guard(file, RigClock(file.clock.speed), actuators, "lab safe", clear and not unusable)
        result.steps += report.steps
    # only the guard of this rig knows what it landed; that of another rig on the same lines says nothing of these
    if unusable and not result.names & names_of_path(rig_path):
        result.steps += unusable
        with contextlib.suppress(OSError):
            latch.write(f"safe state not confirmed after: lab safe. {SafeReport(tuple(result.steps))}")


def _without(rig: RigFile, names: frozenset[str]) -> RigFile:
    """The rig without the instruments that its guards have landed; under its own path only if that is free."""
    from ..guard.instruments import exclusive

    if not names:
        return rig
    landed = {name: None for name, lines in exclusive(rig).items() if lines & names and "." not in name}
    left = rig.model_copy(update={"instruments": rig.instruments.model_copy(update=landed)})
    return left.read_from(None) if rig.path is not None and names_of_path(rig.path) & names else left


VERBS = (
    Verb(
        "safe",
        lambda a: safe_all() if a.all else safe(a.rig, a.clear),
        options=(
            JSON,
            OneOf(
                path_option("--rig", "RIG.yaml", "rig.yaml"),
                option("--all", action="store_true", help="every rig of this computer that is in use or was not left safe"),
                required=True,
            ),
            option("--clear", action="store_true", help="unlock the rig when everything is confirmed safe"),
        ),
        examples=("lab safe --rig rig/rig.yaml", "lab safe --all"),
        page="docs/explanations/safety.md",
    ),
)
