"""`lab import` of bags: only the wanted topics are decoded, odd ones are left out with a note, parts of one bag are joined."""

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from commands import Cli, Done
from foreign import ROBOT
from google.protobuf.descriptor_pb2 import FieldDescriptorProto
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer

from benchmarks.faults.foreign_tables import bent
from lab.imports.joining import at_times
from lab.imports.recording_topics import OLDEST, _numbers
from recordings.table_file import read_csv
from recordings.trials import Table

CDR = b"\x00\x01\x00\x00"
BEGIN = 1_700_000_000_000_000_000
PERIOD = 50_000_000
MAP = """robot: robot.yaml
source: {topic: /tip}
columns:
  p1: {column: /pressure.p.1, unit: kPa}
  p2: {column: /pressure.p.2, unit: kPa}
  p3: {column: /pressure.p.3, unit: kPa}
  x: {column: /tip.x}
  y: {column: /tip.y}
  z: {column: /tip.z}
states: {plateaus: {steady: 2 kPa, shortest: 1 s, settling: 0.3 s}}
"""
ROS = "ros2msg"
Odd = tuple[str, str, bytes, str, bytes]
"""Name, encoding and text of a definition, encoding of the messages, and one of them."""
ODD: dict[str, Odd] = {
    "wide strings in a list": ("a/msg/W", ROS, b"wstring[] texts\n", "cdr", CDR + struct.pack("<II", 1, 1) + b"a\0"),
    "a definition that is not one": ("a/msg/X", ROS, b"float64\nfloat64 float64 x\n", "cdr", CDR + bytes(16)),
    "a definition in another language": ("a/msg/I", "ros2idl", b"module a { struct I { double x; }; };", "cdr", CDR),
    "a message that is too short": ("a/msg/F", ROS, b"float64[9] data\n", "cdr", CDR + bytes(10)),
    "a list of a thousand million": ("a/msg/L", ROS, b"float64[] data\n", "cdr", CDR + struct.pack("<I", 10**9)),
    "JSON that nests": ("", "", b"", "json", b"[" * 100_000),
    "JSON that is not text": ("", "", b"", "json", b"\xff\xfe{"),
    "JSON with a number beyond all": ("", "", b"", "json", b'{"x": 1' + b"0" * 400 + b"}"),
    "a schema without a message": ("a.Gone", "protobuf", b"", "protobuf", b"\x08\x01"),
    "an encoding of its own": ("", "", b"", "flexbuffer", b"\x01"),
    "no encoding at all": ("", "", b"", "", b"\x01"),
}


def sweep() -> Iterator[tuple[int, dict[str, float], list[float]]]:
    """Log time (ns), tip and pressures (kPa): each chamber twice, up and down in 3 s steps."""
    i = 0
    for chamber in (0, 1, 2, 0, 1, 2):
        for level in (0, 20, 40, 20, 0):
            for _ in range(60):
                tip = dict(zip("xyz", (1e-3 * mm for mm in bent(chamber, level, 0.005)), strict=True))
                yield BEGIN + i * PERIOD, tip, [level * (k == chamber) * 1.0 for k in range(3)]
                i += 1


Told = Callable[[int, dict[str, float], list[float]], list[Any]]
"""Messages of a sample."""
TIP: tuple[str, Told] = ("/tip", lambda i, tip, p: [tip])
PRESSURE: tuple[str, Told] = ("/pressure", lambda i, tip, p: [{"p": p}])
JSON = ("", "", b"", "json")


def bag_of(
    path: Path,
    *topics: tuple[str, Told],
    formats: Sequence[tuple[str, str, bytes, str]] = (),
    log_time: Callable[[int], int] = int,
    **how: Any,
) -> Path:
    """The sweep in these messages: JSON, where `formats` (name, encoding and text of a definition, encoding) has no other."""
    with open(path, "wb") as file:
        writer = Writer(file, **how)
        writer.start("ros2", "another recorder")
        channels = []
        for (topic, told), (name, encoding, text, messages) in zip_longest(topics, formats, fillvalue=JSON):
            schema = writer.register_schema(name, encoding, text) if name else 0
            channels.append((writer.register_channel(topic, messages, schema), told))
        for i, (ns, tip, pressure) in enumerate(sweep()):
            for channel, told in channels:
                for one in told(i, tip, pressure):
                    writer.add_message(channel, log_time(ns), one if isinstance(one, bytes) else json.dumps(one).encode(), ns)
        writer.finish()
    return path


def bag(path: Path, *odd: Odd, only: Callable[[int], bool] = lambda i: True, **how: Any) -> Path:
    """Tip and pressures, or those of the samples that `only` takes, and odd topics beside them."""
    topics: list[tuple[str, Told]] = [(n, lambda i, tip, p, f=f: f(i, tip, p) * only(i)) for n, f in (TIP, PRESSURE)]
    topics += [(f"/odd{k or ''}", lambda i, tip, p, one=one: [one] * (i % 20 == 0)) for k, (*_, one) in enumerate(odd)]
    return bag_of(path, *topics, formats=[JSON, JSON, *(about[:4] for about in odd)], **how)


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT.read_text())
    (tmp_path / "map.yaml").write_text(MAP)
    return tmp_path


Importer = Callable[..., Done]


@pytest.fixture
def importer(place: Path, cli: Cli) -> Importer:
    """`lab import` of bags by the map with these changes, into a folder of this name."""

    def run(*bags: Path, name: str = "case", code: int = 0, **changes: str) -> Done:
        text = MAP
        for old, new in changes.items():
            text = text.replace(old, new)
        (place / "map.yaml").write_text(text)
        return cli("import", *bags, "--map", place / "map.yaml", "--out", place / name, code=code)

    return run


def table(place: Path, name: str = "case") -> Table:
    return read_csv(place / name / "trials.csv")


def test_topics_that_the_map_does_not_name_stop_nothing_and_are_noted(place: Path, importer: Importer) -> None:
    done = importer(bag(place / "bag.mcap", *ODD.values()))
    assert len(table(place)) == 25  # the rests between two chambers are one
    assert "topics that are not in the map are not read: /odd, /odd1, /odd2" in done.flat_err


@pytest.mark.parametrize("kind", ODD)
def test_a_named_topic_that_cannot_be_decoded_is_named_with_the_reason(place: Path, kind: str, importer: Importer) -> None:
    done = importer(bag(place / "bag.mcap", ODD[kind]), code=2, **{"  x: {column: /tip.x}": "  x: {column: /odd.x}"})
    assert "'/odd.x'" in done.flat_err
    assert "/odd: 90 of 90 messages are skipped: " in done.flat_err or kind == "JSON with a number beyond all"


def test_messages_and_fields_that_cannot_be_decoded_are_left_out(place: Path, importer: Importer) -> None:
    text = b"float64 x\nfloat64 y\nwstring name\nfloat64 z\n"
    payload = CDR + struct.pack("<dd", 1.0, 2.0) + struct.pack("<I", 1) + b"a\0"
    done = importer(bag(place / "bag.mcap", ("a/msg/Part", ROS, text, "cdr", payload)),
                    **{"  z: {column: /tip.z}": "  z: {column: /tip.z}\n  sensor_a_x: {column: /odd.x}"})  # fmt: skip
    assert set(table(place)["sensor_a_x"]) == {1.0}
    assert "/odd: the fields starting at `wstring name` cannot be decoded" in done.flat_err


# ------------------------------------------------------------------ whose numbers
SOMETHING = {"x": 0.5, "y": 0.1, "z": 0.2}


def bodies(i: int, tip: dict[str, float], p: list[float]) -> list[Any]:
    told = [{"header": {"frame_id": "world"}, "child_frame_id": n, "at": at} for n, at in (("T", tip), ("B", SOMETHING))]
    return [{"transforms": told[:: 1 if i % 3 else -1]}]


NAMED: dict[str, tuple[Told, Told, dict[str, str]]] = {
    "bodies in any order": (bodies, PRESSURE[1], {"/tip.": "/tip.transforms.T.at."}),
    "values in the order of their names": (
        TIP[1], lambda i, tip, p: [{"name": [*"abc"][:: (o := 2 * (i // 300 % 2) - 1)], "position": p[::o]}],
        {f"p.{k}": f"position.{n}" for k, n in enumerate("abc", 1)},
    ),
    "a message for each body": (
        lambda i, tip, p: [{"id": n, "at": at} for n, at in (("T", tip), ("B", SOMETHING))], PRESSURE[1], {"/tip.": "/tip.T.at."},
    ),
    "numbers as text": (lambda i, tip, p: [{k: str(v) for k, v in tip.items()}], PRESSURE[1], {}),
}  # fmt: skip


@pytest.mark.parametrize("kind", NAMED)
def test_what_has_a_name_is_found_by_it(place: Path, kind: str, importer: Importer) -> None:
    tip, pressure, changes = NAMED[kind]
    importer(bag_of(place / "bag.mcap", ("/tip", tip), ("/pressure", pressure)), name="found", **changes)
    importer(bag(place / "plain.mcap"), name="plain")
    found, plain = table(place, "found"), table(place, "plain")
    assert len(found) == len(plain)
    for column in ("p1", "p2", "p3", "x", "y", "z"):
        assert found[column] == pytest.approx(plain[column])


def test_single_messages_that_are_broken_are_counted(place: Path, importer: Importer) -> None:
    done = importer(bag_of(place / "bag.mcap", ("/tip", lambda i, tip, p: [b"{broken" if i % 100 == 7 else tip]), PRESSURE))
    assert len(table(place)) == 25 and "/tip: 18 of 1800 messages are skipped" in done.flat_err


def test_two_channels_of_one_topic_are_read_as_one(place: Path, importer: Importer) -> None:
    before, after = (lambda i, tip, p: [tip][i // 800 :]), (lambda i, tip, p: [tip][: i // 800])
    done = importer(bag_of(place / "bag.mcap", ("/tip", before), ("/tip", after), PRESSURE))
    assert len(table(place)) == 25 and "2 channels carry /tip" in done.flat_err


def test_fields_of_protobuf_that_were_not_set_are_missing() -> None:
    assert dict(_numbers("/t", Timestamp())) == {"/t.seconds": 0.0, "/t.nanos": 0.0}  # always there
    assert dict(_numbers("/t", FieldDescriptorProto(number=0))) == {"/t.number": 0.0}


def test_quaternions_of_either_sign_are_interpolated_as_the_turns_they_are(place: Path, importer: Importer) -> None:
    def imu(i: int, tip: dict[str, float], p: list[float]) -> list[Any]:
        return [{k: (1 if i % 2 else -1) * v for k, v in zip("wxyz", (0.96, 0.0, 0.28, 0.0), strict=True)}]

    odd = iter(range(10**6))  # each third message, of the sensor, comes half a period later
    path = bag_of(place / "bag.mcap", TIP, PRESSURE, ("/imu", imu), log_time=lambda ns: ns + PERIOD // 2 * (next(odd) % 3 == 2))
    importer(path, **{"states:": "orientation: {columns: [/imu.w, /imu.x, /imu.y, /imu.z], mount: [0.96, 0, -0.28, 0]}\nstates:"})
    assert table(place)["qw"] == pytest.approx([1.0] * 25)


@pytest.mark.parametrize("packed", [False, True], ids=["another CDR", "each message packed"])
def test_only_plain_cdr_is_read_also_where_each_message_is_packed(place: Path, packed: bool, importer: Importer) -> None:
    head, gap, pack = (CDR, "4x", zstandard.compress) if packed else (b"\0\7\0\0", "", bytes)
    path = bag_of(
        place / "bag.mcap",
        ("/tip", lambda i, tip, p: [pack(head + struct.pack(f"<f{gap}3d", 1.0, *tip.values()))]),
        ("/pressure", lambda i, tip, p: [pack(head + struct.pack("<3d", *p))]),
        formats=[
            ("a/msg/T", ROS, b"float32 q\nfloat64 x\nfloat64 y\nfloat64 z\n", "cdr"),
            ("a/msg/P", ROS, b"float64[3] p\n", "cdr"),
        ],
    )
    done = importer(path, code=0 if packed else 2)
    assert len(table(place)) == 25 if packed else "begins with 0007, which is not plain CDR" in done.flat_err


def test_messages_without_times_are_refused(place: Path, importer: Importer) -> None:
    done = importer(bag_of(place / "bag.mcap", TIP, PRESSURE, log_time=lambda ns: 0), code=2)
    assert "all 1800 messages of /tip have the log time 0 s" in done.flat_err


# ------------------------------------------------------------------ parts
@pytest.mark.parametrize(
    "at", [450, 510, pytest.param(700, marks=pytest.mark.long)], ids=["while it unloads", "at a step", "in the second trial"]
)
@pytest.mark.parametrize("begin", [pytest.param("file", marks=pytest.mark.long), "rest"])
def test_parts_of_one_recording_give_the_table_of_the_whole(place: Path, at: int, begin: str, importer: Importer) -> None:
    begins = {"states:": f"trials: {{begin: {begin}}}\nstates:"}
    importer(bag(place / "whole.mcap"), name="whole", **begins)
    folder = place / "bag"
    folder.mkdir()
    for part in range(11):  # bag_10 comes before bag_2 by name
        bag(folder / f"bag_{part}.mcap", only=lambda i, part=part: min(i // at, 10) == part)  # type: ignore[misc]
    for empty in [p for p in folder.iterdir() if p.stat().st_size < 700]:
        empty.unlink()
    done = importer(folder, name="parts", **begins)
    assert "read as one recording, by its times: bag_0.mcap, bag_1.mcap" in done.flat_err
    assert (place / "parts" / "trials.csv").read_text() == (place / "whole" / "trials.csv").read_text()
    assert "unload" in table(place, "parts")["branch"].tolist()


def test_recordings_with_a_pause_between_them_keep_their_true_times(place: Path, importer: Importer) -> None:
    importer(bag(place / "a.mcap", only=lambda i: i >= 900), bag(place / "b.mcap", only=lambda i: i < 600))
    found = table(place)
    assert found["trial"].max() == 2 and (found["t"][1:] > found["t"][:-1]).all()
    assert 900 * PERIOD * 1e-9 <= found["t"][found["trial"] == 2][0] < 960 * PERIOD * 1e-9


def test_recordings_whose_clocks_both_begin_anew_follow_each_other(place: Path, importer: Importer) -> None:
    importer(bag(place / "a.mcap"), bag(place / "b.mcap"))
    found = table(place)
    assert found["trial"].max() == 2 and (found["t"][1:] > found["t"][:-1]).all()


# ------------------------------------------------------------------ torn
@pytest.mark.parametrize("share", [pytest.param(0.2, marks=pytest.mark.long), 0.6, 0.999])
@pytest.mark.parametrize("chunks", [True, False], ids=["chunks", "no chunks"])
def test_a_torn_bag_names_recover_and_what_recover_gives_is_imported(
    place: Path, share: float, chunks: bool, importer: Importer, cli: Cli
) -> None:
    data = bag(place / "whole.mcap", use_chunking=chunks, chunk_size=4000).read_bytes()
    (place / "cut.mcap").write_bytes(data[: int(len(data) * share)])
    told = importer(place / "cut.mcap", code=2).flat_err
    assert "was not finished" in told and "`lab recover`" in told
    told = cli("recover", place / "cut.mcap", "--out", place / "good.mcap", code=3).flat_out
    assert "0.2 s" not in told and "the recorder's buffer in memory" in told
    cli("verify", place / "good.mcap")
    importer(place / "good.mcap")


def test_a_damaged_bag_names_recover(place: Path, importer: Importer) -> None:
    data = bytearray(bag(place / "bag.mcap", chunk_size=4000).read_bytes())
    data[len(data) // 3] ^= 1
    (place / "bag.mcap").write_bytes(data)
    assert "`lab recover`" in importer(place / "bag.mcap", code=2).flat_err


@pytest.mark.parametrize(
    ("values", "between"),
    [
        ([0.0, 1.0, 3.0, 4.0], [0.25, 1.5, 3.25]),
        ([178.0, 179.5, -179.0, -177.5], [178.375, 179.5, -178.625]),
        ([1, 1, 1, 2], [1, 1, 1]),
    ],
    ids=["a place", "an angle past 180 deg", "a count of trials"],
)
def test_between_readings_a_place_moves_and_a_count_or_a_turned_angle_does_not(values: list[float], between: list[float]) -> None:
    times = np.arange(4.0) / 10
    assert at_times(times[:3] + 0.025, times, np.array(values, float), OLDEST) == pytest.approx(between)
