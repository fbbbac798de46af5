"""Whether the tip goes to where chambers push or tendons pull it: what exchanged columns, signs, frames or units make of a table.

With the tip's displacement across the axis d = x + iy and the push u = -+ sum p_k exp(i azimuth_k)
(- of chambers, + of tendons),

    a = sum d conj(u) / sum |d||u|        1 where each state bends to where it is pushed, exp(i phi) where all turn by phi
    b = sum d u / sum |d||u|              of size 1 where left and right are exchanged

Robots with odd chambers, twists and loads do such things too, so nothing is refused here.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.case import finite
from diagnosis.data.plausible_pressures import Pressures, setting_of_each
from model.actuators import Words
from model.robot import Robot
from recordings.trials import Table

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ASIDE, PUSHED, FEWEST = 0.03, 0.2, 4
"""Robot lengths that a tip must move across the axis, and share of the largest push, for a state to tell a direction; states."""
ALIKE, ENOUGH = 0.9, 0.8
"""Least agreement (1 is the most) with one change of the table, and as it is, that is no coincidence."""
SIDES, CLEARLY = 0.3, 0.5
"""Least share of the second singular value of the push in the first for a tip pushed to several sides; how much more of the
movement along one axis than of that along another must be linear in the push."""
NOTHING = 0.1
"""Share of what other chambers do below which one may not be connected."""


def doubtful_directions(robot: Robot, table: Table) -> tuple[str, ...]:
    """What to ask about a table whose tips (m) go elsewhere than its pressures push them: one message, or none."""
    tips = table.take(table.with_tip & finite(table))
    if not len(tips) or tips.pressures.shape[1] != len(robot.bending_directions):
        return ()
    kind, words = setting_of_each(tips), robot.actuators.words
    own = tips.take(kind == np.bincount(kind).argmax())
    seen = Pressures.of(robot, own)
    towards = robot.bending_directions * np.exp(1j * np.radians(own.get("roll_deg", 0.0)))[:, None]
    aside = seen.displacement[:, 0] + 1j * seen.displacement[:, 1]
    push = (seen.pressure * towards).sum(axis=1)
    # each actuator against its own highest, so that one in another unit does not hide the others
    share = seen.pressure / np.maximum(np.abs(seen.pressure).max(axis=0), 1e-300)
    if odd := _still(np.abs(aside), seen.pressure, words):
        return (odd,)
    told = (np.abs(aside) > ASIDE * robot.length) & (np.abs((share * towards).sum(axis=1)) > PUSHED)
    if told.sum() < FEWEST:
        return ()
    what = f"{words.pressures} {'push' if robot.tendons is None else 'pull'}"
    if odd := _axis(seen.displacement[told], push[told], what):
        return (odd,)
    return tuple(_doubts(aside[told], seen.pressure[told], towards[told], what, words))


def _still(aside: Array, pressure: Array, words: Words) -> str:
    """About an actuator that does nothing alone, while others bend the robot; empty where each does something."""
    highest = np.abs(pressure).max()
    for k in range(pressure.shape[1]):
        others = np.abs(np.delete(pressure, k, axis=1)).max(axis=1, initial=0.0)
        alone = (np.abs(pressure[:, k]) > 0.5 * highest) & (others < 0.05 * highest)
        if alone.sum() > 1 and aside[alone].max() < NOTHING * aside.max():
            return (
                f"column p{k + 1}: alone it moves the tip by at most {1e3 * aside[alone].max():.2g} mm, others by "
                f"{1e3 * aside.max():.3g} mm: check whether the {words.actuator} is connected, and the column"
            )
    return ""


def _axis(moved: Array, push: Complex, what: str) -> str:
    """About an axis along which the tip moves to and fro as it is pushed across it: only along its own does the body shorten on
    all sides."""
    pushed = np.column_stack([push.real, push.imag])
    found, _, rank, size = np.linalg.lstsq(pushed, moved, rcond=None)
    if rank < 2 or size[1] < SIDES * size[0] or not (moved**2).sum(axis=0).all():
        return ""
    linear = 1 - ((moved - pushed @ found) ** 2).sum(axis=0) / (moved**2).sum(axis=0)
    along = int(np.argmin(linear))
    if along == 2 or linear[2] - linear[along] < CLEARLY:
        return ""
    return (
        f"along z the tip moves to and fro as the {what} it across, along {'xy'[along]} it does not: "
        f"{'xy'[along]} seems to be the robot's axis; check the frame and the columns x, y, z"
    )


def _doubts(aside: Complex, pressure: Array, towards: Complex, what: str, words: Words) -> Iterator[str]:
    push = (pressure * towards).sum(axis=1)
    as_is, mirrored = _agreement(aside, push), abs(_agreement(aside, push.conj()))
    head = f"the tip does not go to where the {what} it (agreement {round(as_is.real, 2) + 0.0:.2f} of 1)"
    exchanged, pair = _best_exchange(aside, pressure, towards)
    if odd := _other_gain(aside, pressure, towards, words):
        yield odd
    elif as_is.real >= ENOUGH:
        return
    elif exchanged > ALIKE:
        also = ", and so would one of x and y, or a wrong sign of one of them" if mirrored > ALIKE else ""
        yield f"{head}; an exchange of columns p{pair[0] + 1} and p{pair[1] + 1} would do that{also}: check these columns"
    elif abs(as_is) > ALIKE and abs(np.degrees(np.angle(as_is))) > 45.0:
        yield (
            f"{head} but, in all states, {np.degrees(np.angle(as_is)):.0f} degrees from there about z: check x and y of the "
            f"frame, and from which {words.actuator} p1 .. are counted"
        )
    elif mirrored > ALIKE:
        yield f"{head} but to its mirror image: check x, y, their signs, and the order of p1 .."
    elif abs(as_is) < ALIKE:
        yield f"{head}: check the frame, the columns x, y, z and p1 .., and which marker is the tip"


def _agreement(aside: Complex, push: Complex) -> complex:
    return complex(np.sum(aside * push.conj()) / np.sum(np.abs(aside) * np.abs(push)))


def _best_exchange(aside: Complex, pressure: Array, towards: Complex) -> tuple[float, tuple[int, int]]:
    """The agreement after the exchange of two chambers that makes it largest, and these two."""
    found = [(-1.0, (0, 0))]
    for i, j in combinations(range(pressure.shape[1]), 2):
        order = np.arange(pressure.shape[1])
        order[[i, j]] = j, i
        found.append((_agreement(aside, (pressure[:, order] * towards).sum(axis=1)).real, (i, j)))
    return max(found)


def _other_gain(aside: Complex, pressure: Array, towards: Complex, words: Words) -> str:
    """About one chamber that moves the tip much more or less per pressure than the others; empty where none does."""
    highest = np.abs(pressure).max(axis=0)
    used = np.flatnonzero(highest > 5e-3 * highest.max())
    each = (pressure * towards)[:, used] / highest[used]
    both, seen = np.vstack([each.real, each.imag]), np.concatenate([aside.real, aside.imag])
    moved, _, rank, _ = np.linalg.lstsq(both, seen, rcond=1e-2)
    if rank < len(used) or len(used) < 3 or not (moved > 0).all() or _agreement(aside, each @ moved).real < ALIKE:
        return ""
    factor = moved / highest[used]
    factor /= np.median(factor)
    odd = int(np.argmax(np.abs(np.log(factor))))
    # units differ by a factor of 6.9 or more
    if max(factor[odd], 1 / factor[odd]) < 4.0:
        return ""
    return (
        f"column p{used[odd] + 1}: the tip moves {factor[odd]:.2g} times as far for the same {words.pressure} as with the "
        f"other {words.actuators}: check {'whether it is connected, ' if factor[odd] < NOTHING else ''}its unit and scale"
    )
