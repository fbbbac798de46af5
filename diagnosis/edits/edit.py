"""Edits: possible mistakes in robot.yaml or a table, each with its prior and few parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from model.robot import Marker, Robot
from model.rotation import CONJUGATE, from_vector, multiply, to_base
from recordings.trials import NO_MOUNT, ORIENTATION, TIP, Mapped, Table, marker_columns, pressure_columns

from ..arrays import Array, Ints
from ..data.campaign import tip_masses, tip_moments
from ..findings import Finding, finding

CALIBRATION = ("area_factor", "youngs_modulus", "azimuth", "gravity_x", "gravity_y", "origin_x", "origin_y", "origin_z")
"""Calibrated in every hypothesis within `EDIT_USUAL`: logarithms of factors, rad, robot lengths."""
AREA, MODULUS, AZIMUTH, GRAVITY, ORIGIN = 0, 1, 2, slice(3, 5), slice(5, 8)
WIDEST = float(np.log(20))
"""Of the logarithms of area factor and modulus where one of them is what is wrong."""
FORCE, MOMENT = ("force_x", "force_y", "force_z"), ("tip_moment_x", "tip_moment_y", "tip_moment_z")


@dataclass(frozen=True)
class Variants:
    """v variants of a robot.yaml and a table of n states, from which rods and tips follow."""

    robot: Robot
    table: Table
    area: Array
    """(v, 1) times the area factor."""
    modulus: Array
    """(v, 1) times all stiffnesses of the body."""
    bending: Array
    """(v, 1) times the bending stiffness alone, of a robot without spine."""
    stretch: Array
    """(v, 1) times the length."""
    azimuth: Array
    """(v, 1, actuators) deg."""
    arcs: Array
    """(v, 1, markers of robot.yaml) m from the base."""
    gravity: Array
    """(v, 1, 3) m/s^2."""
    mass: Array
    """(v, n) kg at the tip."""
    roll: Array
    """(v, n) deg."""
    pressure: Array
    """(v, n, actuators) Pa."""
    force: Array
    """(v, n, 3) N at the tip."""
    moment: Array
    """(v, n, 3) N m at the tip."""
    tip: Array
    """(v, n, 3) m."""
    orientation: Array
    """(v, n, 4) w, x, y, z; NaN where there is none."""
    markers: Array
    """(v, n, k, 3) m."""

    @classmethod
    def of(cls, robot: Robot, table: Table) -> Variants:
        """One variant: as described."""
        one = np.ones((1, 1))
        of_states = (tip_masses(robot, table), table.get("roll_deg", 0.0), table.pressures, table.tip_force,
                     tip_moments(robot, table), table.tip, table.orientation, table.markers)  # fmt: skip
        given = robot.actuators.azimuths_deg, robot.marker_places()[:, 2], robot.gravity
        of_robot = (np.array(values)[None, None] for values in given)
        return cls(robot, table, one, one, one, one, *of_robot, *(values[None] for values in of_states))

    def take(self, variants: slice | Ints) -> Variants:
        """Some of the variants, each as often as it is asked for."""
        return replace(self, **{name: a[variants] for name, a in self.arrays(ROD + SEEN).items()})

    @classmethod
    def stacked(cls, parts: Sequence[Variants]) -> Variants:
        """The variants of several, one after the other."""
        joined: dict[str, Any] = {name: np.concatenate([getattr(v, name) for v in parts]) for name in ROD + SEEN}
        return replace(parts[0], **joined)

    def arrays(self, names: Sequence[str]) -> dict[str, Any]:
        """Fields by name."""
        return {name: getattr(self, name) for name in names}

    def moved(self, shift: Array) -> Variants:
        """Places moved by (v, n or 1, 3) m."""
        return replace(self, tip=self.tip + shift, markers=self.markers + shift[:, :, None])

    def levered(self, sign: float) -> Variants:
        """The tip moved by +-1 times the map's `sensor`, which turns with it: 1 leads to the tracked point that edits act on."""
        sensor = np.array(Mapped.sensor if self.table.mapped is None else self.table.mapped.sensor)
        turn = np.where(np.isfinite(self.orientation), self.orientation, NO_MOUNT)
        return replace(self, tip=self.tip + sign * to_base(turn, sensor)) if sensor.any() else self

    def turned(self, turn: Array, sign: Array | None = None) -> Variants:
        """Places, orientations and forces turned by quaternions (v, 4), then mirrored by the signs (3,) of three axes."""
        q, signs = turn[:, None], np.ones(3) if sign is None else sign
        orientation = multiply(np.broadcast_to(q, self.orientation.shape), self.orientation)
        return replace(
            self,
            tip=to_base(q, self.tip) * signs,
            force=to_base(q, self.force) * signs,
            moment=to_base(q, self.moment) * signs * np.prod(signs),
            markers=to_base(q[:, :, None], self.markers) * signs,
            orientation=orientation * np.array([1.0, *signs * np.prod(signs)]),
        )

    def framed(self, turn: Array) -> Variants:
        """As turned by another `frame` in map.yaml, q (v, 4): the mount m there is along the base's axes, orientations o become
        q o m^-1 q^-1 m; without a map q o."""
        made, mapped = self.turned(turn), self.table.mapped
        if mapped is None or mapped.mount is None:
            return made
        mount = np.array(NO_MOUNT if self.table.moved_to_model else mapped.mount) / np.linalg.norm(mapped.mount)
        back = multiply(multiply(mount * CONJUGATE, turn * CONJUGATE), mount)
        return replace(made, orientation=multiply(made.orientation, back[:, None]))

    def with_gravity_turned(self, turn: Array) -> Variants:
        """Gravity turned in the base frame by quaternions (v, 4)."""
        return replace(self, gravity=to_base(turn[:, None], self.gravity))

    def calibrated(self, theta: Array) -> Variants:
        """With calibrations theta (v, 8)."""
        made = replace(
            self,
            area=self.area * np.exp(theta[:, [AREA]]),
            modulus=self.modulus * np.exp(theta[:, [MODULUS]]),
            azimuth=self.azimuth + np.degrees(theta[:, AZIMUTH])[:, None, None],
        ).with_gravity_turned(from_vector(np.pad(theta[:, GRAVITY], ((0, 0), (0, 1)))))
        return made.moved(-theta[:, None, ORIGIN] * self.robot.length)

    def written(self) -> tuple[Robot, Table]:
        """Robot and table of the first variant; unchanged parts are kept."""
        given, robot, columns = Variants.of(self.robot, self.table), self.robot, dict[str, Array]()
        changed = {name: values[0] for name, values in self.arrays(ROD + SEEN).items()
                   if not np.array_equal(values[0], getattr(given, name)[0], equal_nan=True)}  # fmt: skip
        if "azimuth" in changed:
            placed = robot.actuators.model_copy(update={"azimuths_deg": tuple(self.azimuth[0, 0].tolist())})
            robot = robot.model_copy(update={robot.actuators.words.kind: placed})
        if "modulus" in changed:
            robot = robot.with_modulus(float(self.modulus[0, 0]))
        if "bending" in changed and robot.bending_stiffness:
            robot = robot.model_copy(update={"bending_stiffness": robot.bending_stiffness * float(self.bending[0, 0])})
        if "area" in changed:
            factor, area = robot.area_factor, float(self.area[0, 0])
            areas = {k: v * area for k, v in factor.items()} if isinstance(factor, dict) else factor * area
            robot = robot.model_copy(update={"area_factor": areas})
        if "gravity" in changed:
            robot = robot.model_copy(update={"gravity": tuple(self.gravity[0, 0].tolist())})
        if "arcs" in changed:
            along = zip(robot.markers, self.arcs[0, 0].tolist(), strict=True)
            markers = tuple(m.model_copy(update={"arc_length": s}) if isinstance(m, Marker) else s for m, s in along)
            robot = robot.model_copy(update={"markers": markers})
        if "stretch" in changed:
            ratio, drive = float(self.stretch[0, 0]), robot.actuators
            ends: dict[str, Any] = {drive.words.kind: drive.model_copy(update={"ends": tuple(ratio * s for s in drive.ends)})}
            sections = tuple(part.model_copy(update={"length": ratio * part.length}) for part in robot.sections)
            robot = robot.model_copy(update={"length": ratio * robot.length, "sections": sections, **ends})
        names: dict[str, Sequence[str]] = {"tip": TIP, "orientation": ORIENTATION, "force": FORCE, "moment": MOMENT,
                                           "mass": ("tip_mass",), "roll": ("roll_deg",),
                                           "pressure": pressure_columns(self.pressure.shape[2]),
                                           "markers": sum(marker_columns(self.markers.shape[2]), ())}  # fmt: skip
        for name in names.keys() & changed:
            columns |= zip(names[name], changed[name].reshape(len(self.table), -1).T, strict=True)
        return robot, self.table.replaced(columns)


def times(factor: float, *names: str) -> Callable[[Variants, Array], Variants]:
    """What makes some fields of `Variants` larger by a factor, whatever the parameters are."""
    return lambda v, _: replace(v, **{name: factor * values for name, values in v.arrays(names).items()})


ROD = ("area", "modulus", "bending", "stretch", "azimuth", "arcs", "gravity", "mass", "roll", "pressure", "force", "moment")
"""Fields of `Variants` that change the rod."""
SEEN = ("tip", "orientation", "markers")
"""Those that were measured of it."""


Mistake = tuple[str, dict[str, Any]]
"""Code and values of a finding; among them `short`, a template of what is changed in the robot's words."""
Says = Callable[[Robot, Array, Array], Sequence[Mistake]]
"""Robot as described, calibration (8,), own parameters -> what to state; nothing where nothing is changed."""


def mistake(code: str, short: str, **values: Any) -> Mistake:
    """A finding to state; its probability and what else it may be follow in `Edit.findings`."""
    return code, {**values, "short": short}


def stating(code: str, short: str, *first: Mistake, **values: Any) -> Says:
    """State a finding with these values, after some `first`, whatever the parameters are."""
    return lambda *_: [*first, mistake(code, short, **values)]


@dataclass(frozen=True)
class Edit:
    """One possible mistake in a description. Edits of one `kind` concern the same quantity and exclude each other."""

    kind: str
    prior: float
    says: Says = field(default=lambda *_: (), repr=False)
    apply: Callable[[Variants, Array], Variants] = field(default=lambda v, _: v, repr=False)
    """What would be written without the mistake, of own parameters (v, k)."""
    starts: tuple[tuple[float, ...], ...] = ((),)
    """Of the numbers that it widens, then of its own."""
    bounds: tuple[tuple[float, float], ...] = ()
    """Of its own parameters."""
    widens: Mapping[int, float] = field(default_factory=dict)
    """Number of the calibration -> its bound."""
    enlarges: float = 1.0
    """Factor by which it makes places, and so their errors, larger: these count as they were before."""
    left: bool = False
    """Whether the diagnosis names it, so that nothing is changed."""
    of_this_campaign: bool = False
    """Whether another campaign on the robot is without it."""

    def findings(self, robot: Robot, theta: Array, own: Array, p: float = 0.0, rather: str = "") -> list[Finding]:
        """State it, with its probability and, at the end, what else it may be (text); empty where nothing is changed."""
        words, every = robot.actuators.words, self.says(robot, theta, own)
        texts = [""] * (len(every) - 1) + [rather]
        return [
            finding(code, words, **values | {"short": words.fill(values["short"]), "p": p, "rather": text})
            for (code, values), text in zip(every, texts, strict=False)
        ]
