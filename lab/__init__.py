"""The laboratory in Python. What a script or notebook calls, all values in SI units:

    load_robot(path)              the robot of a robot.yaml
    case(*inputs)                 measured states: recordings, or a folder with robot.yaml and trials.csv
    read(path)                    one recording, with its streams as arrays
    predict(robot, pressures)     tips by the Cosserat rod model, with intervals and gradients; also robot.predict(..)
    inverse(robot, targets)       pressures that bring the tip to its targets; also robot.inverse(..)
    fit(case, effects=())         moduli and area factors, or named effects, with their intervals
    compare(case)                 measured tips next to predicted ones
    diagnose(case)                where the gap lies, and which effect causes it
    diagnose_model(predict, ..)   which of your causes explains the gap of any model
    Cause(name, parameters)       such a cause
    mujoco_model(spec, ..)        such a model of MuJoCo
    save(answer, folder)          its page and its JSON
    open_rig(path)                the instruments of a rig.yaml, connected
    run(rig, protocol, **keys)    run an experiment; returns the recording

Start:

    import lab

    case = lab.case(frame, "robot.yaml")  # a pandas DataFrame; or recordings
    answer = lab.diagnose(case)
    known = lab.fit(case, answer.attribute.effects).robot
    known.inverse([[-0.05, 0.02, 0.38]]).pressures
    longer = known.replace(length=0.42)

Every result has `.to_frame()`: a DataFrame with its units. `help(lab.diagnose)` and so on say more, with examples.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diagnosis.any_model import diagnose_model
    from model.cause import Cause

    from .api import case, compare, diagnose, fit, inverse, load_robot, open_rig, predict, read, run
    from .files.inputs import Case
    from .mujoco_adapter import mujoco_model
    from .pages.answer_page import save

__all__ = [
    "Case", "Cause", "case", "compare", "diagnose", "diagnose_model", "fit", "inverse", "load_robot", "mujoco_model", "open_rig",
    "predict", "read", "run", "save",
]  # fmt: skip
HOMES = {
    "Case": "lab.files.inputs", "Cause": "model.cause", "diagnose_model": "diagnosis.any_model",
    "mujoco_model": "lab.mujoco_adapter", "save": "lab.pages.answer_page",
}  # fmt: skip
"""Modules of the names that are not those of `lab.api`."""


def __getattr__(name: str) -> Any:
    """A name of the front door, when it is first used: the command's own start does not wait for all of it."""
    if name in __all__:
        from .version import strangers

        if wrong := strangers():
            raise ImportError(wrong)
        return getattr(import_module(HOMES.get(name, "lab.api")), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
