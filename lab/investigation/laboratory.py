"""The rig as the place where an investigation's experiments are done: by the protocols of `lab run`, under the same guard."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import yaml

from diagnosis.answer.result import Proposal
from diagnosis.investigate import Foretold, NotDone
from protocols.errors import ProtocolError, Stopped
from recordings.own_files import replaced

from ..console import Screen, err
from ..files.config import ConfigError, Source
from ..files.inputs import Case, read_case
from ..files.rig_file import RigFile
from ..live.beside import Page
from ..rig.assembly import Rig
from ..rig.operator import Prepared
from ..verbs.run import Job, Outcome, connect, execute, job

FORETOLD, PROTOCOL = "foretold.json", "protocol.yaml"
NEEDED = {"markers": "markers on the body, named in rig.yaml under instruments.mocap.markers"}
"""What an experiment takes beyond instruments, by its id."""


@dataclass(frozen=True)
class Wanted:
    """What a person asked for."""

    inputs: tuple[Path, ...]
    rig: Path
    folder: Path
    minutes: float
    """Of all experiments."""
    experiments: int
    robot: Path | None = None
    effects: Path | None = None
    hands: bool = True
    without: tuple[str, ...] = ()
    """Experiments that are not to be done, by id."""
    settings: tuple[str, ...] = ()
    """KEY=VALUE, for every experiment."""
    labels: tuple[tuple[str, str], ...] = ()
    workers: int | None = None
    watched: bool = False
    """On a page in the browser."""


class RigLaboratory:
    """Does experiments on a rig and keeps everything in a folder, one below it for each."""

    def __init__(self, wanted: Wanted, rig: RigFile, told: Callable[[Foretold], None]) -> None:
        self._wanted, self._rig, self._told = wanted, rig, told
        self._inputs = list(wanted.inputs)
        self._prepared = Prepared()
        self._jobs: dict[str, Job | str] = {}
        self.begun = ""
        """Id of the experiment that was begun last."""
        self.lost = 0
        """Samples."""
        self.safe = True
        self.page: Page | None = None
        """Where the experiments are seen."""

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The campaign as it is by now: what was given, and the recordings made since."""
        return tuple(self._inputs)

    def refusal(self, proposal: Proposal) -> str:
        """See Laboratory."""
        if proposal.id in self._wanted.without:
            return "not wanted"
        if proposal.hands_min and not self._wanted.hands:
            return f"takes {proposal.hands_min:g} min of somebody's hands"
        if proposal.id not in self._jobs:
            self._jobs[proposal.id] = self._job(proposal)
        found = self._jobs[proposal.id]
        return found if isinstance(found, str) else ""

    def _job(self, proposal: Proposal) -> Job | str:
        """What is to be run, or why it cannot be."""
        try:
            given = Source(proposal.id, dict(proposal.protocol), {})
            found = job(proposal.id, self._wanted.rig, list(self._wanted.settings), given, rig=self._rig)
        except (ConfigError, ProtocolError) as e:
            return str(e).splitlines()[0]
        if proposal.id in NEEDED and not getattr(found.rig.instruments.mocap, "markers", None):
            return f"needs {NEEDED[proposal.id]}"
        return replace(found, labels={"investigation": self._wanted.folder.name, **dict(self._wanted.labels)})

    def perform(self, foretold: Foretold) -> Case:
        """See Laboratory. Raises what ended the run, `Stopped` when a person did."""
        proposal = foretold.proposal
        j = self._jobs[proposal.id]
        if isinstance(j, str):
            raise NotDone(j)
        place = self._place(proposal.id)
        place.mkdir(parents=True)
        replaced(place / PROTOCOL, yaml.safe_dump(dict(proposal.protocol), sort_keys=False))
        replaced(place / FORETOLD, json.dumps(asdict(foretold), indent=1) + "\n")
        self._told(foretold)
        self.begun = proposal.id
        result = self._run(j, place)
        self.lost += sum(result.lost.values())
        self.safe = result.safe
        if len(result.table):
            self._inputs.append(result.file)
        if result.error is not None:
            raise result.error
        if not result.safe:
            raise Stopped("the safe state is not confirmed; nothing more is done")
        return read_case(self._inputs, self._wanted.robot)

    def _run(self, j: Job, place: Path) -> Outcome:
        with ExitStack() as open_:
            rig = open_.enter_context(Rig(j.rig))
            rig.operator = self._prepared.over(rig.operator)
            connect(rig, j.experiment.needs, quiet=True)
            screen = Screen(j.experiment.name, j.rig.clock.speed)
            if self.page is not None:
                self.page.part(f"Investigation {self._wanted.folder.name}. Experiment {place.name}", more=True)
            result = execute(rig, j, place, screen, page=self.page)
            for text in rig.notices:
                err.print(f"warning: {text}")
        return result

    def _place(self, id: str) -> Path:
        """A folder for the next experiment: those there are numbered."""
        there = [int(p.name[:2]) for p in self._wanted.folder.glob("[0-9][0-9]-*") if p.is_dir()]
        return self._wanted.folder / f"{max(there, default=0) + 1:02d}-{id}"
