"""campaign.yaml: the order of protocols, the varied parameters, the number of blocks, and the stop rules."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, field_validator, model_validator

from model.plain_yaml import FileTable
from recordings.campaign.labels import labels
from recordings.errors import BadMessage
from recordings.messages import NAME

from .config import Source, check, read_yaml

OWN_LABELS = ("campaign", "block", "run", "condition", "warm_up")
"""Labels that a campaign adds to its recordings."""
MOST_BLOCKS, MOST_RUNS = 1000, 10_000
CampaignName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,59}$")]
LabelName = Annotated[str, StringConstraints(pattern=f"^{NAME.pattern}$")]


class CampaignProtocol(FileTable):
    """A protocol of the campaign."""

    protocol: str = Field(min_length=1, max_length=1000)
    """Its name, or a protocol file (.py), relative to this file."""
    parameters: dict[str, Any] = {}
    """Equal in each of its runs, as in a protocol file."""
    conditions: dict[str, Annotated[list[Any], Field(min_length=1, max_length=200)]] = {}
    """Varied parameters: parameter -> values; each combination is a run in each block. For a list parameter a single value
    means a list of one."""

    @property
    def cells(self) -> int:
        """How many combinations of conditions there are."""
        return math.prod(map(len, self.conditions.values()))

    @model_validator(mode="after")
    def _once(self) -> CampaignProtocol:
        if both := ", ".join(sorted(set(self.parameters) & set(self.conditions))):
            raise ValueError(f"{both}: is in both parameters and conditions; keep it in one of them")
        for name, values in self.conditions.items():
            if any(value in values[:k] for k, value in enumerate(values)):
                raise ValueError(f"conditions.{name} lists a value twice; `blocks` sets the number of repeats")
        return self


class WarmUp(FileTable):
    """Pressure cycles without readings, before the first run that inflates the robot."""

    cycles: int = Field(3, ge=0, le=1000)
    """Of each group of chambers, to its highest pressure; 0: none."""
    again_after: float = Field(1800.0, gt=0, le=1e7, json_schema_extra={"unit": "s"})
    """Time without inflation after which they are repeated."""


class Stop(FileTable):
    """When the campaign ends before its last run."""

    max_duration: float | None = Field(None, gt=0, le=1e7, json_schema_extra={"unit": "s"})
    """Rig time of all runs together, without the pauses between them; no run begins that would exceed it."""
    max_cycles: int | None = Field(None, ge=1, le=10_000_000)
    """Inflations of a chamber; no run begins that would exceed it."""
    max_lost: int | None = Field(None, ge=0, le=1_000_000_000)
    """Samples lost in all runs together."""
    max_failed: int = Field(1, ge=1, le=1000)
    """Failures; up to this number the run continues with its first unfinished trial."""
    max_scatter: float | None = Field(None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Of the tips of one state in different blocks, rms."""


class CampaignFile(FileTable):
    """The whole of campaign.yaml."""

    campaign: CampaignName
    """Its name: a label of each recording, and by default the folder."""
    protocols: list[CampaignProtocol] = Field(min_length=1, max_length=100)
    """One after the other."""
    blocks: int = Field(3, ge=1, le=MOST_BLOCKS)
    """Each holds every condition once, in its own order."""
    seed: int | None = Field(None, ge=0, le=2**63 - 1)
    """Of the orders; by default drawn once and kept."""
    hands: Literal["grouped", "random"] = "grouped"
    """Mounting, tip mass, roll and supply: changed as seldom as possible, or in random order like the rest."""
    warm_up: WarmUp = WarmUp()
    stop: Stop = Stop()
    labels: dict[LabelName, str] = {}
    """Further labels of each recording, such as specimen."""

    @field_validator("labels")
    @classmethod
    def _sound(cls, given: dict[str, str]) -> dict[str, str]:
        if taken := sorted(set(given) & set(OWN_LABELS)):
            raise ValueError(f"{', '.join(taken)}: is set by the campaign itself")
        try:
            return labels(list(given.items()))
        except BadMessage as e:
            raise ValueError(str(e)) from None

    @model_validator(mode="after")
    def _not_endless(self) -> CampaignFile:
        runs = self.blocks * sum(part.cells for part in self.protocols)
        if runs > MOST_RUNS:
            raise ValueError(f"{runs} runs, at most {MOST_RUNS}; use fewer blocks or conditions")
        return self


def load_campaign(path: Path) -> tuple[CampaignFile, Source]:
    """The file and where its keys stand; paths of protocols are absolute. Raises ConfigError."""
    source = read_yaml(path)
    found = check(source, CampaignFile)
    parts = [
        p.model_copy(update={"protocol": str((path.parent / p.protocol).resolve())}) if p.protocol.endswith(".py") else p
        for p in found.protocols
    ]
    return found.model_copy(update={"protocols": parts}), source
