"""`lab safe` while a run is going: the run lands at once and for good, and says who asked."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest
from house import House, until

from lab.cli import main
from lab.files.rig_file import load_rig
from lab.guard.landing import SafeReport, SafeStep
from lab.guard.messages import RigLanded
from lab.guard.takeover import Requests
from lab.rig.assembly import Rig

REPORT = SafeReport((SafeStep("pressure", True, "highest pressure 0.1 kPa"), SafeStep("arm", False, "moving")))


def test_a_question_is_taken_once_and_answered(tmp_path: Path) -> None:
    requests, answers = Requests(tmp_path / "rig.yaml"), []
    asking = threading.Thread(target=lambda: answers.append(requests.ask(60.0)), daemon=True)
    asking.start()
    taken = []
    assert until(lambda: bool(taken.append(requests.take()) or taken[-1]), 30.0)
    assert "lab safe, by" in taken[-1].by and requests.take() is None
    requests.answer(taken[-1], REPORT)
    asking.join(60.0)
    assert answers == [REPORT]
    assert not list(tmp_path.iterdir())


def test_a_question_that_nobody_takes_up_is_withdrawn(tmp_path: Path) -> None:
    assert Requests(tmp_path / "rig.yaml").ask(60.0) is None
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", ["", "[]", "{", "[" * 100_000])
def test_a_damaged_question_is_none(tmp_path: Path, content: str) -> None:
    (tmp_path / "rig.landing").write_text(content)
    assert Requests(tmp_path / "rig.yaml").take() is None


def test_a_run_that_is_going_is_landed_at_once_and_for_good(house: House, capsys: pytest.CaptureFixture[str]) -> None:
    house.change(without=("arm", "force", "mocap"))
    with Rig(load_rig(house.rig)) as rig:
        assert rig.open_all(lambda name, outcome: None) == []
        rig.actuators.call("valve", "set", True)
        rig.actuators.call("pressure", "set", (20e3, 20e3, 20e3))
        assert main(["safe", "--json", "--rig", str(house.rig)]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["confirmed"] and {s["instrument"] for s in told["steps"]} == {"pressure", "spine", "valve"}
        assert house.highest() < 5e3 and not house.fakes.plant.valve_on
        assert until(lambda: rig.vital.landed is not None, 30.0)
        assert rig.vital.landed is not None and "requested by lab safe" in rig.vital.landed.text
        with pytest.raises(RigLanded, match="requested by lab safe"):
            rig.actuators.call("pressure", "set", (20e3, 20e3, 20e3))
        with pytest.raises(RigLanded, match="requested by lab safe"):
            rig.actuators.resume()
    assert not house.latch.exists()


def test_the_run_ends_and_says_who_asked(house: House, tmp_path: Path) -> None:
    house.change(without=("arm", "force"))
    program = house.start(tmp_path)
    assert main(["safe", "--rig", str(house.rig)]) == 0
    assert house.highest() < 5e3
    output, _ = program.communicate(timeout=600)
    assert program.returncode == 1 and "requested by lab safe" in " ".join(output.split())
    assert not house.latch.exists()
