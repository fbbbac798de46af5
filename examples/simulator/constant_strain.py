"""A simulator of one's own, of another kind than the rod: segments of constant strain, as many models of soft robots have them.

Strain of a segment is what force and moment at its middle, in the shape found so far, ask of its stiffness; from the strains
follows the shape, and so on until both agree (Anderson's mixing). Four segments: up to 3 mm from the rod.

    lab diagnose CASE --simulator examples/simulator/constant_strain.py
"""

import numpy as np
from scipy.spatial.transform import Rotation

from model.simulators import Readings, rods_at

SEGMENTS, ROUNDS, CLOSE = 4, 300, 1e-10


class ConstantStrain:
    parameters = ("area.excess",)

    def __init__(self, robot):
        self.robot = robot

    def predict(self, states, parameters):
        rods = rods_at(self.robot, states, parameters)
        return Readings(np.array([tip(rods, i) for i in range(len(states))]))


def tip(rods, i):
    """(3,) m of rod i; NaN where shape and strain do not come to agree."""
    each = rods.whole_length[i] / SEGMENTS
    within = rods.shares(i, each * np.arange(SEGMENTS + 1))

    def along(name, power=1):
        return (within @ rods.field(name)[i] ** power) ** power

    bend, stretch, load = along("bend_stiffness", -1), along("stretch_stiffness", -1), each * along("load")
    curved, stretched = along("rest_curvature"), along("rest_strain")
    force, moment, dead, about_tip = (rods.field(name)[i] for name in ("tip_force", "tip_moment", "dead_force", "dead_moment"))

    def strains_of(strains):
        turns, places = shape(strains, each)
        middle, where = turns[1::2], places[1::2]
        cut = turns[-1] @ force + dead + np.cumsum(load[::-1], axis=0)[::-1] - 0.5 * load
        arm = places[-1] - where
        about = turns[-1] @ moment + about_tip + np.cross(arm, turns[-1] @ force + dead)
        for k in range(SEGMENTS):  # the weight of all that is beyond
            about[k] += np.cross(where[k + 1 :] - where[k], load[k + 1 :]).sum(axis=0)
        into = middle.transpose(0, 2, 1)
        u = (into @ about[..., None])[..., 0] / bend + curved
        v = (into @ cut[..., None])[..., 0] / stretch + stretched
        return np.hstack([u, v]).ravel()

    x, steps, changes = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], SEGMENTS), [], []
    for _ in range(ROUNDS):
        change = strains_of(x) - x
        if np.abs(change).max() < CLOSE:
            return shape(x, each)[1][-1]
        steps, changes = [*steps, x][-8:], [*changes, change][-8:]
        mixed = change
        if len(steps) > 1:
            by = np.linalg.lstsq(np.diff(changes, axis=0).T, change, rcond=None)[0]
            mixed = change - (np.diff(steps, axis=0).T + np.diff(changes, axis=0).T) @ by
        x = x + np.clip(mixed, -2.0, 2.0)
    return np.full(3, np.nan)


def shape(strains, each):
    """Turns (2 n + 1, 3, 3) and places (2 n + 1, 3) at base, middles and ends of n segments."""
    u, v = strains.reshape(-1, 6)[:, :3], strains.reshape(-1, 6)[:, 3:]
    half = Rotation.from_rotvec(np.repeat(0.5 * each * u, 2, axis=0)).as_matrix()
    quarter = Rotation.from_rotvec(np.repeat(0.25 * each * u, 2, axis=0)).as_matrix()
    turns, places = [np.eye(3)], [np.zeros(3)]
    for a, b, c in zip(half, quarter, np.repeat(v, 2, axis=0), strict=True):
        places.append(places[-1] + 0.5 * each * turns[-1] @ b @ c)  # the middle's direction stands for the half
        turns.append(turns[-1] @ a)
    return np.array(turns), np.array(places)


SIMULATOR = ConstantStrain
