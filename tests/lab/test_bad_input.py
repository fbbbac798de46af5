"""Bad input gets one clear message with everything that is wrong and the right exit code, whatever verb reads it."""

import copy
import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import Cli
from mcap.writer import Writer
from virtual_lab import VirtualLab

from lab.files.rig_file import load_rig
from lab.files.robot_file import paper_robot
from lab.guard import door, last_used
from lab.guard.latch import Latch
from lab.rig import real_time
from lab.rig.assembly import newly_lost
from recordings.table_file import read_csv
from tests.recordings.synthetic_run import OLD


def changed(virtual_lab: VirtualLab, folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
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


def test_all_mistakes_of_a_rig_file_come_at_once(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    rig = changed(virtual_lab, tmp_path, misspell)
    text = cli("check", "--rig", rig, code=2).err
    assert "instruments.pressure.max_presure: unknown key; did you mean max_pressure?" in text
    assert "instruments.spine.max_length = 35 m: must be at most 2 m" in text
    assert "stand.standoff" in text and "'kPa'" in text and "mm" in text
    assert "instruments.force.driver" in text and "did you mean ft300s?" in text
    assert len(text.splitlines()) == 4 and all(line.startswith(f"{rig}:") for line in text.splitlines())


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["--set", "presures=[50e3]"], ["presures", "did you mean pressures"]),
        (["--set", "pressures=[250]"], ["pressures[0] = 250 Pa", "at least 1 kPa; did you mean 250 kPa?"]),
        (["--set", "pressures=[350 kPa]"], ["350 kPa", "at most 300 kPa"]),
        (["--set", "pressures=[5 cm]"], ["'cm'", "kPa"]),
        (["--set", "pressures=[50 KPA]"], ["did you mean kPa?"]),
        (["--set", "pressures=[200 kPa, 100 kPa]"], ["must increase"]),
        (["--set", "settle.band=-1"], ["settle.band", "above 0 Pa"]),
        (["--set", "nonsense"], ["KEY=VALUE"]),
    ],
)
def test_a_wrong_parameter_is_named_before_anything_is_connected(
    virtual_lab: VirtualLab, cli: Cli, settings: list[str], words: list[str]
) -> None:
    before = len(virtual_lab.fakes.lines["valve"].requests)
    text = cli("run", "bending", "--rig", virtual_lab.rig, *settings, code=2).err
    assert all(word in text for word in words), text
    assert len(virtual_lab.fakes.lines["valve"].requests) == before


def test_a_protocol_without_its_instruments_is_refused(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    rig = changed(virtual_lab, tmp_path, lambda rig: rig["instruments"].pop("mocap"))
    text = cli("run", "bending", "--rig", rig, code=2).err
    assert "instruments.mocap" in text and "without cameras use lab run cycles or lab jog" in text


def test_what_is_wrong_with_a_robot_is_named_by_file_key_and_value(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    rig = changed(virtual_lab, tmp_path, lambda rig: None)
    wrong = {"outer_radius": -0.05, "youngs_modulus": float("nan"), "lenght": 0.4, "max_pressure": 250}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(yaml.safe_load(paper_robot().read_text()) | wrong))
    text = cli("plan", "bending", "--rig", rig, code=2).err
    words = ["outer_radius = -0.05 m", "above 0 m", "youngs_modulus", "finite", "lenght", "did you mean length"]
    for word in ("robot.yaml", *words, "max_pressure = 250 Pa", "at least 1 kPa; did you mean 250 kPa?"):
        assert word in text


@pytest.mark.parametrize("verb", ["replay", "fit", "compare"])
@pytest.mark.parametrize("content", [b"", b"not a recording at all", b"\x89MCAP0\r\n" + bytes(200)])
def test_a_file_that_is_no_recording_says_so(tmp_path: Path, cli: Cli, verb: str, content: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    text = cli(verb, path, code=1).err
    assert str(path) in text and "Traceback" not in text


def test_a_recording_cut_in_half_tells_what_is_readable(tmp_path: Path, cli: Cli) -> None:
    (file := tmp_path / "run.mcap").write_bytes(OLD.read_bytes()[: OLD.stat().st_size // 2])
    assert "lab recover" in cli("compare", file, code=1).err
    cli("info", file, code=3)


@pytest.mark.parametrize("verb", ["replay", "compare", "fit", "info", "check", "plan"])
def test_a_missing_file_is_one_line(tmp_path: Path, cli: Cli, verb: str) -> None:
    path = tmp_path / "none"
    arguments = {"check": ["--rig", path], "plan": ["bending", "--rig", path]}.get(verb, [path])
    text = cli(verb, *arguments, code=(1, 2)).err
    assert str(path) in text and len(text.strip().splitlines()) == 1


def ended(rig: dict[str, Any]) -> None:
    """Its fakes are gone."""
    rig["operator"] = "unix:/tmp/softlab-gone/operator.sock"


def test_ended_fakes_are_one_line_and_no_line_for_each_instrument(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    rig = changed(virtual_lab, tmp_path, ended)
    for verb in (["check"], ["run", "bending", "--out", tmp_path], ["safe"], ["safe", "--clear"]):
        text = cli(*verb, "--rig", rig, code=2).err
        assert text.count("\n") == 1
        assert f"{rig}: the fakes that wrote this file have ended" in text and f"lab fakes --rig {rig}" in text
    assert Latch(rig).read() is None


def test_all_rigs_are_safe_when_the_only_one_left_was_of_fakes_that_have_ended(
    virtual_lab: VirtualLab, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "PREFIX", f"softlab-test-ended/{os.getpid()}/")
    monkeypatch.setattr(last_used, "FOLDER", tmp_path)
    rig = changed(virtual_lab, tmp_path, ended)
    last_used.remember(load_rig(rig))
    for said in ("have ended", ""):  # the second time it is forgotten
        text = cli("safe", "--all").err
        assert said in text and bool(text) is bool(said)
    assert Latch(rig).read() is None


def test_hardware_whose_cable_is_out_is_no_fake_that_has_ended(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    hardware = {"valve": {"driver": "numato", "port": "/dev/no-valve"}}  # in a rig.yaml that began as that of fakes
    rig = changed(virtual_lab, tmp_path, lambda rig: (ended(rig), rig.update(instruments=hardware)))
    assert "have ended" not in cli("safe", "--rig", rig, code=1).err and Latch(rig).read() is not None


def test_fakes_whose_back_door_is_closed_to_this_user_have_not_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    spec = f"unix:{tmp_path}/operator.sock"
    assert real_time.process_of(spec) is None
    (tmp_path / "operator.sock").touch()
    monkeypatch.setattr(real_time.socket.socket, "connect", forbidden)
    assert real_time.process_of(spec) == 0


@pytest.mark.parametrize("verb", [("check",), ("run", "bending")])
def test_each_instrument_that_is_missing_is_explained_once(
    virtual_lab: VirtualLab, tmp_path: Path, cli: Cli, verb: tuple[str, ...]
) -> None:
    names = "gauge", "valve"
    rig = changed(virtual_lab, tmp_path, lambda rig: [rig["instruments"][k].update(port=f"/dev/no-{k}") for k in names])
    told = cli(*verb, "--rig", rig, *(["--out", str(tmp_path)] if verb[0] == "run" else []), code=1)
    text = "".join((told.out + told.err).split())
    for name in names:
        assert text.count(f"{name}:cannotopen/dev/no-{name}") == 1 and text.count("groupdialout") == 2
    assert not list(tmp_path.glob("*.mcap"))


def test_fakes_do_not_take_the_rig_file_of_others_that_live(virtual_lab: VirtualLab, cli: Cli) -> None:
    before = virtual_lab.rig.read_bytes()
    assert f"the fakes of process {os.getpid()} serve it" in cli("fakes", "--rig", virtual_lab.rig, code=2).err
    assert virtual_lab.rig.read_bytes() == before


# ------------------------------------------------------------------ tables in other units, recordings of other software
READERS = ("compare", "fit", "diagnose")
Text = Callable[[str], str]


def with_table(case: Path, target: Path, change: Text) -> Path:
    """A copy of a case folder with another table."""
    target.mkdir()
    (target / "robot.yaml").write_bytes((case / "robot.yaml").read_bytes())
    (target / "trials.csv").write_text(change((case / "trials.csv").read_text()))
    return target


def cells(change: Callable[[str, str], str]) -> Text:
    """Every cell of a table changed by its column."""

    def to(text: str) -> str:
        head, *lines = (line.split(",") for line in text.splitlines())
        rows = [[change(name, cell) if cell else cell for name, cell in zip(head, line, strict=True)] for line in lines]
        return "\n".join(",".join(line) for line in [head, *rows]) + "\n"

    return to


def scaled(columns: str, factor: float) -> Text:
    return cells(lambda name, cell: repr(float(cell) * factor) if name in columns.split() else cell)


PRESSURES = " ".join(f"p{i}" for i in range(1, 10))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (scaled(PRESSURES, 1e-3), ["1000 times as large", "look like kPa", "`unit: kPa`"]),
        (scaled("x y z", 1000), ["line 3, x", "looks like mm", "divide by 1000"]),
        (scaled("x y z", 10), ["columns x, y, z", "4.0", "as mm read as cm do: check unit and `scale` of columns x, y, z first"]),
        (scaled("y z", -1), ["the cameras' frame", "let columns x, y, z hold what is now x, y, -z"]),
        (scaled("vacuum", -1), ["line 2, vacuum", "-80000 Pa", "change the sign"]),
        (scaled("tip_mass", 1000), ["line 2, tip_mass", "looks like g", "divide by 1000"]),
        (scaled("spine_length", 1000), ["spine_length", "looks like mm", "divide by 1000"]),
        (lambda t: t.replace("p1,", "q1,", 1), ["no column p1"]),
        (lambda t: t.replace("p9,", "q9,", 1), ["8 pressures", "9 chambers"]),
        (cells(lambda n, c: "0.45" if n == "spine_length" else c), ["0.45 m", "longer than the robot (0.4 m)"]),
        (lambda t: t.replace(",", ";"), ["line 1", "semicolons", "write commas between columns"]),
        (lambda t: t.replace(",", ";").replace(".", ","), ["line 1", "semicolons", "points in numbers"]),
        (lambda t: t.replace(",", "\t"), ["line 1", "tabs"]),
        (cells(lambda n, c: f'"{c}"'.replace(".", ",") if n == "z" else c), ["line 2, z", "decimal comma: write 0."]),
        (cells(lambda n, c: c.replace(".", ",") if n == "z" else c), ["line 2", "29 cells under 28", "decimal comma"]),
    ],
)
def test_a_table_in_other_units_ends_with_exit_2_for_every_verb(
    small_case: Path, tmp_path: Path, cli: Cli, change: Text, words: list[str]
) -> None:
    path = with_table(small_case, tmp_path / "case", change)
    for verb in READERS if "tabs" in words else READERS[:1]:  # all verbs read tables by the same way
        text = cli(verb, path, code=2).err
        assert "trials.csv" in text and all(word in text for word in words), text


def test_a_doubt_that_may_be_right_is_said_and_nothing_is_refused(small_case: Path, tmp_path: Path, cli: Cli) -> None:
    path = with_table(small_case, tmp_path / "case", scaled("vacuum", 1e-3))
    assert "no vacuum is above 80 Pa" in cli("compare", path).flat_err
    assert read_csv(path / "trials.csv").warnings


# ------------------------------------------------------------------ recordings of other software
def foreign(path: Path, kind: str) -> Path:
    """An MCAP file by the library: JSON on topics like ours, or ROS 2 messages."""
    joint, ours = b"std_msgs/Header header\nstring[] name\nfloat64[] position\n", ("/pressure", "/tip", "/state", "/trial")
    encoding, message, text, name, data, topics = {
        "json": ("jsonschema", "json", b'{"type": "object"}', "Pressure", b'{"value": 101.3}', ours),
        "ros2": ("ros2msg", "cdr", joint, "sensor_msgs/msg/JointState", bytes(24), ("/joint_states", "/tf")),
    }[kind]
    with open(path, "wb") as out:
        writer = Writer(out, enable_data_crcs=True)
        writer.start(profile="ros2" if kind == "ros2" else "")
        schema = writer.register_schema(name, encoding, text)
        for channel in [writer.register_channel(topic, message, schema) for topic in topics]:
            for i in range(30):
                writer.add_message(channel, 10**18 + i * 10**8, data, 10**18 + i * 10**8, i)
        writer.finish()
    return path


@pytest.mark.parametrize("kind", ["json", "ros2"])
@pytest.mark.parametrize("verb", [*READERS, "replay", "export", "export --case"])
def test_a_recording_of_other_software_is_refused_by_its_topics(tmp_path: Path, cli: Cli, verb: str, kind: str) -> None:
    path = foreign(tmp_path / "bag.mcap", kind)
    name, *options = verb.split()
    text = cli(name, path, *options, *(["--out", tmp_path / "out"] if name == "export" else []), code=2).err
    assert str(path) in text and "Traceback" not in text, text
    there = "/joint_states (sensor_msgs/msg/JointState, cdr)" if kind == "ros2" else "/pressure (Pressure, json)"
    assert there in text
    assert "it needs /" in text


@pytest.mark.parametrize("kind", ["json", "ros2"])
def test_a_recording_of_other_software_is_described_and_verified(tmp_path: Path, cli: Cli, kind: str) -> None:
    path = foreign(tmp_path / "bag.mcap", kind)
    told = cli("info", path, "--json").json
    assert all(stream["timing"]["count"] == 30 for stream in told["streams"].values()) and len(told["streams"]) > 1
    assert "is intact" in cli("verify", path).flat_out


def test_losses_of_a_driver_that_was_opened_again_count_from_then_on() -> None:
    assert (newly_lost(3, 5), newly_lost(3, 3), newly_lost(7, 2)) == (2, 0, 2)


def test_a_demo_replaces_no_folder_but_that_of_a_demo(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def begun(**_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("lab.verbs.demo.FakeRig", begun)
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    mine.mkdir()
    (mine / "rig.yaml").write_text("name: mine\n")
    told = cli("demo", "--out", mine, code=2).err
    assert f"{mine}: is not empty" in told and "--out" in told and (mine / "rig.yaml").exists()
    for _ in range(2):
        cli("demo", "--out", theirs, code=1)
        assert not (theirs / "left").exists()
        (theirs / "left").touch()
