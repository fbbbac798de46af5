"""A whole rig of fakes for tests of the command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sim_fakes.rig import FakeRig


@dataclass(frozen=True)
class VirtualLab:
    """The fakes, and the rig.yaml that reaches them."""

    fakes: FakeRig
    rig: Path
