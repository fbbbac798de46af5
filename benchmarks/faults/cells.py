"""What the matrix is made of, and what counts as passed."""

from __future__ import annotations

from dataclasses import dataclass, field

from sim_fakes.faults import FAULTS

PHASES = ("connect", "approach", "hold", "sweep", "shutdown")
ORDER = ("hold", "connect", "sweep", "shutdown", "approach")
"""In which they are tried: a run that is cut short has seen the worst first."""
SUBJECTS = (
    "pressure/alicat", "pressure/smc_itv", "spine/dynamixel", "spine/tmcl", "valve/numato", "gauge/pfeiffer", "mocap/natnet",
    "force/ft300s", "arm/ur5",
)  # fmt: skip
SECOND_RIG = ("pressure/smc_itv", "spine/tmcl")
"""These need the rig with the other regulators and the other length unit."""
STIFFNESS = ("force", "arm")
"""These are tried in a stiffness trial, the others in a bending sweep."""
SPEED = 20.0
HANG = 20.0
"""Host seconds from the fault to the end of the experiment: the longest time-out is that of a state which does not come to rest,
300 s of rig time, 15 s here; a pause may ask for 2 s more, a driver's own time-outs come to 3 s."""
CONNECT_HANG = 41.0
"""The same while connecting, where all instruments are tried: the arm's state has 20 s, its motion 20 s, to come."""
TIME_OUTS = {"pressure": 0.5, "spine": 0.3, "valve": 0.5, "gauge": 0.5, "force": 0.5, "arm": 3.0}
"""s; longer than the drivers' own, since fakes and lab share the processors of one host."""
LANDING = 5.0
"""Host seconds from there to the report: 2 s a try, two tries, and half a second."""


@dataclass(frozen=True)
class FaultCell:
    """One trial of the matrix."""

    subject: str
    fault: str
    phase: str

    @property
    def instrument(self) -> str:
        """Its name in rig.yaml."""
        return self.subject.split("/")[0]

    @property
    def second_rig(self) -> bool:
        """Whether it needs the second rig."""
        return self.subject in SECOND_RIG

    @property
    def protocol(self) -> str:
        """The experiment it is tried in."""
        return "stiffness" if self.instrument in STIFFNESS else "bending"


@dataclass(frozen=True)
class FaultJob:
    """What the worker is to do: run a protocol, or land and unlock the rig when there is none."""

    rig: str
    folder: str
    protocol: str = ""
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class FaultResult:
    """What the worker found."""

    ended: float = 0.0
    """Host time at which the experiment was over and landing began."""
    landed: float = 0.0
    error: str = ""
    kind: str = ""
    names: str = ""
    """The instrument that the error names; empty for none."""
    steps: tuple[tuple[str, bool, str], ...] = ()
    """Instrument, confirmed, text of the last landing."""
    locked: bool = False
    rows: int = 0


@dataclass(frozen=True)
class Verdict:
    """How a cell went: "." completed and safe, "e" ended with its typed error and safe, "l" ended, the faulty instrument
    cannot be confirmed and the rig is locked, "X" anything else."""

    cell: FaultCell
    mark: str
    why: str = ""
    seconds: float = 0.0
    """From the fault to the end of the experiment, host time."""
    error: str = ""
    unsafe: tuple[str, ...] = field(default_factory=tuple)
    given: bool = True
    """Whether the fault was given at all: a rig that stopped safely before its phase came says nothing about it."""
    tries: int = 1


def cells(
    subjects: tuple[str, ...] = SUBJECTS, faults: tuple[str, ...] = FAULTS, phases: tuple[str, ...] = PHASES
) -> list[FaultCell]:
    """All cells, phase by phase; those of one rig together."""
    every = [FaultCell(s, f, p) for s in subjects for f in faults for p in phases]
    return sorted(every, key=lambda c: (ORDER.index(c.phase), c.second_rig))
