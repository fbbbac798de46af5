"""Small campaigns whose tips come from the forward model itself plus noise, and one of them diagnosed for several tests."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.answer.result import Diagnosis
from diagnosis.data.case import Case
from diagnosis.diagnose import Examined, Options, examine
from diagnosis.inference.prepare import table_columns
from model.effects import CATALOGUE, EffectSpec
from model.robot import Robot
from recordings.trials import TrialRow
from tests.diagnosis.test_case import ROBOT, Measured, case, states, sweep
from tests.model.effects.campaigns import Moved

LENGTHS, FEW = (0.0, 0.1, 0.2, 0.3), (0.0, 0.2)
"""Spine lengths of a campaign, m; of one that is answered quickly."""
RIVALS = ("pressure_offset", "chamber_ballooning", "chamber_azimuth", "base_tilt", "precurvature", "marker_offset")
"""Effects that compete in tests of what does not depend on how many there are; all of them in `make test LONG=1`. Without
`chamber_thrust`, for which the robot would be fitted twice before its cause is looked for."""
SOME = {effect: CATALOGUE[effect] for effect in RIVALS}
few_and_all = pytest.mark.parametrize(
    "catalogue", [SOME, pytest.param(CATALOGUE, marks=pytest.mark.long)], ids=["some effects", "all effects"]
)
"""The second asks the same of the whole catalogue, with which the tests of the command are diagnosed too."""
Catalogue = Mapping[str, EffectSpec]


def quick(catalogue: Catalogue = SOME) -> Options:
    """The cause alone."""
    return Options(quantify=False, experiments=False, catalogue=catalogue)


def measured(repeats: int, seed: int, lengths: tuple[float, ...] = LENGTHS, **effects: float) -> Measured:
    """A campaign with effects (parameter name with _ for the dot: value), 0.3 mm of noise."""
    return moved_by(sweep(repeats, lengths), seed, **effects)


def moved_by(rows: list[TrialRow], seed: int, robot: Robot = ROBOT, **effects: float) -> Measured:
    """The same of these rows, whose tips are those of `robot`."""
    rng = np.random.default_rng(seed)
    values = {name.replace("__", "."): value for name, value in effects.items()}
    own = {effect: CATALOGUE[effect] for effect in (name.partition(".")[0] for name in values) if effect in CATALOGUE}
    tips = Moved(robot, table_columns(states(case(rows))[0]), area="one", catalogue=own).tips(values)
    tips = tips + 0.3e-3 * rng.normal(size=(len(rows), 3))
    return case([replace(r, tip=tuple(tip)) for r, tip in zip(rows, tips.tolist(), strict=True)])


def campaign() -> Measured:
    """Chambers 8 deg from where they should be."""
    return measured(3, 1, chamber_azimuth__angle=np.radians(8))


def answer(catalogue: Catalogue) -> Diagnosis:
    """All that a diagnosis computes of that campaign; once for each catalogue."""
    return examined_once(campaign(), Options(catalogue=catalogue)).diagnosis


EXAMINED: dict[str, Examined] = {}


def examined_once(case: Case, options: Options) -> Examined:
    """`examine` for tests that begin with the same campaign and the same options: once for each table and catalogue."""
    key = repr((case.table.rows, [*options.catalogue]))
    if key not in EXAMINED:
        EXAMINED[key] = examine(case, options)
    return EXAMINED[key]
