"""Where the example files of this project are."""

from __future__ import annotations

from pathlib import Path


def paper_robot() -> Path:
    """The robot.yaml of the paper's robot: examples/paper/robot.yaml, which an installed package holds as a copy."""
    return Path(__file__).with_name("paper_robot.yaml").resolve()
