"""Where the tip should be: the model in a process of its own, so that neither the page waits for its kernels nor the run for it.

`python -m lab.live.expected` reads JSON lines, the first one the robot, and answers each with one line.

    {"robot": "name: ..."}        {"ready": true, "intervals": true}
    {"now": {"pressures": [..], "spine": 0.1, "mass": 0.05, "roll": 0.0}}
                                  {"tip": [..], "low": [..], "high": [..]}
    {"rows": ["{..}", ..]}        {"gaps": [{"tip": [..], "low": [..], "high": [..], "gap": [..]}, null]}

SI units, base frame; `low` and `high` are the ends of the 95 % interval of a reading; null where robot.yaml states no
uncertainty. A question that cannot be answered gets {"error": "why"}.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from diagnosis.errors import DiagnosisError
from model.errors import ModelError
from model.prediction import Prediction, Predictor
from model.prediction.spread import states_uncertainty
from model.robot import Robot
from recordings.errors import RecordingError
from recordings.json_text import plain_numbers
from recordings.trials import Table, TrialRow

from ..comparison import expected
from ..files.config import ConfigError, check, parse_yaml
from ..files.inputs import Case
from ..files.own_effects import stated_by

UNANSWERED = (ConfigError, ModelError, DiagnosisError, RecordingError, ValueError)


def answers(lines: Iterator[str]) -> Iterator[dict[str, Any]]:
    """The answer to each line, in the forms above; to the first, the robot, once the model's kernels are there."""
    robot = check(parse_yaml(json.loads(next(lines))["robot"], "robot.yaml"), Robot)
    predictor = Predictor(robot, stated_by(robot), cores=1)
    predictor(np.zeros(len(robot.actuators.azimuths_deg)), intervals=True)  # the first of each kind compiles
    with_intervals = states_uncertainty(robot)
    yield {"ready": True, "intervals": with_intervals}
    for line in lines:
        question = json.loads(line)
        try:
            if "rows" in question:
                table = Table.of(TrialRow.from_json(text) for text in question["rows"])
                yield {"gaps": gaps(Case(robot, table), with_intervals)}
            else:
                now = question["now"]
                prediction = predictor(now["pressures"], max(0.0, now["spine"]), now["mass"], now["roll"], intervals=True)
                yield _place(prediction, 0, with_intervals)
        except UNANSWERED as e:
            yield {"error": f"{type(e).__name__}: {e}"}


def gaps(case: Case, with_intervals: bool) -> list[dict[str, Any] | None]:
    """By row of a case: expected tip, its interval (`with_intervals`), measured minus expected (m); None without a tip."""
    out: list[dict[str, Any] | None] = [None] * len(case.table)
    if not case.table.with_tip.any():
        return out
    own, prediction = expected(case, intervals=True)
    for k, row in enumerate(own.row.tolist()):
        out[row] = {**_place(prediction, k, with_intervals), "gap": (own.trials.tip[k] - prediction.tip[k]).tolist()}
    return out


def _place(prediction: Prediction, k: int, with_interval: bool) -> dict[str, Any]:
    low, high = (end[k].tolist() for end in prediction.interval()) if with_interval else (None, None)
    return {"tip": prediction.tip[k].tolist(), "low": low, "high": high}


def main() -> None:
    """Answer until the input ends."""
    try:
        for answer in answers(iter(sys.stdin)):
            print(json.dumps(plain_numbers(answer)), flush=True)
    except UNANSWERED as e:
        print(json.dumps({"error": f"{type(e).__name__}: {e}"}), flush=True)


if __name__ == "__main__":
    main()
