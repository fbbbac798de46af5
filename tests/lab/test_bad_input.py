"""Bad input gets one clear message with everything that is wrong, the right exit code, and nothing moves."""

from __future__ import annotations

import copy
import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from virtual_lab import VirtualLab

from lab.cli import main
from lab.files.example import paper_robot
from lab.files.rig_file import load_rig
from lab.guard import door, last_used
from lab.guard.latch import Latch
from lab.rig import operator

Change = Callable[[dict[str, Any]], None]


def ran(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Exit code and what stood on stderr."""
    code = main([str(a) for a in arguments])
    return code, capsys.readouterr().err


def changed(virtual_lab: VirtualLab, folder: Path, change: Change) -> Path:
    """A copy of the rig file with one thing wrong."""
    file = copy.deepcopy(virtual_lab.fakes.rig_file())
    change(file)
    shutil.copy(paper_robot(), folder / "robot.yaml")
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(file, sort_keys=False))
    return path


def misspell(rig: dict[str, Any]) -> None:
    rig["instruments"]["pressure"]["max_presure"] = 200e3
    rig["instruments"]["spine"]["max_length"] = 35.0
    rig["stand"]["standoff"] = "80 kPa"
    rig["instruments"]["force"]["driver"] = "ft300"


def test_all_mistakes_of_a_rig_file_come_at_once(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = changed(virtual_lab, tmp_path, misspell)
    code, text = ran(capsys, "check", "--rig", rig)
    assert code == 2
    assert "instruments.pressure.max_presure: unknown key; did you mean 'max_pressure'?" in text
    assert "instruments.spine.max_length = 35 m: must be at most 2 m" in text
    assert "stand.standoff" in text and "'kPa'" in text and "mm" in text
    assert "instruments.force.driver" in text and "did you mean 'ft300s'?" in text
    assert len(text.splitlines()) == 4 and all(line.startswith(f"{rig}:") for line in text.splitlines())


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["--set", "presures=[50e3]"], ["presures", "did you mean 'pressures'"]),
        (["--set", "pressures=[250]"], ["pressures[0] = 250 Pa", "at least 1 kPa; did you mean 250 kPa?"]),
        (["--set", "pressures=[350 kPa]"], ["350 kPa", "at most 300 kPa"]),
        (["--set", "pressures=[5 cm]"], ["'cm'", "kPa"]),
        (["--set", "pressures=[200 kPa, 100 kPa]"], ["must increase"]),
        (["--set", "settle.band=-1"], ["settle.band", "above 0 Pa"]),
        (["--set", "nonsense"], ["KEY=VALUE"]),
    ],
)
def test_a_wrong_parameter_is_named_before_anything_is_connected(
    virtual_lab: VirtualLab, capsys: pytest.CaptureFixture[str], settings: list[str], words: list[str]
) -> None:
    before = len(virtual_lab.fakes.lines["valve"].requests)
    code, text = ran(capsys, "run", "bending", "--rig", virtual_lab.rig, *settings)
    assert code == 2
    assert all(word in text for word in words), text
    assert len(virtual_lab.fakes.lines["valve"].requests) == before


def test_a_protocol_beyond_the_rig_s_limits_is_refused(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def lower(rig: dict[str, Any]) -> None:
        rig["instruments"]["pressure"]["max_pressure"] = 200e3
        rig["instruments"]["spine"]["max_length"] = 0.2

    code, text = ran(capsys, "plan", "bending", "--rig", changed(virtual_lab, tmp_path, lower))
    assert code == 2
    assert "250000 Pa, above instruments.pressure.max_pressure = 200000 Pa" in text
    assert "0.3 m, above instruments.spine.max_length = 0.2 m" in text


def test_a_protocol_without_its_instruments_is_refused(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = changed(virtual_lab, tmp_path, lambda rig: rig["instruments"].pop("mocap"))
    code, text = ran(capsys, "run", "bending", "--rig", rig)
    assert code == 2 and "instruments.mocap" in text


def test_an_instrument_that_is_not_there_is_missing_by_name(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def unplug(rig: dict[str, Any]) -> None:
        rig["instruments"]["gauge"]["port"] = "/dev/nothing-here"

    code, text = ran(capsys, "run", "bending", "--rig", changed(virtual_lab, tmp_path, unplug), "--out", tmp_path)
    assert code == 1 and "gauge" in text and "/dev/nothing-here" in text
    assert not list(tmp_path.glob("*.mcap"))


def test_a_port_that_is_something_else_is_told(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def swap(rig: dict[str, Any]) -> None:
        instruments = rig["instruments"]
        instruments["valve"]["port"], instruments["gauge"]["port"] = (
            instruments["gauge"]["port"],
            instruments["valve"]["port"],
        )

    code, text = ran(capsys, "check", "--rig", changed(virtual_lab, tmp_path, swap), "--seconds", "0")
    assert code == 1 and "valve" in text and "gauge" in text


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("outer_radius", -0.05, ["outer_radius = -0.05 m", "above 0 m"]),
        ("inner_radius", 0.06, ["inner_radius"]),
        ("youngs_modulus", float("nan"), ["youngs_modulus", "finite"]),
        ("lenght", 0.4, ["lenght", "did you mean 'length'"]),
    ],
)
def test_a_wrong_robot_is_named_by_file_key_and_value(
    virtual_lab: VirtualLab,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    key: str,
    value: float,
    words: list[str],
) -> None:
    rig = changed(virtual_lab, tmp_path, lambda rig: None)
    robot = yaml.safe_load(paper_robot().read_text())
    robot[key] = value
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(robot))
    code, text = ran(capsys, "plan", "bending", "--rig", rig)
    assert code == 2
    assert "robot.yaml" in text and all(word in text for word in words), text


@pytest.mark.parametrize("verb", ["replay", "fit", "compare"])
@pytest.mark.parametrize("content", [b"", b"not a recording at all", b"\x89MCAP0\r\n" + bytes(200)])
def test_a_file_that_is_no_recording_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str, content: bytes
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    code, text = ran(capsys, verb, path)
    assert code == 1 and str(path) in text and "Traceback" not in text


def test_a_recording_cut_in_half_tells_what_is_readable(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ("spine_lengths=[0.0]", "pressures=[50 kPa]", "unload=false")
    settings = [word for setting in short for word in ("--set", setting)]
    assert main(["run", "bending", "--rig", str(virtual_lab.rig), *settings, "--out", str(tmp_path)]) in (0, 3)
    (file,) = tmp_path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    code, text = ran(capsys, "compare", file)
    assert code == 1 and "lab recover" in text
    assert ran(capsys, "info", file)[0] == 3


@pytest.mark.parametrize("verb", ["replay", "compare", "fit", "info", "check", "plan"])
def test_a_missing_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    path = tmp_path / "none"
    arguments = {"check": ["--rig", path], "plan": ["bending", "--rig", path]}.get(verb, [path])
    code, text = ran(capsys, verb, *arguments)
    assert code in (1, 2) and str(path) in text and len(text.strip().splitlines()) == 1


def ended(rig: dict[str, Any]) -> None:
    """Its fakes are gone."""
    rig["operator"] = "unix:/tmp/softlab-gone/operator.sock"


def test_fakes_that_have_ended_are_one_line_and_no_line_for_each_instrument(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = changed(virtual_lab, tmp_path, ended)
    for verb in (["check"], ["run", "bending", "--out", tmp_path], ["safe"], ["safe", "--clear"]):
        code, text = ran(capsys, *verb, "--rig", rig)
        assert code == 2 and text.count("\n") == 1
        assert f"{rig}: the fakes that wrote this file have ended" in text and f"lab fakes --rig {rig}" in text
    assert Latch(rig).read() is None


def test_all_rigs_are_safe_when_the_only_one_left_was_of_fakes_that_have_ended(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "PREFIX", f"softlab-test-ended/{os.getpid()}/")
    monkeypatch.setattr(last_used, "FOLDER", tmp_path)
    rig = changed(virtual_lab, tmp_path, ended)
    last_used.remember(load_rig(rig))
    for said in ("have ended", ""):  # the second time it is forgotten
        code, text = ran(capsys, "safe", "--all")
        assert code == 0 and said in text and bool(text) is bool(said)
    assert Latch(rig).read() is None


def and_unplugged(rig: dict[str, Any]) -> None:
    """A rig.yaml that began as that of fakes; its only instrument is hardware, whose cable is out."""
    ended(rig)
    rig["instruments"] = {"valve": {"driver": "numato", "port": "/dev/no-valve"}}


def test_hardware_whose_cable_is_out_is_no_fake_that_has_ended(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = changed(virtual_lab, tmp_path, and_unplugged)
    code, text = ran(capsys, "safe", "--rig", rig)
    assert code == 1 and "have ended" not in text and Latch(rig).read() is not None


def test_fakes_whose_back_door_is_closed_to_this_user_have_not_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    spec = f"unix:{tmp_path}/operator.sock"
    assert operator.ended(spec)
    monkeypatch.setattr(operator.socket.socket, "connect", forbidden)
    assert not operator.ended(spec)


def unplugged(rig: dict[str, Any]) -> None:
    """Two instruments are out."""
    rig["instruments"]["gauge"]["port"] = "/dev/no-gauge"
    rig["instruments"]["valve"]["port"] = "/dev/no-valve"


@pytest.mark.parametrize("verb", [("check",), ("run", "bending")])
def test_each_instrument_that_is_missing_is_explained_once(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: tuple[str, ...]
) -> None:
    rig = changed(virtual_lab, tmp_path, unplugged)
    assert main([*verb, "--rig", str(rig), *(["--out", str(tmp_path)] if verb[0] == "run" else [])]) == 1
    told = capsys.readouterr()
    text = "".join((told.out + told.err).split())
    for name in ("gauge", "valve"):
        assert text.count(f"{name}:cannotopen/dev/no-{name}") == 1 and text.count("groupdialout") == 2


def test_fakes_do_not_take_the_rig_file_of_others_that_live(virtual_lab: VirtualLab, capsys: pytest.CaptureFixture[str]) -> None:
    before = virtual_lab.rig.read_bytes()
    code, text = ran(capsys, "fakes", "--rig", virtual_lab.rig)
    assert code == 2 and f"the fakes of process {os.getpid()} serve it" in text
    assert virtual_lab.rig.read_bytes() == before
