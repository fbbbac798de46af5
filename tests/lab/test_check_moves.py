"""`lab check --move` on whole rigs of fakes: what agrees with itself and is wrong all the same is seen by the tip."""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import SOUND, Cli
from virtual_lab import settings

from drivers.frames import matrix_from_quaternion
from drivers.line_quality import adapter
from lab.files.checked import Moved, keep, last, place
from lab.files.config import load
from lab.files.rig_file import load_rig
from lab.files.robot_file import paper_robot
from lab.verbs.calibrate import BaseSeen, lines
from lab.verbs.fakes import write_rig
from lab.verbs.run import note_unverified
from model.robot import Robot
from recordings.file.reader import Recording
from sim_fakes.alicat import AlicatFake
from sim_fakes.instrument import FakeRegulators
from sim_fakes.rig import FakeRig
from sim_fakes.smc_itv import STEPS, SmcItvFake
from tests.sim_fakes.plugged import Plugged
from tests.simulated.clock import SimulatedClock

Start = Callable[..., tuple[FakeRig, Path]]
SPEED = 20.0
FRAMES = 60
"""Of the tip that are averaged: 0.06 mm of camera noise are left in a difference, and 0.1 mm are allowed for."""
ROUNDING = 1.01
"""A set-point is rounded to the steps of its unit."""


@pytest.fixture
def start(simulated: SimulatedClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """Fakes with such regulators, and a rig.yaml that tells of them what is given."""
    monkeypatch.setattr("lab.verbs.check.FRAMES", FRAMES)
    with ExitStack() as running:

        def start(regulators: FakeRegulators, mocap: dict[str, Any] | None = None, **pressure: Any) -> tuple[FakeRig, Path]:
            fakes = running.enter_context(FakeRig(speed=SPEED, seed=4, regulators=regulators))
            rig = tmp_path / "rig.yaml"
            write_rig(fakes, rig, {"instruments": {"pressure": {"timeout": 2.0} | pressure, "mocap": mocap or {}}})
            return fakes, rig

        yield start


def checked(rig: Path, cli: Cli, says: str | None = None) -> dict[str, Moved]:
    """What `lab check --move` sees of a rig that passes, or that is refused with these words."""
    done = cli("check", "--move", "--yes", "--json", "--seconds", "0", "--rig", rig, code=(0, 3) if says is None else 1)
    seen = {m["what"]: Moved(**m) for m in done.json["moved"]}
    right = all(m.ok for m in seen.values()) if says is None else any(says in m.text for m in seen.values())
    assert right, "\n".join(f"{name}: {m.ok} {m.text}" for name, m in seen.items())
    return seen


def highest(fakes: FakeRig) -> float:
    """The highest set-point that any regulator was sent, Pa in truth."""
    told = [0.0]
    for line in fakes.lines.values():
        words = [request.decode("ascii", "replace").strip() for request in line.requests]
        if isinstance(line, SmcItvFake):
            told += [int(w[4:]) / STEPS * line.device.full_scale for w in words if w.startswith("SET ")]
        elif isinstance(line, AlicatFake):
            pa = {4: 1e3, 10: 6894.757}[line.device["A"].unit_code]
            told += [float(w[3:]) * pa for w in words if w[1:3] == "S "]
            told += [int(w[1:]) / 64000 * line.device["A"].full_scale for w in words if w[1:].isdigit()]
    return max(told)


def test_a_sound_rig_passes_and_is_remembered_as_long_as_its_file_stays(
    start: Start, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fakes, rig = start(FakeRegulators())
    Plugged(monkeypatch, [line.port for line in fakes.lines.values()])
    spine, gauge = (yaml.safe_load(rig.read_text())["instruments"][name]["port"] for name in ("spine", "gauge"))
    keep(rig, load_rig(rig), [Moved("valve", True, "on and off")], {spine: adapter(gauge)})  # a check before adapters changed
    seen = checked(rig, cli)
    # the other instruments tell their serial numbers
    assert json.loads(place(rig).read_text())["adapters"] == {port: adapter(port) for port in (spine, gauge)}
    assert {"valve", "spine", "arm", "safe state"} < set(seen)
    assert sum("the tip moved" in m.text for m in seen.values()) == 3
    assert highest(fakes) <= 5e3 * ROUNDING
    assert not isinstance(last(rig, load_rig(rig)), str)
    short = settings("spine_lengths=[0]", "pressures=[50 kPa]", "unload=false")
    run = ["run", "bending", "--rig", rig, "--out", tmp_path, *short]
    assert "unverified" not in cli(*run, code=SOUND).out
    (first,) = tmp_path.glob("*.mcap")
    assert Recording.open(first).metadata["check"]["moved"].startswith("20")
    rig.write_text(rig.read_text().replace("units: [A, B", "units: [B, A"))
    assert "are unverified: instruments or stand of" in cli(*run, code=SOUND).out
    (second,) = set(tmp_path.glob("*.mcap")) - {first}
    assert Recording.open(second).metadata["check"]["moved"] == "no"


LONG, MORE, LESS = pytest.mark.long, "more than it reads; correct full_scale", "less than it reads"


@pytest.mark.parametrize(
    ("true", "stated", "gives"),
    [(900e3, 500e3, MORE), pytest.param(900e3, 100e3, MORE, marks=LONG), pytest.param(500e3, 900e3, LESS, marks=LONG)],
)
def test_an_itv_of_another_range_is_caught_before_5_kpa_are_passed(
    start: Start, cli: Cli, true: float, stated: float, gives: str
) -> None:
    fakes, rig = start(FakeRegulators("smc_itv", full_scale=true), full_scale=stated, max_pressure=100e3)
    checked(rig, cli, f"delivers {gives}")
    assert highest(fakes) <= 5e3 * 1.1 and not place(rig).exists()


@pytest.mark.long
def test_an_old_alicat_in_psi_passes_with_its_unit_and_is_caught_without(start: Start, cli: Cli) -> None:
    fakes, rig = start(FakeRegulators(firmware="5v12.0-R22", unit="psi", full_scale=413.7e3))
    checked(rig, cli)
    assert place(rig).exists()
    rig.write_text(rig.read_text().replace("unit: psi", "unit: kPa"))
    seen = checked(rig, cli, "does not show kPa but psi")
    assert highest(fakes) <= 5e3 * ROUNDING and not place(rig).exists()
    assert seen["safe state"].ok


def test_calibrating_finds_where_base_axes_and_chambers_are(start: Start, cli: Cli) -> None:
    unknown = {"mocap_to_base": {"position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}}
    fakes, rig = start(FakeRegulators(swapped=(2, 3)), mocap=unknown)
    told = cli("check", "--calibrate", "--yes", "--json", "--seconds", "0", "--rig", rig, code=(0, 3)).json
    text = "\n".join(told["calibration"])
    made = yaml.safe_load(re.findall(r"mocap_to_base: (\{.*\})", text)[0])
    true = fakes.mocap.mocap_to_base  # type: ignore[union-attr]
    assert made["position"] == pytest.approx(true["position"], abs=0.01)
    turn = matrix_from_quaternion(made["quaternion"]).T @ matrix_from_quaternion(true["quaternion"])
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 4
    azimuths = yaml.safe_load(re.findall(r"azimuths_deg: (\[.*?\])", text)[0])
    robot = load(paper_robot(), Robot).actuators.azimuths_deg
    turned = [(a - b + 180) % 360 - 180 for a, b in zip(azimuths, robot, strict=True)]
    assert turned == pytest.approx([0, 0, 120, 120, 120, -120, -120, -120, 0], abs=10)  # 60 frames
    assert "chambers 3, 4, 5; 6, 7, 8 are not where robot.yaml has them: exchanged hoses?" in text
    assert all(m["ok"] for m in told["moved"]) and highest(fakes) <= 5e3 * ROUNDING and not place(rig).exists()


def test_an_azimuth_of_360_degrees_is_written_as_0() -> None:
    seen = BaseSeen(np.eye(3), np.zeros(3), 0.0, (-0.03,), 1.0, 1e-4)
    assert "azimuths_deg: [0.0] " in list(lines(seen, [(1,)], (0.0,)))[1]


@pytest.mark.parametrize("driver", ["alicat", pytest.param("smc_itv", marks=pytest.mark.long)])
def test_exchanged_hoses_are_caught_by_the_way_the_tip_goes(start: Start, cli: Cli, driver: str) -> None:
    _, rig = start(FakeRegulators(driver, swapped=(2, 3)))
    seen = checked(rig, cli, "other chambers are inflated; look for swapped hoses")
    channels = [m for name, m in seen.items() if name.startswith("pressure channel")]
    assert [m.ok for m in channels] == [True, False]
    second = channels[1]
    assert "other chambers are inflated; look for swapped hoses" in second.text
    assert seen["safe state"].ok


def test_adapters_that_come_back_with_exchanged_names_are_refused_until_the_rig_is_checked_again(
    start: Start, cli: Cli, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fakes, rig = start(FakeRegulators("smc_itv"))
    instruments = yaml.safe_load(rig.read_text())["instruments"]
    first, second, *_ = instruments["pressure"]["ports"]
    plugged = Plugged(monkeypatch, [line.port for line in fakes.lines.values()])
    keep(rig, load_rig(rig), [Moved("valve", True, "on and off")], {port: adapter(port) for port in (first, second)})

    def check(code: int | tuple[int, ...] = SOUND) -> str:
        return " ".join(cli("check", "--rig", rig, "--seconds", "0", code=code).err.split())

    check()
    plugged.exchange(first, instruments["valve"]["port"])
    asked = len(fakes.lines["pressure1"].requests)
    found = r"is the USB adapter 0403:6014 serial number FT\d+, not 0403:6014 serial number FT\d+ as before"
    refused = check(1)
    assert re.search(f"pressure: at {first} {found}", refused) and "valve" not in refused  # which has a number of its own
    assert len(fakes.lines["pressure1"].requests) == asked
    plugged.exchange(first, instruments["valve"]["port"])
    check()
    plugged.exchange(first, second)
    assert "is the USB adapter" in cli("run", "bending", "--rig", rig, "--out", tmp_path, code=1).err
    cli("safe", "--rig", rig)  # which vents whatever is there


@pytest.mark.parametrize("option", ["--move", "--calibrate"])
def test_nothing_moves_where_nobody_can_be_asked(option: str, start: Start, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    fakes, rig = start(FakeRegulators())
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    told = cli("check", option, "--rig", rig, code=2).flat_err
    assert f"{option}: no terminal on which to confirm that it inflates each channel to 5 kPa" in told and "--yes" in told
    assert not any(line.requests for line in fakes.lines.values())


def test_a_check_that_failed_takes_an_older_one_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = load_rig(Path(__file__).parents[2] / "examples" / "rig" / "rig.yaml")
    rig = tmp_path / "rig.yaml"
    assert last(rig, example) == f"{rig} has not passed `lab check --move`"
    for speed in (1.0, 20.0):  # only fakes run at another speed, and need no check
        note_unverified(rig, example.model_copy(update={"clock": example.clock.model_copy(update={"speed": speed})}))
    assert capsys.readouterr().out.count("unverified") == 1
    keep(rig, example, [Moved("valve", True, "on and off")])
    assert not isinstance(last(rig, example), str)
    pressure = example.instruments.pressure
    assert pressure is not None

    def with_pressure(**change: object) -> object:
        instruments = example.instruments.model_copy(update={"pressure": pressure.model_copy(update=change)})
        return last(rig, example.model_copy(update={"instruments": instruments}))

    assert not isinstance(with_pressure(max_pressure=100e3), str)
    assert "were changed after the check of" in str(with_pressure(full_scale=900e3))
    assert "were changed after the check of" in str(with_pressure(chambers=((9, 1, 2), (6, 7, 8), (3, 4, 5))))
    keep(rig, example, [Moved("valve", False, "stuck")])
    assert "not passed" in str(last(rig, example))
    place(rig).write_text("{")
    assert "cannot be read" in str(last(rig, example))
