"""A campaign as its plan foresees it, and what each further experiment would bring to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import EffectSpec
from model.robot import Robot
from recordings.trials import Table

from ..answer.experiments import candidate_experiments, columns
from ..answer.result import Proposal
from ..data.case import Case, CaseLike, states
from ..errors import BadCase
from ..inference.prepare import prepare
from ..inference.reading_noise import DEFAULT_NOISE
from .rates import power
from .worlds import Planned

Columns = Mapping[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Addition:
    """An experiment more, and what it would bring."""

    experiment: Proposal
    right: float
    """Share of the same causes told right with it."""
    gained: float
    """Over what the plan tells in as many worlds."""

    @property
    def per_hour(self) -> float:
        """Gain an hour."""
        return self.gained / max(self.experiment.cost_min / 60, 1e-3)


def foreseen(robot: Robot, table: Columns, seed: int = 1) -> Case:
    """A case as the planned columns would give it, of a robot as it is described, read with the usual noise and scatter of
    trials. Raises `BadCase` where the rod has no equilibrium."""
    design = design_from_columns(robot, table)
    forward = ForwardModel(robot, design, area="one", catalogue={})
    rng = np.random.default_rng(seed)
    # what recurs (with trials, repeats, mountings) is drawn, all else is as described
    theta = np.array([p.sd * rng.standard_normal() if p.recurs else 0.0 for p in forward.parameters])
    low, high = np.array([[p.low, p.high] for p in forward.parameters]).T
    values = forward.predict(np.clip(theta, low, high))
    if not np.isfinite(values).all():
        raise BadCase("the rod model has no equilibrium at a planned state: check pressures, and robot.yaml's stiffness")
    columns_read, observed = {name: np.array(column) for name, column in table.items()}, forward.observations
    for name in "xyz":
        rows = observed.channel == name
        columns_read[name][observed.row[rows]] = values[rows] + DEFAULT_NOISE["tip"] * rng.standard_normal(int(rows.sum()))
    n = len(design)
    return Case(robot, Table({"step": np.arange(1, n + 1), "protocol": np.full(n, "bending"), **columns_read}))


def of_case(case: CaseLike, catalogue: Mapping[str, EffectSpec] = CATALOGUE) -> Planned:
    """The linear problem of a campaign, measured or foreseen. Raises `BadCase`."""
    return Planned.of(prepare(case.robot, states(case)[0], catalogue=catalogue))


def additions(
    case: Case,
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
    each: int = 12,
    seed: int = 2,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Addition, ...]:
    """What each experiment of the menu would bring beside a plan, most for its time first, by `each` worlds of every cause."""
    right_before = power(of_case(case, catalogue), tuple(catalogue), each, seed).right
    menu = candidate_experiments(case.robot, states(case)[0])
    brought = []
    for k, e in enumerate(menu):
        progress((k + 1) / (len(menu) + 1))
        try:
            extended = _with(case, e, seed)
        except BadCase:
            continue
        right_after = power(of_case(extended, catalogue), tuple(catalogue), each, seed).right
        brought.append(Addition(e, right_after, right_after - right_before))
    progress(1.0)
    return tuple(sorted(brought, key=lambda a: -a.per_hour))


def _with(case: Case, e: Proposal, seed: int) -> Case:
    """The case with an experiment behind it."""
    chambers = len(case.robot.actuators.azimuths_deg)
    more = foreseen(case.robot, columns(e.protocol, chambers, ("x", "y", "z", *e.channels)), seed)
    later = more.table.replaced({"t": more.table["t"] + case.table["t"].max() + 60.0})
    return Case(case.robot, Table.joined([case.table, later]))
