"""Where the example files of this project are."""

from __future__ import annotations

from pathlib import Path


def paper_robot() -> Path:
    """The robot.yaml of the paper's robot."""
    return Path(__file__).parent.parent.parent / "examples" / "paper" / "robot.yaml"
