"""What a case folder shows of what was measured: which branches, which channels, which further experiments."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from recordings.trials import Table, TrialRow

from ..files.config import ConfigError


@dataclass(frozen=True)
class Design:
    """The share of the measurements that a diagnosis is given."""

    name: str
    both_branches: bool
    """Unload branch and zero state; without, the paper's own data: loading only, from 50 kPa on."""
    orientation: bool
    markers: bool
    extras: bool
    """All experiments of the menu at once."""

    def show(self, table: Table) -> Table:
        """The rows and columns that are shown."""
        return Table(tuple(self._row(r) for r in table if self.both_branches or _paper_state(r)))

    def _row(self, r: TrialRow) -> TrialRow:
        return replace(
            r,
            orientation=r.orientation if self.orientation else None,
            markers=r.markers if self.markers else (),
        )


DESIGNS = {
    d.name: d
    for d in (
        Design("tip", False, False, False, False),
        Design("full", True, True, False, False),
        Design("full+markers", True, True, True, False),
        Design("full+extras", True, True, False, True),
    )
}
CHANNELS = ("unload", "orientation", "markers")
"""Further channels of the base sweep that can be asked for like an experiment."""


def design(name: str) -> Design:
    """By name; raises ConfigError."""
    if name not in DESIGNS:
        raise ConfigError(f"--design {name}: must be one of {', '.join(DESIGNS)}")
    return DESIGNS[name]


def _paper_state(r: TrialRow) -> bool:
    return r.branch == "load" and max(r.pressures) > 20e3


def joined(tables: Iterable[Table]) -> Table:
    """One campaign: trials numbered on."""
    rows: list[TrialRow] = []
    for table in tables:
        first = max((r.trial for r in rows), default=0)
        rows += [replace(r, trial=r.trial + first) for r in table]
    return Table(tuple(rows))
