"""A MuJoCo model as `lab.diagnose_model` asks for it: fields of its MjSpec that may be wrong become causes.

Each row of the data is a time; within each group the simulation starts anew, holds the controls of a row until the next one, and
reads the sensors at every row. Needs `pip install softlab[mujoco]`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from diagnosis.errors import BadCase
from model.arrays import Array
from model.cause import Cause

NEVER_NEGATIVE = ("armature", "damping", "density", "frictionloss", "mass", "stiffness", "timeconst")
"""Fields whose bound is 0 where none is stated."""
Stated = Sequence[Any]
"""(kind, name, field, plausible size, unit), perhaps with two bounds (.., low, high). Kind: joint, geom, body, actuator, tendon
or another element of MjSpec, or "option" with an empty name; field: of that element, such as `frictionloss`, `gainprm[0]`."""


@dataclass(frozen=True)
class MujocoModel:
    """What `lab.diagnose_model` takes: predict, causes and calibration."""

    spec: Any
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    causes: tuple[Cause, ...]
    calibration: Mapping[str, Sequence[Any]]
    time: str
    group: str | None
    start: Mapping[str, str]
    _places: Mapping[str, tuple[Any, str, int]] = field(repr=False)
    """Parameter -> element, field and index in it."""

    def predict(self, theta: Mapping[str, float], inputs: pd.DataFrame) -> Array:
        """Sensors (n, outputs) at the rows of `inputs`; NaN from where the simulation diverges."""
        import mujoco

        for key, value in theta.items():
            element, name, index = self._places[key]
            if np.ndim(getattr(element, name)):
                getattr(element, name)[index] = value
            else:
                setattr(element, name, value)
        model, out = self.spec.compile(), np.full((len(inputs), len(self.outputs)), np.nan)
        sensors = [int(model.sensor(name).adr[0]) for name in self.outputs.values()]
        table = {name: inputs[name].to_numpy(float) for name in (self.time, *self.inputs, *self.start)}
        of_group = np.zeros(len(inputs), int) if self.group is None else pd.factorize(inputs[self.group])[0]
        for own in (np.flatnonzero(of_group == number) for number in np.unique(of_group)):
            at, data = table[self.time][own], mujoco.MjData(model)
            if not (np.diff(at) >= 0).all():
                raise BadCase(f"{self.time}: must not decrease within a group; sort the rows, or state the group")
            for name, joint in self.start.items():
                data.joint(joint).qpos[:] = table[name][own[0]]
            for row, since in zip(own.tolist(), (at - at[0]).tolist(), strict=True):
                mujoco.mj_step(model, data, max(round((since - data.time) / model.opt.timestep), 0))
                for name, actuator in self.inputs.items():
                    data.actuator(actuator).ctrl[:] = table[name][row]
                mujoco.mj_forward(model, data)
                if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                    break
                out[row] = data.sensordata[sensors]
        return out


def mujoco_model(
    spec: Any, inputs: Mapping[str, str], outputs: Mapping[str, str], causes: Mapping[str, Sequence[Stated]],
    calibration: Sequence[Stated] = (), time: str = "t", group: str | None = None, start: Mapping[str, str] | None = None,
) -> MujocoModel:  # fmt: skip
    """Return predict, causes and calibration of a MuJoCo model.

    `spec`: an MjSpec, or the path of its XML; `inputs`: column -> actuator; `outputs`: column -> sensor of one value; `causes`:
    name -> fields that are wrong if it acts, see `Stated`; `calibration`: fields that are fitted in every hypothesis; `time`: the
    column of times in s; `start`: column -> joint that begins each group there. Raises `BadCase`.

    >>> friction = {"friction": [("joint", "elbow", "frictionloss", 0.1, "N m")]}
    >>> m = mujoco_model("arm.xml", {"torque": "motor"}, {"angle": "encoder"}, friction)
    >>> lab.diagnose_model(m.predict, data, {"angle": "rad"}, m.causes, m.calibration)
    """
    try:
        import mujoco
    except ImportError:
        raise BadCase("mujoco is not installed: pip install softlab[mujoco]") from None
    spec = mujoco.MjSpec.from_file(str(spec)) if isinstance(spec, str | Path) else spec.copy()
    for kind, named in (("actuator", inputs), ("sensor", outputs), ("joint", start or {})):
        for column, name in named.items():
            if getattr(spec, kind)(name) is None:
                raise BadCase(f"{column}: no {kind} {name!r}; the model has {_names(spec, kind)}")
    places: dict[str, tuple[Any, str, int]] = {}

    def quantities(stated: Sequence[Stated]) -> dict[str, Sequence[Any]]:
        out: dict[str, Sequence[Any]] = {}
        for kind, name, where, size, unit, *bounds in stated:
            element = spec.option if kind == "option" else getattr(spec, kind)(name) if hasattr(spec, kind) else None
            parts = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", where)
            if element is None or parts is None or not hasattr(element, parts[1]):
                raise BadCase(f"{kind} {name!r}, {where}: is not in the model, which has {_names(spec, kind)}")
            place = element, parts[1], int(parts[2] or 0)
            nominal = float(np.atleast_1d(getattr(*place[:2]))[place[2]])
            if not math.isfinite(nominal):
                raise BadCase(f"{kind} {name!r}, {where}: the model states no value; write it into the XML")
            key = ".".join(part for part in (name, where) if part)
            places[key] = place
            out[key] = (nominal, size, unit, *(bounds or ((0.0, None) if parts[1] in NEVER_NEGATIVE else ())))
        return out

    made = tuple(Cause(cause, quantities(stated)) for cause, stated in causes.items())
    return MujocoModel(spec, inputs, outputs, made, quantities(calibration), time, group, start or {}, places)


def _names(spec: Any, kind: str) -> str:
    """Names of all elements of a kind."""
    every = {"body": "bodies"}.get(kind, f"{kind}s")
    return ", ".join(x.name for x in getattr(spec, every, ()) if x.name) or f"no {kind}"
