"""What to ask about a robot.yaml and a table of trials that may be right: nothing is refused here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from ..errors import BadCase
from .case import CaseLike, states
from .first_calibration import upside_down
from .plausible_directions import doubtful_directions
from .plausible_robot import doubtful_numbers


def doubtful(case: CaseLike, robot_name: str) -> tuple[str, ...]:
    """One message for each doubt; `robot_name`: where the robot was read."""
    numbers = tuple(f"{robot_name}: {text}" for text in doubtful_numbers(case.robot))
    directions = doubtful_directions(case.robot, case.table)
    return (*numbers, *directions, *(() if directions else _gravity(case, robot_name)))


def _gravity(case: CaseLike, robot_name: str) -> Iterator[str]:
    """Whether the tips fit gravity reversed clearly better."""
    with suppress(BadCase):
        found = upside_down(case.robot, states(case)[0])
        if found is not None:
            given, reversed_ = (1e3 * m for m in found)
            gravity = ", ".join(f"{g:g}" for g in case.robot.gravity)
            yield (
                f"{robot_name}: gravity [{gravity}] m/s^2: the tips fit gravity reversed clearly better ({reversed_:.2g} mm rms "
                f"instead of {given:.2g} mm): does it point down in the base frame, whose z points from base to tip, and is the "
                "frame the right way round?"
            )
