"""Why the paper's chamber area grows from 1.5 to 2.4 with the spine: how eq. 10 mixes the spine in.

Eq. 10 mixes Young's moduli by volume and gives the mixture the second moment of the wall: the spine, which lies on the axis,
is credited with bending stiffness as if its material lay out in the wall. A composite section adds stiffnesses instead,

    E_c I_c + E_s I_s,   E_c A_c + E_s A_s

(areas and second moments of wall and spine, each about the axis). The paper's own calibrated curves serve as data here.

Two readings of the pressure load are computed side by side, because the millimetres depend on them: eq. 4 and 5 as printed
(force and moment at the tip), and the moment alone (the gas also presses on the curved walls, which balances the force).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from model.condition import States
from model.robot import Robot
from model.rods import FINE, Rods, solve
from model.section import (
    INNER,
    OUTER,
    annulus_second_moment,
    body_area,
    body_second_moment,
    combined_modulus,
    rods_of,
)

Array = NDArray[np.float64]
READINGS = ("force and moment (eq. 4, 5 as printed)", "moment alone (walls balanced)")


@dataclass(frozen=True)
class Reading:
    """The curves refitted under one reading of the pressure load. Factors are A_effect / A_norm."""

    name: str
    one_factor_volume: float
    rms_volume: float
    """m, one factor, moduli mixed by volume."""
    one_factor_area: float
    rms_area: float
    """m, one factor, stiffnesses added."""
    needed: Array
    """(l,) factor each spine length needs when stiffnesses are added."""
    credit: float
    """Share of the credited spine stiffness that one factor for all lengths asks for."""
    credit_factor: float
    rms_credit: float
    """m, with the spine's modulus times `credit` in eq. 10 and one factor."""

    def as_dict(self) -> dict[str, object]:
        """JSON-able; m."""
        return {
            "reading": self.name,
            "volume": {"one_factor": self.one_factor_volume, "rms": self.rms_volume},
            "area_moments": {"one_factor": self.one_factor_area, "rms": self.rms_area, "needed": self.needed.tolist()},
            "weaker_spine": {"share": self.credit, "one_factor": self.credit_factor, "rms": self.rms_credit},
        }


@dataclass(frozen=True)
class AreaFindings:
    """Both readings, and what does not depend on them."""

    lengths: Array
    published: Array
    """(l,) the paper's factors."""
    stiffness_ratio: Array
    """(l,) bending stiffness of the part with spine: mixed by volume / added."""
    predicted_credit: float
    """Share of the credited contribution that area moments leave: A-independent, I_s / (volume share of the spine * I_c)."""
    readings: tuple[Reading, ...]

    def growth(self, factors: Array) -> tuple[float, float]:
        """Largest over smallest factor, and slope of a straight line per 10 cm of spine."""
        slope = float(np.polyfit(self.lengths, factors, 1)[0])
        return float(factors.max() / factors.min()), 0.1 * slope

    def sentences(self) -> tuple[str, ...]:
        """What may be said: first what holds under both readings, then what does not."""
        ratio, slope = self.growth(self.published)
        credits = [r.credit for r in self.readings]
        after = [self.growth(r.needed) for r in self.readings]
        shares = [1 - s / slope for _, s in after]
        weak = ", ".join(f"{r.rms_credit * 1e3:.1f}" for r in self.readings)
        area = ", ".join(f"{r.rms_area * 1e3:.1f}" for r in self.readings)
        lines = [
            "Robust (both readings of the pressure load): adding stiffnesses instead of mixing moduli removes "
            f"{min(shares):.0%} to {max(shares):.0%} of the growth of A_eff, and the curves require {min(credits):.2f} to "
            f"{max(credits):.2f} of the stiffness credited to the spine; area moments predict "
            f"{self.predicted_credit:.2f}. The spine is credited with about {1 / max(credits):.1f} to {1 / min(credits):.1f} "
            "times its bending contribution.",
            "Not shown: that area moments are the cause. A weak, leaking or thin spine of the same share explains it as "
            f"well or better ({weak} mm rms against {area} mm); the share is identified, not its cause.",
        ]
        for r, (r_ratio, r_slope) in zip(self.readings, after, strict=True):
            lines.append(
                f"Depends on the reading, {r.name}: with one factor {r.rms_volume * 1e3:.1f} mm rms mixed by volume, "
                f"{r.rms_area * 1e3:.1f} mm added (factor {r.one_factor_area:.2f}); largest over smallest factor {ratio:.2f} -> "
                f"{r_ratio:.2f}, slope {slope:+.3f} -> {r_slope:+.3f} per 10 cm."
            )
        return tuple(lines)

    def as_dict(self) -> dict[str, object]:
        """JSON-able; m."""
        return {
            "spine_lengths": self.lengths.tolist(),
            "published_factor": self.published.tolist(),
            "stiffness_ratio_volume_over_area": self.stiffness_ratio.tolist(),
            "predicted_share_of_spine": self.predicted_credit,
            "readings": [r.as_dict() for r in self.readings],
            "said": list(self.sentences()),
        }


def area_findings(robot: Robot, states: States) -> AreaFindings:
    """Refit the paper's curves, all states of Fig. 5. Raises ValueError without a spine, `SolveFailed` when a state fails."""
    if robot.spine is None:
        raise ValueError("the robot has no spine: eq. 10 has nothing to mix in")
    lengths = np.array([length for length, _ in states.by_spine_length()])
    added = _added_bending(robot, lengths)
    volume_share = np.pi * robot.spine.radius**2 / (np.pi * robot.spine.radius**2 + body_area(robot))
    return AreaFindings(
        lengths=lengths,
        published=robot.area_factor_at(lengths),
        stiffness_ratio=combined_modulus(robot, lengths) * body_second_moment(robot) / added,
        predicted_credit=annulus_second_moment(robot.spine.radius) / (volume_share * body_second_moment(robot)),
        readings=tuple(_reading(robot, states, name, force) for name, force in zip(READINGS, (True, False), strict=True)),
    )


def _reading(robot: Robot, states: States, name: str, with_force: bool) -> Reading:
    curves = _tips(_actuated(rods_of(robot, states), with_force))
    unit = robot.with_area_factor(1.0)
    volume = _actuated(rods_of(unit, states), with_force)
    added = _with_added_stiffness(unit, states, volume)
    one_volume, rms_volume = _one_factor(volume, curves)
    one_area, rms_area = _one_factor(added, curves)
    needed = np.array([_one_factor(added[own], curves[own])[0] for _, own in states.by_spine_length()])

    def weaker(x: Array) -> Rods:
        return _scaled(_actuated(rods_of(_weaker_spine(unit, float(x[1])), states), with_force), float(x[0]))

    found = least_squares(
        lambda x: (_tips(weaker(x)) - curves).ravel(), [one_area, 0.5], bounds=([0.2, 0.05], [5, 2]), diff_step=1e-4
    )
    return Reading(
        name, one_volume, rms_volume, one_area, rms_area, needed, float(found.x[1]), float(found.x[0]),
        _rms(_tips(weaker(found.x)) - curves),
    )  # fmt: skip


def _actuated(batch: Rods, with_force: bool) -> Rods:
    return batch if with_force else batch.changed(tip_force=0.0)


def _scaled(batch: Rods, factor: float) -> Rods:
    """The same rods with `factor` times the chambers' area."""
    force, moment = batch.field("tip_force"), batch.field("tip_moment")
    return batch.changed(tip_force=factor * force, tip_moment=factor * moment)


def _tips(batch: Rods) -> Array:
    return solve(batch, FINE).trusted().tip


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(distance**2, axis=1))))


def _one_factor(batch: Rods, curves: Array) -> tuple[float, float]:
    """The factor that brings all tips closest to the curves (n, 3) m, and the rms distance left, m."""
    found = least_squares(lambda x: (_tips(_scaled(batch, float(x[0]))) - curves).ravel(), [1.6], bounds=(0.2, 5), diff_step=1e-4)
    factor = float(found.x[0])
    return factor, _rms(_tips(_scaled(batch, factor)) - curves)


def _weaker_spine(robot: Robot, share: float) -> Robot:
    spine = robot.spine
    if spine is None:
        return robot
    modulus = {length: share * e for length, e in spine.modulus.items()}
    return robot.model_copy(update={"spine": spine.model_copy(update={"modulus": modulus})})


def _added_bending(robot: Robot, lengths: Array) -> Array:
    """E_c I_c + E_s I_s (N m^2) at spine lengths (m); the wall alone at 0."""
    wall = robot.youngs_modulus * body_second_moment(robot)
    if robot.spine is None:
        return np.full(lengths.shape, wall)
    spine = robot.spine.modulus_at(lengths) * annulus_second_moment(robot.spine.radius)
    return np.where(lengths > 0, wall + spine, wall)


def _with_added_stiffness(robot: Robot, states: States, batch: Rods) -> Rods:
    """The rods with stiffnesses of wall and spine added in the part that holds the spine; shear keeps the wall's G/E."""
    if robot.spine is None:
        return batch
    stretch, bend = batch.field("stretch_stiffness").copy(), batch.field("bend_stiffness").copy()
    added = _added_bending(robot, states.spine_length) / (robot.youngs_modulus * body_second_moment(robot))
    area = np.pi * robot.spine.radius**2 * robot.spine.modulus_at(states.spine_length) * (states.spine_length > 0)
    stretched = 1 + area / (robot.youngs_modulus * body_area(robot))
    stretch[:, INNER] = stretch[:, OUTER] * stretched[:, None]
    bend[:, INNER] = bend[:, OUTER] * added[:, None]
    return batch.changed(stretch_stiffness=stretch, bend_stiffness=bend)
