"""What takes the chambers' thrust, settled before a diagnosis where robot.yaml does not say it: textbooks differ.

Both conventions are fitted with the area factor, the tolerances and effects that may act as well. That the side walls take it is
settled where this leaves far less, and likely where it leaves less with all of the thrust on them and an area no farther from
robot.yaml's; the walls are plain, or shaped where this leaves far less. The diagnosis then looks for what is beyond it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from model.effects.catalogue import CATALOGUE
from model.robot import THRUST, Robot
from model.stated import Stated

from ..arrays import rms
from ..data.campaign import Campaign, spread_over
from ..edits.search import Edited, edit_first
from ..errors import BadCase
from ..findings import Finding, finding
from ..judgement import FIT_DISCREPANCY_SIZE, LIKELY_WALLS_GAIN, ON_WALLS, WALLS_GAIN
from .fit import fit
from .prepare import AREA, prepare
from .reading_noise import USUAL
from .search import recalibrated

BESIDE = ("pressure_offset", "chamber_gain", "chamber_azimuth", "base_tilt", "body_modulus", "tip_payload")
"""Effects that may also act and would hide the difference."""
MOST_STATES, ROUNDS = 60, 30
"""States that are compared, evenly spread; most steps of each fit."""


def settled_and_edited(
    robot: Robot, states: Campaign, catalogue: Collection[str], effects: Collection[str]
) -> tuple[Finding | None, Edited]:
    """The note on thrust that is settled, and the robot and the states with the edits that are made first; where there are some,
    thrust is settled after them, as a mistake hides it. `effects`: as `edit_first` takes them."""
    settled = settle_thrust(robot, states, catalogue)
    first = edit_first(robot if settled is None else settled[0], states, effects)
    if first.changes and settled is None:
        settled = settle_thrust(first.robot, first.states, catalogue)
        first = first if settled is None else replace(first, robot=settled[0])
    return settled and settled[1], first


def settle_thrust(robot: Robot, states: Campaign, effects: Collection[str]) -> tuple[Robot, Finding] | None:
    """The robot with the chambers' thrust on its side walls, where that is settled or likely, and the finding on it; None where
    it is neither, robot.yaml says which, or the diagnosis does not weigh it (`effects`)."""
    with_tip = states.take(~states.pushed)
    if THRUST not in effects or robot.chambers is None or robot.thrust or THRUST in robot.effects or not len(with_tip):
        return None
    compared = with_tip.take(np.isin(np.arange(len(with_tip)), spread_over(len(with_tip), MOST_STATES)))
    try:
        p = prepare(robot, compared, catalogue={e: CATALOGUE[e] for e in (THRUST, *BESIDE)}, noise_components=USUAL)
    except (BadCase, np.linalg.LinAlgError):  # too far from the data to compare conventions
        return None
    parameters = p.problem.parameters
    other_effects = tuple(e for e in BESIDE if e in parameters.ids)

    shapes = {f"{THRUST}.{name}": name for name in ("borne", "growth")}
    held = np.isin(np.array(parameters.names)[parameters.of_effect], [*shapes])

    def fitted(named: tuple[str, ...], start: np.ndarray, plain: bool = False) -> tuple[float, dict[str, float]]:
        """rms (mm) of the tip with these effects free, shapes of the walls held where they are `plain`, and the parameters."""
        prior = parameters.prior_of(named)
        prior = replace(prior, variance=np.where(held & plain, 0.0, prior.variance))
        best = fit(p.problem, prior, FIT_DISCREPANCY_SIZE, start, ROUNDS)
        values = dict(zip(parameters.names, best.theta.tolist(), strict=True))
        return 1e3 * rms(p.gap(p.problem.observed - best.predicted)), values

    cap, on_cap = fitted(other_effects, np.zeros_like(parameters.sd))
    start = np.array([float(name == f"{THRUST}.share") for name in parameters.names])
    walls, found = fitted((THRUST, *other_effects), recalibrated(p.problem, start))
    settled, as_stated = walls <= WALLS_GAIN * cap, abs(found[AREA]) <= abs(on_cap[AREA])
    if found[f"{THRUST}.share"] < ON_WALLS or not (settled or (as_stated and walls <= LIKELY_WALLS_GAIN * cap)):
        return None
    plain = fitted((THRUST, *other_effects), np.array([found[name] for name in parameters.names]), plain=True)[0]
    with_walls, words = robot.model_copy(update={"thrust": "walls"}), robot.actuators.words
    if walls <= LIKELY_WALLS_GAIN * plain:  # else shapes would take up what other causes do
        values = {"share": 1.0, **{name: found[key] for key, name in shapes.items()}}
        stated = {name: Stated(value=value, unit="1") for name, value in values.items()}
        with_walls, plain = with_walls.model_copy(update={"effects": {**robot.effects, THRUST: stated}}), walls
    return with_walls, finding("thrust_settled" if settled else "thrust_likely", words, walls_mm=plain, cap_mm=cap)
