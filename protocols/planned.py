"""What a plan will read, and what it does to the chambers: the table of trials before anything has moved.

The columns are those of `recordings.trials`, without what is measured: pressures, spine length and vacuum are those asked for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.pressure_limits import VENTED
from recordings.trials import TrialRow

from .bench import Setup
from .errors import BadProtocol
from .experiment import Ask, Plan, Reading, Step
from .parameters import Parameters


def planned_rows(plan: Plan, parameters: Parameters, chambers: int) -> list[dict[str, Any]]:
    """One row a state, in the order in which the plan reads them; `t` is s of rig time since the plan's begin.

    A step that asks for a spine length begins a trial. Tip mass and roll are those of the step's set-up, else the
    parameters' own. Raises BadProtocol for a chamber that the robot has not.
    """
    asked = parameters.model_dump()
    mount = {name: float(asked[name]) for name in ("tip_mass", "roll_deg") if isinstance(asked.get(name), (int, float))}
    states_stated = any(step.reads for step in plan.steps)
    rows: list[dict[str, Any]] = []
    trial, state, time = 0, 0, 0.0
    spine, vacuum, pressure = 0.0, 0.0, np.zeros(chambers)
    for step in plan.steps:
        ask = step.ask
        if ask.setup is not None:
            mount = {"tip_mass": ask.setup.tip_mass, "roll_deg": ask.setup.roll_deg}
        if ask.spine_length is not None:
            trial, state, spine = trial + 1, 0, ask.spine_length
            vacuum, pressure = ask.vacuum or 0.0, np.zeros(chambers)
        previous = pressure
        if ask.pressures:
            pressure = _padded(plan, ask, chambers)
        reads = step.reads if states_stated else _default_reading(step, previous, pressure, rows, trial)
        ramp_end = time + step.seconds - (reads[-1].hold if reads else 0.0)  # the step ends with its last reading
        for reading in reads:
            state += 1
            rows.append(
                {
                    "trial": max(trial, 1), "step": state, "protocol": plan.protocol, "repeat": reading.repeat,
                    "branch": reading.branch, "t": ramp_end + reading.hold, "rate": reading.rate, "hold": reading.hold,
                    "spine_length": spine, "vacuum": vacuum, **mount, **{f"p{c + 1}": float(x) for c, x in enumerate(pressure)},
                    **({} if ask.push is None else {"specimen": ask.push.specimen, "deflection": ask.push.deflection}),
                }
            )  # fmt: skip
        time += step.seconds
    return rows


def unlike(planned: Sequence[Mapping[str, Any]], read: Sequence[TrialRow]) -> str:
    """Where states that were read first differ from the planned rows, for people; empty where they do not.

    Trial, repeat, branch, spine length and pressures count; no pressures where a state is read while ramping.
    """
    plan, run = [_state(row) for row in planned], [_state(row.cells()) for row in read]
    for number, (planned_state, read_state) in enumerate(zip(plan, run, strict=False), 1):
        if planned_state != read_state:
            return f"state {number} is planned as {planned_state}; run reads {read_state}"
    return "" if len(plan) == len(run) else f"{len(plan)} states are planned; run reads {len(run)}"


def _state(row: Mapping[str, Any]) -> str:
    pressures = [f"{round(p / 1e3, 6) + 0.0:.4g}" for name, p in row.items() if re.fullmatch(r"p\d+", name)]
    return (
        f"trial {row['trial']}, repeat {row['repeat']}, {row['branch']}, spine {row['spine_length'] * 100:.3g} cm, "
        f"{', '.join(pressures) + ' kPa' if row['hold'] else 'while ramping'}"
    )


def _padded(plan: Plan, ask: Ask, chambers: int) -> NDArray[np.float64]:
    if len(ask.pressures) > chambers:
        raise BadProtocol(
            f"protocol {plan.protocol}: inflates chamber {len(ask.pressures)}, the robot has {chambers}: set chambers"
        )
    return np.array([*ask.pressures, *(0.0,) * (chambers - len(ask.pressures))])


def _default_reading(
    step: Step, previous: NDArray[np.float64], pressure: NDArray[np.float64], rows: Sequence[dict[str, Any]], trial: int
) -> tuple[Reading, ...]:
    """Readings of a step whose plan states none: one if it ramps from the pressures `previous` (Pa), else none."""
    rate = step.ask.pressure_rate
    if not step.ask.pressures or not rate:
        return ()
    change = float(np.abs(pressure - previous).max())
    stays_down = bool(rows) and not change and rows[-1]["trial"] == trial and rows[-1]["branch"] == "unload"
    falls = bool(pressure.sum() < previous.sum()) or stays_down
    return (Reading("unload" if falls else "load", max(step.seconds - change / rate, 0.0), rate),)


def setups(plan: Plan) -> tuple[Setup, ...]:
    """What a person prepares, in order; empty where the plan does not say."""
    return tuple(step.ask.setup for step in plan.steps if step.ask.setup is not None)


def cycles(plan: Plan, chambers: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(chambers,) how often each chamber is inflated from vented, and the highest pressure (Pa gauge) it is asked for.

    Each trial begins vented. Raises BadProtocol for a chamber that the robot has not.
    """
    count, highest, previous = np.zeros(chambers, np.int64), np.zeros(chambers), np.zeros(chambers)
    for step in plan.steps:
        if step.ask.spine_length is not None:
            previous = np.zeros(chambers)
        if not step.ask.pressures:
            continue
        pressure = _padded(plan, step.ask, chambers)
        count += (previous <= VENTED) & (pressure > VENTED)
        highest = np.maximum(highest, pressure)
        previous = pressure
    return count, highest
