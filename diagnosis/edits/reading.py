"""What is wrong in a table or its robot.yaml as they are read: refused where the table is not in SI units and in the base frame,
else asked about."""

from __future__ import annotations

from model.robot import Robot
from recordings.trials import Table

from ..data.plausible import contradicting_attitudes, implausible_values
from ..errors import BadCase
from .beam import wrong_units


def refused(robot: Robot, table: Table) -> tuple[str, ...]:
    """One message for each thing that is wrong beyond doubt: column, value, what it looks like, what to write."""
    return (*implausible_values(robot, table), *map(str, wrong_units(robot, table)))


def require_readable(robot: Robot, table: Table, name: str = "") -> None:
    """Raises `BadCase`, one line for each thing that is refused, each beginning with `name` (file or files)."""
    if found := (*refused(robot, table), *contradicting_attitudes(robot, table)):
        raise BadCase("\n".join(f"{name}: {text}" if name else text for text in found))
