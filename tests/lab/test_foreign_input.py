"""Tables in other units and recordings of other software end with exit 2 and say what to do, whatever verb reads them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from diagnosed_case import campaign, folder
from mcap.writer import Writer

from lab.cli import main
from lab.rig.losses import newly_lost
from recordings.table_file import read_csv

READERS = ("compare", "fit", "diagnose")
Text = Callable[[str], str]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder(tmp_path_factory.mktemp("case") / "case", campaign({}, repeats=1, lengths=(0.0, 0.2)))


def ran(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Exit code and what stood on stderr."""
    code = main([str(a) for a in arguments])
    return code, capsys.readouterr().err


def changed(case: Path, target: Path, change: Text) -> Path:
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


@pytest.mark.parametrize("verb", READERS)
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (scaled(PRESSURES, 1e-3), ["column p", "240", "looks like kPa", "multiply by 1000"]),
        (scaled("x y z", 1000), ["line 2, z", "looks like mm", "divide by 1000"]),
        (scaled("x y z", 10), ["columns x, y, z", "4.0", "check the unit (m)"]),
        (scaled("y z", -1), ["z seems to point the wrong way"]),
        (scaled("vacuum", -1), ["line 2, vacuum", "-80000 Pa", "change the sign"]),
        (scaled("tip_mass", 1000), ["line 2, tip_mass", "looks like g", "divide by 1000"]),
        (scaled("spine_length", 1000), ["spine_length", "looks like mm", "divide by 1000"]),
        (lambda t: t.replace(",", ";"), ["line 1", "semicolons", "write commas between columns"]),
        (lambda t: t.replace(",", ";").replace(".", ","), ["line 1", "semicolons", "points in numbers"]),
        (lambda t: t.replace(",", "\t"), ["line 1", "tabs"]),
        (cells(lambda n, c: f'"{c}"'.replace(".", ",") if n == "z" else c), ["line 2, z", "decimal comma: write 0."]),
        (cells(lambda n, c: c.replace(".", ",") if n == "z" else c), ["line 2", "29 cells under 28", "decimal comma"]),
    ],
)
def test_a_table_in_other_units_ends_with_exit_2_for_every_verb(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str, change: Text, words: list[str]
) -> None:
    path = changed(case, tmp_path / "case", change)
    code, text = ran(capsys, verb, path)
    assert code == 2 and "trials.csv" in text and "Traceback" not in text, text
    assert all(word in text for word in words), text


def test_a_doubt_that_may_be_right_is_said_and_nothing_is_refused(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(case, tmp_path / "case", scaled("vacuum", 1e-3))
    code, text = ran(capsys, "compare", path)
    assert code == 0 and "no vacuum is above 80 Pa" in text
    assert read_csv(path / "trials.csv").warnings


# ------------------------------------------------------------------ recordings of other software
def foreign(path: Path, kind: str) -> Path:
    """An MCAP file by the library: JSON on topics like ours, or ROS 2 messages."""
    joint = b"std_msgs/Header header\nstring[] name\nfloat64[] position\n"
    schemas = {
        "json": ("jsonschema", "json", json.dumps({"type": "object"}).encode(), "Pressure"),
        "ros2": ("ros2msg", "cdr", joint, "sensor_msgs/msg/JointState"),
    }
    topics = {"json": ("/pressure", "/tip", "/state", "/trial"), "ros2": ("/joint_states", "/tf")}
    encoding, message, text, name = schemas[kind]
    with open(path, "wb") as out:
        writer = Writer(out, enable_data_crcs=True)
        writer.start(profile="ros2" if kind == "ros2" else "")
        schema = writer.register_schema(name, encoding, text)
        for topic in topics[kind]:
            channel = writer.register_channel(topic, message, schema)
            for i in range(30):
                data = json.dumps({"t": i * 0.1, "value": 101.3}).encode() if kind == "json" else bytes(24)
                writer.add_message(channel, 10**18 + i * 10**8, data, 10**18 + i * 10**8, i)
        writer.finish()
    return path


@pytest.mark.parametrize("kind", ["json", "ros2"])
@pytest.mark.parametrize("verb", [*READERS, "replay", "replay --play", "export", "export --case"])
def test_a_recording_of_other_software_is_refused_by_its_topics(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str, kind: str
) -> None:
    path = foreign(tmp_path / "bag.mcap", kind)
    name, *options = verb.split()
    code, text = ran(capsys, name, path, *options, *(["--out", tmp_path / "out"] if name == "export" else []))
    assert code == 2 and str(path) in text and "Traceback" not in text, text
    there = "/joint_states (sensor_msgs/msg/JointState, cdr)" if kind == "ros2" else "/pressure (Pressure, json)"
    assert there in text
    if "--play" not in verb:
        assert "it needs /" in text


@pytest.mark.parametrize("kind", ["json", "ros2"])
def test_a_recording_of_other_software_is_described_and_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path = foreign(tmp_path / "bag.mcap", kind)
    assert main(["info", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert all(stream["timing"]["count"] == 30 for stream in told["streams"].values()) and len(told["streams"]) > 1
    assert main(["verify", str(path)]) == 0
    assert "is intact" in " ".join(capsys.readouterr().out.split())


def test_losses_of_a_driver_that_was_opened_again_count_from_then_on() -> None:
    assert (newly_lost(3, 5), newly_lost(3, 3), newly_lost(7, 2)) == (2, 0, 2)
