"""The robot as robot.yaml describes it: geometry, material, chambers, spine.

Frame: the rod's z axis points from the base to the tip; chamber i sits at path_radius * (cos az, sin az, 0).
SI units throughout; every field carries its unit in `json_schema_extra`, a table also that of its keys as `key_unit`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, Field, FiniteFloat, Tag, ValidationInfo, field_validator, model_validator

from model.actuators import PULL_AREA, Chambers, Tendons
from model.arrays import Array
from model.errors import BadRobot
from model.plain_yaml import FORM, FileTable, checked, loaded, unit_at
from model.rotation import rolled
from model.sections import Positive, Section, Weight, section_problems
from model.shown import Shown
from model.stated import AREA_FACTOR, Noise, Posterior, Residual, Stated, Table, named, problems

MOST_BEYOND = np.log(2.0)
"""Logarithm of the factor on an end entry that is approached far beyond it."""


def smooth_at(table: tuple[tuple[float, float], ...], length: Array) -> Array:
    """Positive values at lengths (...) of a table of (length, value), sorted by length, without kinks.

    A robot stands at the very lengths of its table, and a search for the most probable length would end on a kink. So between
    entries the curve is a monotone cubic (PCHIP, Fritsch and Carlson 1980). Beyond them it continues with its slope there and
    levels off: y = y_e exp(w tanh(s (l - l_e) / (w y_e))), w = ln 2, always between half and twice the end entry y_e.

    >>> smooth_at(((0.1, 1e6), (0.2, 2e6)), np.array([0.1, 0.15, 0.2])).tolist()
    [1000000.0, 1500000.0, 2000000.0]
    """
    if len(table) < 2:
        return np.full(length.shape, table[0][1])
    x, y, slope = _curve(table)
    inside = np.clip(length, x[0], x[-1])
    k = np.clip(np.searchsorted(x, inside, side="right") - 1, 0, len(x) - 2)
    h, rise = x[k + 1] - x[k], y[k + 1] - y[k]
    s, a, b = (inside - x[k]) / h, h * slope[k], h * slope[k + 1]
    curve = y[k] + s * (a + s * (3 * rise - 2 * a - b + s * (a + b - 2 * rise)))
    steep = np.where(length < x[0], slope[0] / y[0], slope[-1] / y[-1]) / MOST_BEYOND
    return np.asarray(curve * np.exp(MOST_BEYOND * np.tanh(steep * (length - inside))))


@lru_cache(maxsize=64)
def _curve(table: tuple[tuple[float, float], ...]) -> tuple[Array, Array, Array]:
    """Lengths and values (n,) of a table, and slopes there: harmonic means, 0 at an extremum; at the ends by three points."""
    x, y = np.array(table).T
    h, m = np.diff(x), np.diff(y) / np.diff(x)
    slope = np.full(len(x), m[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        means = 3 * (h[1:] + h[:-1]) / ((2 * h[1:] + h[:-1]) / m[:-1] + (h[1:] + 2 * h[:-1]) / m[1:])
    slope[1:-1] = np.where(m[1:] * m[:-1] > 0, means, 0.0)
    for e, f in ((0, 1), (-1, -2)) if len(x) > 2 else ():
        steep = ((2 * h[e] + h[f]) * m[e] - h[e] * m[f]) / (h[e] + h[f])
        turns = m[e] * m[f] < 0 and abs(steep) > 3 * abs(m[e])
        slope[e] = 0.0 if steep * m[e] <= 0 else 3 * m[e] if turns else steep
    return x, y, slope


Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

LengthKey = Annotated[FiniteFloat, Field(ge=0, le=5, json_schema_extra={"unit": "m"})]
Modulus = Annotated[FiniteFloat, Field(ge=1e3, le=1e12, json_schema_extra={"unit": "Pa"})]
Gravity = Annotated[FiniteFloat, Field(ge=-30, le=30)]
Factor = Annotated[FiniteFloat, Field(gt=0, le=20, json_schema_extra={"unit": "1"})]

ArcLength = Annotated[FiniteFloat, Field(gt=0, le=5)]
FromAxis = Annotated[FiniteFloat, Field(ge=-1, le=1)]

MostPressure = Annotated[FiniteFloat, Field(ge=1e3, le=2e6)]
MostTension = Annotated[FiniteFloat, Field(gt=0, le=200)]
PressureOrList = Annotated[Annotated[MostPressure, Tag("number")] | Annotated[tuple[MostPressure, ...], Tag("list")], FORM]
TensionOrList = Annotated[Annotated[MostTension, Tag("number")] | Annotated[tuple[MostTension, ...], Tag("list")], FORM]

LIMITS = {"max_pressure", "max_tension"}
STATED = ("effects", "tolerances")
"""Tables of robot.yaml of which `Robot.stated` has each value."""
THRUST = "chamber_thrust"
"""The effect that describes thrust on the side walls."""
NumberOrTable = Annotated[Annotated[Factor, Tag("number")] | Annotated[dict[LengthKey, Factor], Tag("table")], FORM]


class Spine(FileTable):
    """The jammed growing spine; `modulus` is its apparent Young's modulus by spine length."""

    radius: FiniteFloat = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    modulus: dict[LengthKey, Modulus] = Field(min_length=1, json_schema_extra={"unit": "Pa", "key_unit": "m"})

    def modulus_at(self, spine_length: ArrayLike) -> Array:
        """Young's modulus (Pa) at spine length (m), see `model.robot`."""
        return smooth_at(tuple(sorted(self.modulus.items())), np.asarray(spine_length, float))


class Marker(FileTable):
    """A marker beside the body's axis, fixed to a section."""

    arc_length: ArcLength = Field(json_schema_extra={"unit": "m"})
    offset: tuple[FromAxis, FromAxis] = Field(json_schema_extra={"unit": "m"})
    """From the axis, along the base's x and y while the robot is straight and not rolled."""


NumberOrMarker = Annotated[Annotated[ArcLength, Tag("number")] | Annotated[Marker, Tag("table")], FORM]


class Pose(FileTable):
    """Where the base sits in the world: position (m) and orientation (unit quaternion w, x, y, z)."""

    position: Vector3 = Field(json_schema_extra={"unit": "m"})
    orientation: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] = Field(
        default=(1.0, 0.0, 0.0, 0.0), json_schema_extra={"unit": "1"}
    )

    @model_validator(mode="after")
    def _unit_quaternion(self) -> Pose:
        norm = math.sqrt(sum(q * q for q in self.orientation))
        if abs(norm - 1) > 1e-3:
            raise ValueError(f"orientation is a quaternion of norm {norm:.6g}, must be 1 within 0.001: normalise it")
        return self


class Uncertainty(FileTable):
    """Standard deviations of numbers of robot.yaml and of the set-up."""

    youngs_modulus: FiniteFloat | None = Field(default=None, gt=0, le=2, json_schema_extra={"unit": "1"})
    """Share of the value; usual 2 %."""
    axial_stiffness: FiniteFloat | None = Field(default=None, gt=0, le=2, json_schema_extra={"unit": "1"})
    """Share of the value, beside that of `youngs_modulus`; usual 0."""
    density: FiniteFloat | None = Field(default=None, gt=0, le=2, json_schema_extra={"unit": "1"})
    """Share of the value; usual 1 %."""
    area_factor: FiniteFloat | None = Field(default=None, gt=0, le=2, json_schema_extra={"unit": "1"})
    """Share of the value; usual 50 %."""
    length: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Usual 0.4 % of it."""
    path_radius: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Usual 0."""
    azimuths: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "rad"})
    """Of each chamber or tendon; usual 0."""
    pressure_gain: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "1"})
    """Share of each pressure or tension; usual 0."""
    pressure_zero: FiniteFloat | None = Field(default=None, gt=0, le=1e6, json_schema_extra={"unit": "Pa"})
    """Of each, at rest too; usual 0."""
    tip_mass: FiniteFloat | None = Field(default=None, gt=0, le=50, json_schema_extra={"unit": "kg"})
    """Usual 0."""
    tilt: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "rad"})
    """Of the base about x and y; usual 0.1 deg."""
    frame_turn: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "rad"})
    """Of the cameras' frame about each axis; usual 0.1 deg."""
    frame_shift: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Of its origin along each axis; usual 0.4 % of the length."""
    tracked_turn: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "rad"})
    """Of the tracked body, about each axis; usual 3 deg."""
    tracked_shift: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Of the tracked point, along each axis of the tip; usual 0."""
    marker_shift: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Of each marker, along each axis; usual 0."""
    push_place: FiniteFloat | None = Field(default=None, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Of where the stand's probe pushes, along the specimen; usual 0, or `stand.position_sd` of rig.yaml."""

    @property
    def stated(self) -> dict[str, float]:
        """Tolerance -> standard deviation, of those that are stated."""
        return {name: value for name in type(self).model_fields if (value := getattr(self, name)) is not None}


class Robot(Shown, FileTable):
    """The soft robot of one case; how its values enter the equations: docs/explanations/model.md."""

    predict: ClassVar[Callable[..., Any]]
    inverse: ClassVar[Callable[..., Any]]
    """`lab.predict` and `lab.inverse`, once `lab` is imported."""

    name: str = Field(min_length=1, max_length=200)
    length: FiniteFloat = Field(gt=0, le=5, json_schema_extra={"unit": "m", "uncertainty": "length"})
    outer_radius: FiniteFloat = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    inner_radius: FiniteFloat = Field(ge=0, le=1, json_schema_extra={"unit": "m"})
    density: FiniteFloat = Field(ge=0, le=20_000, json_schema_extra={"unit": "kg/m^3", "uncertainty": "density"})
    youngs_modulus: FiniteFloat = Field(ge=1e3, le=1e12, json_schema_extra={"unit": "Pa", "uncertainty": "youngs_modulus"})
    """`505e3 +- 30 %` also states its uncertainty."""
    shear_modulus: FiniteFloat = Field(ge=1e2, le=1e12, json_schema_extra={"unit": "Pa"})
    tip_mass: FiniteFloat = Field(ge=0, le=50, json_schema_extra={"unit": "kg", "uncertainty": "tip_mass"})
    tip_mass_place: FiniteFloat = Field(default=0.0, ge=-1, le=1, json_schema_extra={"unit": "m"})
    """Where it hangs, beyond the tip."""
    tip_moment: Vector3 = Field(default=(0.0, 0.0, 0.0), json_schema_extra={"unit": "N m"})
    """Known moment on the tip, base frame; columns tip_moment_x .. of a table override it."""
    gravity: tuple[Gravity, Gravity, Gravity] = Field(json_schema_extra={"unit": "m/s^2"})
    bending_stiffness: Positive | None = Field(default=None, json_schema_extra={"unit": "N m^2", "uncertainty": "youngs_modulus"})
    """EI of the body, in place of that from E and radii; `+- 15 %` is the uncertainty that all stiffnesses share."""
    axial_stiffness: Positive | None = Field(default=None, json_schema_extra={"unit": "N", "uncertainty": "axial_stiffness"})
    """EA of the body, likewise; `+- 6 %` states one of its own."""
    torsional_stiffness: Positive | None = Field(default=None, json_schema_extra={"unit": "N m^2"})
    """GJ of the body, likewise; unless given twice EI, with `thrust: walls` 2 G I."""
    mass_per_length: Weight | None = Field(default=None, json_schema_extra={"unit": "kg/m"})
    """Of the body, likewise."""
    sections: tuple[Section, ...] = Field(default=(), max_length=32)
    """Parts from base to tip."""
    chambers: Chambers | None = None
    tendons: Tendons | None = None
    """In place of chambers."""
    area_factor: NumberOrTable = Field(json_schema_extra={"unit": "1", "key_unit": "m", "uncertainty": "area_factor"})
    """Effective over drawn area of a chamber, one number or by spine length; of tendons the share of the tension that arrives."""
    thrust: Literal["cap", "walls"] | None = None
    """What takes the chambers' thrust: a cap where the longest chamber ends, or the side walls, which always carry that of
    chambers ending more than an outer radius before. Unless stated, a diagnosis settles it."""
    spine: Spine | None = None
    markers: tuple[NumberOrMarker, ...] = Field(default=(), json_schema_extra={"unit": "m"})
    """Arc lengths, or tables of those beside the axis."""
    base_to_world: Pose | None = None
    """For the record alone; a map.yaml states it by `frame`, and by `zero` of columns x, y, z."""
    max_pressure: PressureOrList | None = Field(default=None, json_schema_extra={"unit": "Pa"})
    """Highest pressure (gauge) of its chambers, of all or of each; nothing is inflated without it."""
    max_tension: TensionOrList | None = Field(default=None, json_schema_extra={"unit": "N"})
    """Highest tension of its tendons, of all or of each, in place of `max_pressure`."""
    quoted_pressure: FiniteFloat | None = Field(default=None, gt=0, le=2e6, json_schema_extra={"unit": "Pa"})
    """Gauge pressure at which `effects` that grow with it are stated; `max_pressure` unless given."""
    quoted_time: FiniteFloat | None = Field(default=None, gt=0, le=1e6, json_schema_extra={"unit": "s"})
    """Pace of the campaign to which `effects` with memory were fitted, of which their relaxation times are multiples."""
    uncertainty: Uncertainty = Uncertainty()
    """How well its numbers are known."""
    effects: Table = Field(default={})
    """Causes that are part of this robot: effect -> parameter -> value, sd, unit."""
    tolerances: Table = Field(default={})
    """The same of the set-up (tilt, frame_turn, frame_shift) and the robot's own numbers."""
    obstacle_azimuth_deg: FiniteFloat | None = Field(default=None, ge=-360, le=360, json_schema_extra={"unit": "deg"})
    """Where the obstacle of `contact` stands, seen from the base; by default a diagnosis finds its side."""
    posterior: Posterior | None = None
    """Joint uncertainty of area factor, effects and tolerances."""
    residual: Residual | None = None
    """Learnt rest, part of predictions alone."""

    @model_validator(mode="before")
    @classmethod
    def _as_pressure(cls, data: Any) -> Any:
        given: list[Any] = [data.get(key) if isinstance(data, dict) else None for key in ("max_tension", "max_pressure")]
        tension, stated = ([*x] if isinstance(x, (list, tuple)) else [x] for x in given)
        if not all(isinstance(x, (int, float)) for x in [*tension, *(stated if given[1] is not None else ())]):
            return data  # each that is none is refused by its own field
        pressure = np.array(given[0]) / PULL_AREA
        if given[1] is not None and (len(stated) != pressure.size or not np.allclose(stated, pressure, atol=0.0)):
            raise ValueError("max_pressure and max_tension are both given: keep max_tension, in N, if the robot has tendons")
        return {**data, "max_pressure": pressure.tolist()}

    @field_validator("effects")
    @classmethod
    def _offset_as_pressure(cls, effects: Table, info: ValidationInfo) -> Table:
        """The offset of tensions, which may be stated in N, as tables have it."""
        offset = effects.get("pressure_offset", {}).get("offset")
        if offset is None or offset.unit != "N" or info.data.get("tendons") is None:
            return effects
        in_pascal = {"value": offset.value / PULL_AREA, "sd": offset.sd / PULL_AREA, "unit": "Pa"}
        return {**effects, "pressure_offset": {**effects["pressure_offset"], "offset": offset.model_copy(update=in_pascal)}}

    @model_validator(mode="after")
    def _fits_together(self) -> Robot:
        if (self.chambers is None) == (self.tendons is None):
            raise ValueError("a robot has either chambers or tendons: give one of these tables")
        found = self._own_problems()
        found += problems(self.effects, self.tolerances, self.posterior, not isinstance(self.area_factor, dict))
        numbers = len(self.actuators.azimuths_deg) + 5
        if self.residual and (wrong := [len(row) for row in self.residual.learnt if len(row) != numbers]):
            found.append(f"residual.learnt: a state of {wrong[0]} numbers, must have {numbers} with {numbers - 5} pressures")
        if found:
            raise ValueError("; ".join(found))
        return self

    def _own_problems(self) -> list[str]:
        """One line for each contradiction between sections, radii, densities, actuators and lengths."""
        kind = "chambers" if self.tendons is None else "tendons"
        actuators, count = self.actuators, len(self.actuators.azimuths_deg)
        given = {f"{kind}.{name}": getattr(actuators, name, None) for name in ("radius", "path_radius", "ends")}
        given |= {name: getattr(self, name) for name in ("max_tension" if self.max_tension else "max_pressure",)}
        lists = {name: len(x) for name, x in given.items() if isinstance(x, tuple) and (x or not name.endswith("ends"))}
        if wrong := [
            f"{name}: {n} values, must be one for each of {count} azimuths_deg" for name, n in lists.items() if n != count
        ]:
            return wrong
        radii = {
            "outer_radius": self.outer_radius, "inner_radius": self.inner_radius,
            "chamber_radius": math.sqrt(max(actuators.area, 0.0) / math.pi), "path_radius": float(np.mean(actuators.path_radius)),
        }  # fmt: skip
        spine = self.spine.radius if self.spine else None
        problems = [*section_problems(self.sections, self.length, radii, spine, actuators)]
        if self.tendons is not None and self.thrust is not None:
            problems.append("thrust: says nothing of a robot with tendons: leave it out")
        if self.tendons is None and self.max_tension is not None:
            problems.append("max_tension: says nothing of a robot with chambers: write max_pressure")
        if self.density == 0 and (self.mass_per_length or any(part.mass_per_length for part in self.sections)):
            problems.append("mass_per_length: needs a density above 0 kg/m^3, which its uncertainty is referred to")
        if self.tendons is not None and any(part.chamber_radius is not None for part in self.sections):
            problems.append("sections: chamber_radius says nothing of a robot with tendons: leave it out")
        most = max(map(abs, actuators.azimuths_deg))
        if most <= 2 * math.pi and most != round(most):
            problems.append(f"{kind}.azimuths_deg: {most:g} at most, must be in degrees: they look like rad, multiply by 57.2958")
        if self.area_factor == {}:
            problems.append("area_factor: the table is empty, give a number or at least one spine length")
        along = {
            f"{kind}.ends:": actuators.ends,
            "markers: arc length": self.marker_places()[:, 2].tolist(),
            "spine.modulus: spine length": self.spine.modulus if self.spine else (),
            "area_factor: spine length": self.area_factor if isinstance(self.area_factor, dict) else (),
        }
        for field, places in along.items():
            problems += [f"{field} {s:g} m is beyond length {self.length:g} m" for s in places if s > self.length * (1 + 1e-9)]
        return problems

    def area_factor_at(self, spine_length: ArrayLike) -> Array:
        """A_effect / A_norm at spine length (m): linear between table entries, constant beyond them.

        >>> robot = load_robot(Path("robot.yaml")).replace(area_factor={0.0: 1.0, 0.2: 1.4})
        >>> robot.area_factor_at([0.1, 0.3])
        array([1.2, 1.4])
        """
        table = sorted(self.area_factor.items()) if isinstance(self.area_factor, dict) else [(0.0, self.area_factor)]
        return np.interp(np.asarray(spine_length, float), *np.array(table).T)

    def marker_places(self, roll: ArrayLike = 0.0) -> Array:
        """(.., markers, 3) m where its markers are while it is straight, mounted rolled by `roll` (..) rad: x, y, arc length."""
        given = [(*m.offset, m.arc_length) if isinstance(m, Marker) else (0.0, 0.0, m) for m in self.markers]
        x, y, along = np.reshape(given, (-1, 3)).T
        return np.stack(np.broadcast_arrays(*rolled(np.asarray(roll)[..., None], x, y), along), axis=-1)

    @property
    def actuators(self) -> Chambers | Tendons:
        """What bends it."""
        found = self.chambers or self.tendons
        assert found is not None  # one of them is there, or the file was refused
        return found

    @property
    def pressure_limits(self) -> Array:
        """(actuators,) Pa, the highest of each; infinite where `max_pressure` is not stated."""
        return np.broadcast_to(np.inf if self.max_pressure is None else self.max_pressure, len(self.actuators.azimuths_deg))

    @property
    def highest_limit(self) -> float | None:
        """Pa, the largest of `pressure_limits`; None where `max_pressure` is not stated."""
        return None if self.max_pressure is None else float(np.max(self.max_pressure))

    @property
    def bending_directions(self) -> NDArray[np.complex128]:
        """(actuators,) x + iy where each bends the tip, away from a chamber, towards a tendon; 1 long at mean lever and area."""
        sizes = -np.sign(self.actuators.area) * self.actuators.shares * self.actuators.levers
        return sizes * np.exp(1j * np.radians(self.actuators.azimuths_deg))

    def with_modulus(self, factor: float) -> Robot:
        """The same robot this many times as stiff, whether by its material or as given, unchecked."""
        names = ("youngs_modulus", "shear_modulus", "bending_stiffness", "axial_stiffness", "torsional_stiffness")

        def scaled(one: Robot | Section) -> dict[str, Any]:
            values = {name: getattr(one, name, None) for name in names}
            return {name: np.multiply(v, factor).tolist() for name, v in values.items() if v is not None}

        sections = tuple(part.model_copy(update=scaled(part)) for part in self.sections)
        return self.model_copy(update={**scaled(self), "sections": sections})

    @property
    def stated(self) -> dict[str, Stated]:
        """EFFECT.PARAMETER -> value, sd and unit, of effects and tolerances."""
        return named(self.causes, self.tolerances)

    @property
    def causes(self) -> Table:
        """`effects`, and what `thrust` means where they do not describe it."""
        if self.thrust != "walls" or THRUST in self.effects:
            return self.effects
        return {THRUST: {"share": Stated(value=1.0, unit="1")}, **self.effects}

    @property
    def plain(self) -> Robot:
        """The same robot without effects, tolerances, posterior and residual: what the paper's model knows of it."""
        nothing = dict.fromkeys(("posterior", "obstacle_azimuth_deg", "quoted_pressure", "quoted_time", "residual"))
        return self.model_copy(update={"effects": {}, "tolerances": {}, **nothing})

    def joint_uncertainty(self) -> tuple[tuple[str, ...], Array]:
        """Names (k) of all parameters that are not exact, and their covariance (k, k) in the units in which they are stated.

        Those that are not in `posterior` are independent.
        """
        stated, posterior = self.stated, self.posterior
        given = posterior.parameters if posterior is not None else ()
        first = tuple(name for name in given if name == AREA_FACTOR or name in stated)
        names = (*first, *(n for n, p in stated.items() if p.sd > 0 and n not in first))
        sd = np.array([stated[n].sd if n in stated else posterior.area_factor_sd if posterior else 0.0 for n in names])
        correlation = np.eye(len(names))
        if posterior is not None:
            kept = [name in first for name in given]
            correlation[: len(first), : len(first)] = posterior.matrix[np.ix_(kept, kept)]
        return names, correlation * np.outer(sd, sd)

    def with_values(self, values: Mapping[str, float]) -> Robot:
        """One robot of which these parameters are known exactly: EFFECT.PARAMETER or area_factor -> value in its unit."""
        data = self.model_dump(exclude={"posterior"})
        for name, value in values.items():
            id, _, parameter = name.partition(".")
            if name == AREA_FACTOR:
                data["area_factor"] = value
            else:
                data["effects" if id in self.effects else "tolerances"][id][parameter] |= {"value": value, "sd": 0.0}
        return robot_from_dict(data)

    def replace(self, **values: Any) -> Robot:
        """The same robot with other values of robot.yaml in SI units, checked again; raises `BadRobot`.

        >>> load_robot(Path("robot.yaml")).replace(length=0.42).length
        0.42
        """
        return robot_from_dict({**self.model_dump(exclude=LIMITS if LIMITS & {*values} else None), **values})

    def _columns(self) -> dict[str, Any]:
        parts = {(): self, (self.actuators.words.kind,): self.actuators, ("spine",): self.spine}
        given = {(*at, name): value for at, part in parts.items() for name, value in part or () if value not in (None, ())}
        own = {p: v for p, v in given.items() if not isinstance(v, BaseModel) and p[0] not in STATED}
        rows = {".".join(p): (v, unit_at(p, Robot, NESTED)) for p, v in own.items()}
        rows |= {name: (stated.value, stated.unit.strip("1")) for name, stated in self.stated.items()}
        return {"parameter": list(rows), "value": [v for v, _ in rows.values()], "unit": [unit for _, unit in rows.values()]}

    def __dir__(self) -> list[str]:
        """Without the names that pydantic adds."""
        return [name for name in super().__dir__() if name.startswith("__") or name not in dir(BaseModel)]

    def __repr__(self) -> str:
        count, effects = len(self.actuators.azimuths_deg), ", ".join(self.effects) or "none"
        return f"<Robot: {self.name}, {1e3 * self.length:g} mm, {count} {self.actuators.words.kind}, effects: {effects}>"

    __str__ = __repr__


def robot_from_dict(data: Mapping[str, Any]) -> Robot:
    """A robot from plain numbers in SI units; raises `BadRobot` naming every field that is wrong."""
    return checked(Robot, data, NESTED, BadRobot)


def load_robot(path: Path) -> Robot:
    """Read a robot.yaml written in SI numbers; raises `BadRobot` naming the file and every field that is wrong.

    >>> load_robot(Path("robot.yaml")).length
    0.4
    """
    return loaded(path, "a robot.yaml", "`name:` and `length:`", robot_from_dict, BadRobot)


NESTED: Mapping[str, type[BaseModel]] = {
    "chambers": Chambers, "tendons": Tendons, "spine": Spine, "base_to_world": Pose, "posterior": Posterior, "noise": Noise,
    "residual": Residual, "uncertainty": Uncertainty, "sections": Section, "markers": Marker,
}  # fmt: skip
"""Key of robot.yaml -> the table that it holds."""
