"""The stop rules of a campaign, judged between two runs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from protocols.experiment import Plan
from protocols.planned import cycles
from recordings.trials import Table

from ..console import clock
from ..files.campaign_file import Stop
from .journal import Done

Key = tuple[tuple[int, int], int, int]
"""Cell, trial in the run, step: a state that each block has once."""


class Stops:
    """Judges; what it says is why the campaign ends, or nothing."""

    def __init__(self, rules: Stop, chambers: int) -> None:
        self.rules = rules
        self.failed = 0
        """Failures since this process began: what was before, a person has seen."""
        self._chambers = chambers
        self._cycles = np.zeros(chambers, np.int64)
        self._tips: dict[Key, list[np.ndarray]] = {}

    def count(self, plan: Plan, times: int = 1) -> None:
        """A plan has been begun so often: its cycles count as whole."""
        self._cycles = self._cycles + times * cycles(plan, self._chambers)[0]

    def before(self, plan: Plan, done: Done) -> str:
        """Why a plan must not begin."""
        longest, most = self.rules.max_duration, self.rules.max_cycles
        if longest is not None and done.seconds + plan.seconds > longest:
            return (
                f"stop.max_duration = {longest:g} s: runs have taken {clock(done.seconds)} of rig time, the next needs "
                f"{clock(plan.seconds)}"
            )
        after = self._cycles + cycles(plan, self._chambers)[0]
        if most is not None and after.max() > most:
            chamber = int(after.argmax())
            return (
                f"stop.max_cycles = {most}: chamber {chamber + 1} was inflated {self._cycles[chamber]} times, the next run "
                f"would make it {after[chamber]}"
            )
        return ""

    def take(self, cell: tuple[int, int], table: Table) -> None:
        """The states of a run that was completed."""
        states = table.take(~np.isnan(table.get("x")))
        for trial, step, tip in zip(states.trial.tolist(), states.get("step").tolist(), states.tip, strict=True):
            self._tips.setdefault((cell, trial, step), []).append(tip)

    def after(self, done: Done) -> str:
        """Why the campaign must not go on after a run."""
        if self.rules.max_lost is not None and done.lost > self.rules.max_lost:
            return f"stop.max_lost = {self.rules.max_lost}: {done.lost} samples were lost"
        if self.failed >= self.rules.max_failed:
            return f"stop.max_failed = {self.rules.max_failed}: {self.failed} run{'s' if self.failed > 1 else ''} failed"
        most = self.rules.max_scatter
        if most is None:
            return ""
        worst, (cell, trial, step) = max(self._scatters(), default=(0.0, ((0, 0), 0, 0)))
        if worst <= most:
            return ""
        return (
            f"stop.max_scatter = {most * 1e3:g} mm: the tip of protocol {cell[0] + 1}, condition {cell[1] + 1}, trial {trial} "
            f"step {step} scatters by {worst * 1e3:.2f} mm (rms) between blocks; see to mount, spine and hoses"
        )

    def _scatters(self) -> Iterator[tuple[float, Key]]:
        for key, tips in self._tips.items():
            if len(tips) > 1:
                away = np.array(tips) - np.mean(tips, axis=0)
                yield float(np.sqrt((away**2).sum(axis=1).mean())), key
