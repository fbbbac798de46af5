"""The robot behind the fake instruments: a discrete rod with physics of its own, see docs/explanations/virtual-robot.md."""

from .effects import EffectInfo, draw_effect, list_effects
from .robot import VirtualRobot
from .rod import NoEquilibrium
from .schedule import Condition, VirtualReading, walk
from .truth import RobotTruth

__all__ = [
    "Condition",
    "EffectInfo",
    "NoEquilibrium",
    "VirtualReading",
    "RobotTruth",
    "VirtualRobot",
    "draw_effect",
    "list_effects",
    "walk",
]
