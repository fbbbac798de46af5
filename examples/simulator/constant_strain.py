"""A simulator of one's own, of another kind than the rod: segments of constant strain, as many models of soft robots have them.

Strain of a segment is what force and moment at its middle, in the shape found so far, ask of its stiffness; from the strains
follows the shape, and so on until both agree (Anderson's mixing). Four segments: up to 3 mm from the rod.

    lab diagnose CASE --simulator examples/simulator/constant_strain.py
"""

import numpy as np
from scipy.spatial.transform import Rotation

from model.condition import conditions
from model.section import rods_of
from model.simulators import Readings

SEGMENTS, ROUNDS, CLOSE = 4, 300, 1e-10


class ConstantStrain:
    parameters = ("area.excess",)

    def __init__(self, robot):
        self.robot = robot

    def predict(self, states, parameters):
        at = conditions(self.robot, states.spine_length, states.pressure, states.tip_mass, states.roll, states.force)
        rods, push = rods_of(self.robot, at), 1.0 + parameters.get("area.excess", 0.0)
        return Readings(np.array([tip(rods, i, push) for i in range(len(states))]))


def tip(rods, i, push):
    """(3,) m of rod i; NaN where shape and strain do not come to agree."""
    length = rods.field("length")[i]
    each = length.sum() / SEGMENTS
    inner = np.clip(length[0] / each - np.arange(SEGMENTS), 0.0, 1.0)[:, None]

    def along(name, power):
        ends = rods.field(name)[i]
        return (inner * ends[0] ** power + (1 - inner) * ends[1] ** power) ** power

    bend, stretch, load = along("bend_stiffness", -1), along("stretch_stiffness", -1), each * along("load", 1)
    force, moment = push * rods.field("tip_force")[i], push * rods.field("tip_moment")[i]
    dead = rods.field("dead_force")[i]

    def strains_of(strains):
        turns, places = shape(strains, each)
        middle, where = turns[1::2], places[1::2]
        cut = turns[-1] @ force + dead + np.cumsum(load[::-1], axis=0)[::-1] - 0.5 * load
        arm = places[-1] - where
        about = turns[-1] @ moment + np.cross(arm, turns[-1] @ force + dead)
        for k in range(SEGMENTS):  # the weight of all that is beyond
            about[k] += np.cross(where[k + 1 :] - where[k], load[k + 1 :]).sum(axis=0)
        into = middle.transpose(0, 2, 1)
        u = (into @ about[..., None])[..., 0] / bend
        v = (into @ cut[..., None])[..., 0] / stretch + [0.0, 0.0, 1.0]
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
