"""What is wrong in a table or its robot.yaml as they are read, judged by the list of edits.

A table that is not in SI units and in the base's frame is refused; what else is far better is asked about.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from model.errors import BadCondition
from model.robot import Robot
from recordings.trials import Table

from .. import judgement
from ..data.case import campaign_of
from ..data.plausible import implausible_values
from ..findings import Finding, finding
from .beam import wrong_units
from .edit import AREA, MODULUS
from .misfit import as_described
from .search import judged, sample_of

UNITS = ("stiffness_unit", "pressures_in_unit", "places_in_unit", "pressures_absolute", "attitudes_elsewhere")
"""Findings for which a table is refused."""
FRAMES = ("frame_turned", "frame_mirrored", "displacements")
"""Those for which it is refused where its tips are far from the rod's."""


@dataclass(frozen=True)
class Reading:
    """What to say about a table: column, value, what it looks like, what to write."""

    refused: tuple[str, ...]
    asked: tuple[str, ...]
    """Empty where something is refused."""


def read(robot: Robot, table: Table) -> Reading:
    """Judge a table of trials of a robot."""
    impossible, tips = implausible_values(robot, table)
    found = [(f, True) for f in wrong_units(robot, table)]
    with suppress(BadCondition):  # states that do not fit this robot, which is said where they are used
        found += _by_rod(robot, tips) if len(tips) >= judgement.EDIT_FEWEST else ()
    refused = (*impossible, *(str(f) for f, refuse in found if refuse))
    return Reading(refused, () if refused else tuple(str(f) for f, _ in found))


def _by_rod(robot: Robot, tips: Table) -> Iterator[tuple[Finding, bool]]:
    """Findings about states with a tip, and whether they refuse the table; of a robot with effects, which are not in the rod,
    only those that do."""
    plain = robot.model_copy(update={"effects": {}, "tolerances": {}})
    sample = sample_of(plain, campaign_of(tips, np.arange(len(tips)), np.arange(0)))
    if sample is None:
        return
    moved, findings = float(sample.rms(sample.table.tip - sample.table.tip.mean(axis=0))), list[Finding]()
    least, most = judgement.EDIT_LEAST * robot.length, judgement.EDIT_GROSS * robot.length
    gross = float(np.clip(judgement.EDIT_OF_MOVED * moved, least, most))
    fits = as_described(sample)
    left = [float(sample.rms(f.missed[sample.places])) for f in fits]
    # of those that are near, the one that changes least
    best = min(range(len(fits)), key=lambda k: (left[k] > gross, left[k] if left[k] > gross else abs(fits[k].theta[AREA])))
    rms, fit = left[best], fits[best]
    missed = fit.missed[sample.places]
    ratio, words = float(np.exp(fit.theta[AREA] - fit.theta[MODULUS])), robot.actuators.words
    scaled = not 1 / judgement.OTHER_UNIT < ratio < judgement.OTHER_UNIT
    if rms > gross or not sample.aligned(fit) or sample.ambient or scaled:
        by_edits = judged(sample)
        findings += by_edits.findings if by_edits is not None else ()
    if not findings and scaled and rms <= gross:
        findings.append(finding("scale_far_off", words, factor=ratio))
    elif not findings and rms > judgement.EDIT_UNEXPLAINED * robot.length:
        findings.append(finding("tip_far_off", mm=1e3 * rms))
    far = float(np.median(np.linalg.norm(missed, axis=1))) > judgement.EDIT_FAR * robot.length
    for f in findings:
        refuse = f.values.get("p", 0.0) > judgement.CAUSE_PROBABILITY and (f.code in UNITS or (f.code in FRAMES and far))
        if refuse or plain == robot:
            yield f, refuse
