"""A serial arm of revolute joints: its description, where its tool is, and what may be wrong with it.

description   Arm: Denavit-Hartenberg numbers, base, tool, masses; load_arm reads arm.yaml
kinematics    motions from the tool to the base, and their derivatives; torques of gravity
causes        what may be wrong, and ArmModel: positions and their derivatives by named parameters
poses         whether measured poses can be the arm's own, and where its base stands among them
"""

from model.arm.causes import ArmModel
from model.arm.description import Arm, arm_from_dict, load_arm
from model.arm.kinematics import gravity_torques
from model.arm.poses import placed, poses_within, weighed

__all__ = ["Arm", "ArmModel", "arm_from_dict", "gravity_torques", "load_arm", "placed", "poses_within", "weighed"]
