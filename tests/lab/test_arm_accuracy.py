"""The arm of a fake rig is not built as drawn: a run of `arm_accuracy` measures it, and hands over what a diagnosis takes."""

from pathlib import Path

import numpy as np
import pandas
import pytest
import yaml
from virtual_lab import lab, recorded, settings

from lab.verbs.fakes import write_rig
from sim_fakes.rig import FakeRig

SHORT = settings("poses=10", "average=0.5 s")


@pytest.fixture(scope="module")
def rig(whole_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    write_rig(whole_rig, path, {"instruments": {"mocap": {"body": "Flange", "markers": []}}})
    return path


def test_a_run_hands_over_joints_and_places_of_the_flange(rig: Path, tmp_path: Path, capsys) -> None:
    code = lab("run", "arm_accuracy", "--rig", rig, *SHORT, "--out", tmp_path)
    print(capsys.readouterr())
    assert code == 0
    poses = pandas.read_csv(recorded(tmp_path).with_suffix(".poses.csv"))
    print(poses.to_string())
    assert 0
