"""Every protocol on a whole rig of fakes, in simulated time: it ends by itself, and reads what it planned."""

from pathlib import Path

import pytest

from lab.cli import main
from lab.verbs.fakes import write_rig
from protocols.registry import OWN
from recordings.file.reader import Recording
from sim_fakes.rig import FakeRig

SMALL = {
    "arm_accuracy": ("poses=8", "passes=1"),
    "bending": ("spine_lengths=[0.05]", "pressures=[60 kPa, 90 kPa]"),
    "cycles": ("cycles=2",),
    "elongation": ("spine_lengths=[0.05]", "pressures=[60 kPa]"),
    "stiffness": ("spine_lengths=[0.1]", "steps=3", "min_samples=20", "zero_samples=20"),
}
"""Settings with which each takes seconds."""


@pytest.fixture(scope="module")
def rig(whole_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    write_rig(whole_rig, path)
    write_rig(whole_rig, path.with_name("arm_accuracy.yaml"), {"instruments": {"mocap": {"body": "Flange", "markers": []}}})
    return path


def test_none_is_left_out() -> None:
    assert set(SMALL) == set(OWN)


@pytest.mark.parametrize(
    "protocol", [pytest.param(p, marks=[pytest.mark.long] if p in ("bending", "stiffness") else []) for p in SMALL]
)
def test_it_runs_to_its_end(protocol: str, rig: Path, tmp_path: Path) -> None:
    settings = [word for setting in SMALL[protocol] for word in ("--set", setting)]
    own = rig.with_name(f"{protocol}.yaml")
    assert main(["run", protocol, "--rig", str(own if own.exists() else rig), *settings, "--out", str(tmp_path)]) in (0, 3)
    (file,) = tmp_path.glob("*.mcap")
    recording = Recording.open(file)
    assert recording.outcome == "completed" and recording.metadata["outcome"]["safe_state"] == "confirmed"
    if protocol != "cycles":  # which reads nothing
        assert len(recording.trials) >= 2
