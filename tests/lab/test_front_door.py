"""`import lab`: what a script or a notebook uses, tried as its documentation writes it."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from diagnosed_case import campaign, folder
from virtual_lab import VirtualLab

import lab
from lab.cli import main, parser
from lab.files.example import paper_robot


def test_importing_it_costs_next_to_nothing_and_its_names_are_known() -> None:
    said = "import sys, lab; print(sorted(set(sys.modules) & {'numba', 'rtde_control', 'matplotlib'}), dir(lab))"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("[] ") and all(name in done.stdout for name in lab.__all__)
    assert all(callable(getattr(lab, name)) and getattr(lab, name).__doc__ for name in lab.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        lab.nothing  # noqa: B018


def test_a_recording_is_described_without_drivers_and_kernels() -> None:
    recording = Path(__file__).parents[1] / "recordings/data/bending-schema-1.mcap"
    said = (
        "import sys; from lab.cli import main; code = main(['info', sys.argv[1]]); "
        "print(code, sorted(m for m in sys.modules if m.split('.')[0] in ('drivers', 'numba', 'scipy', 'pymodbus')))"
    )
    done = subprocess.run([sys.executable, "-c", said, str(recording)], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("0 []\n")


def test_prediction_follows_the_rod() -> None:
    robot = lab.load_robot(paper_robot())
    tips = lab.predict(robot, [[0.0] * 9, [100e3, 100e3, 0, 0, 0, 0, 0, 0, 100e3]], spine_length=[0.0, 0.1])
    assert tips.shape == (2, 3) and abs(tips[0, 0]) < 1e-9 and np.linalg.norm(tips[1, :2]) > 0.01
    assert np.allclose(lab.predict(robot, [0.0] * 9), tips[:1], atol=1e-9)


def test_a_run_on_fakes_is_read_fitted_and_compared(virtual_lab: VirtualLab, tmp_path: Path) -> None:
    with lab.open_rig(virtual_lab.rig, needs=("pressure", "spine", "valve", "gauge", "mocap")) as rig:
        assert "arm" not in rig.identities
        settle = {"min_samples": 3, "still_distance": 5e-3, "max_hidden": 5.0, "max_gap": 10.0, "within": 300.0}
        file = lab.run(rig, "bending", out=tmp_path, spine_lengths=[0.05], pressures=[60e3, 120e3], settle=settle)
    plant = virtual_lab.fakes.plant
    assert float(max(plant.chamber_pressure)) < 5e3 and not plant.valve_on
    recording = lab.read(file)
    assert recording.outcome == "completed" and len(recording.stream("/tip"))
    case = lab.case(file)
    assert case.table["x"].shape == (5,) and case.robot == lab.load_robot(paper_robot())
    fitted = lab.fit(case)
    assert fitted.area_factor is not None
    gap = lab.compare(lab.Case(fitted.robot, case.table))
    assert gap.predicted.shape == gap.measured.shape == (5, 3)


def test_what_a_notebook_shows_is_short_and_a_table_becomes_a_data_frame(tmp_path: Path) -> None:
    case = lab.case(folder(tmp_path / "case", campaign({}, repeats=1, lengths=(0.0, 0.2))))
    shown = [case, case.table, lab.compare(case), lab.fit(case), lab.predictor(case.robot)]
    shown += [lab.fit_with(case, "chamber_azimuth")]
    assert all(1 <= len(repr(one).splitlines()) <= 10 and len(repr(one)) < 1500 for one in shown)
    assert "14 states in 2 trials" in repr(case) and "mm rms (in-sample)" in repr(lab.compare(case))
    frame = case.table.to_pandas()
    assert list(frame.columns) == list(case.table.columns) and len(frame) == 14
    assert frame.attrs["units"]["p1"] == "Pa" and case.table.units["x"] == "m"
    assert "<table" in case._repr_html_()


def test_help_begins_with_the_names() -> None:
    assert lab.__doc__ is not None
    listed = re.findall(r"^    (\w+)\(", lab.__doc__, re.MULTILINE)
    assert set(listed) == set(lab.__all__) - {"Case"}


def test_every_verb_says_what_it_does() -> None:
    verbs = next(a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    assert all(verb in parser().format_help() for verb in verbs.choices)
    assert all("usage: lab " + verb in p.format_help() for verb, p in verbs.choices.items())


def test_version_and_schemas(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0 and re.match(r"softlab [0-9.]+", capsys.readouterr().out)
    assert main(["schema", "robot"]) == 0
    robot = json.loads(capsys.readouterr().out)
    assert {"type": "string"} in robot["properties"]["length"]["anyOf"]  # 40 cm
    assert main(["schema", "rig"]) == 0
    assert "alicat" in capsys.readouterr().out
    assert main(["schema", "bending"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["protocol"] == {"const": "bending"}
    assert main(["schema", "bendin"]) == 2
