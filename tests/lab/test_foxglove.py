"""`lab watch --foxglove`: who speaks Foxglove's protocol is handed the messages of the recording as they are, and the layout
shows numbers that are in it."""

import base64
import json
import re
import signal
import socket
import struct
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Cli, command
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Schema
from pages import running
from websockets.sync.client import ClientConnection, connect

import timing
from lab.files.config import check, parse_yaml
from lab.files.own_effects import stated_by
from lab.files.robot_file import paper_robot
from lab.live import foxglove_server
from lab.live.foxglove_server import EXPECTED, LAYOUT, Foxglove
from lab.live.show import LOOPBACK, Show, ShownRecording, place
from model.prediction import Predictor
from model.robot import Robot
from recordings.file.tail import Piece, Tail
from recordings.file.writer import Recorder
from recordings.messages import streams
from tests.recordings.synthetic_run import OLD, REST, state

WITHIN = 120.0
"""Host seconds for which a message is waited for."""
Told = tuple[str, int, bytes]
"""Topic, log time, message."""


class Viewer:
    """Speaks the protocol as Foxglove and Lichtblick do."""

    def __init__(self, wire: ClientConnection) -> None:
        self.wire = wire
        self.channels: dict[int, dict[str, Any]] = {}
        self.time = 0
        assert self.answer()["op"] == "serverInfo"

    def answer(self) -> dict[str, Any]:
        """The next message that is text; the clock, which may come at any time, is kept."""
        while not isinstance(data := self.wire.recv(WITHIN), str):
            self._keep_time(data)
        found: dict[str, Any] = json.loads(data)
        return found

    def _keep_time(self, data: bytes) -> None:
        assert data[0] == 2
        (now,) = struct.unpack_from("<Q", data, 1)
        assert now >= self.time
        self.time = now

    def known(self, topics: set[str]) -> list[int]:
        """The numbers of these topics, as soon as there are such."""
        while not topics <= {channel["topic"] for channel in self.channels.values()}:
            said = self.answer()
            assert said["op"] == "advertise"
            self.channels |= {channel["id"]: channel for channel in said["channels"]}
        return [n for n, channel in self.channels.items() if channel["topic"] in topics]

    def subscribe(self, topics: set[str]) -> None:
        self._subscribe(self.known(topics))

    def _subscribe(self, numbers: Iterable[int]) -> None:
        wanted = [{"id": n, "channelId": n} for n in numbers]
        self.wire.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def told(self, within: float = WITHIN) -> Iterator[Any]:
        """What comes, None where nothing comes within this many seconds; the clock beside it is kept."""
        while True:
            try:
                data = self.wire.recv(within)
            except TimeoutError:
                assert within < WITHIN, "nothing comes"
                yield None
                continue
            if isinstance(data, str):
                said = json.loads(data)
                if said["op"] == "status" and "unknown channel" in said["message"].lower():
                    # the server tells of a channel before it takes subscriptions to it: again, as Foxglove does by the user
                    self._subscribe(n for n in self.channels if str(n) in re.findall(r"\d+", said["message"]))
                else:
                    assert said["op"] == "advertise", said
            elif data[0] == 1:
                number, log_time = struct.unpack_from("<IQ", data, 1)
                yield self.channels[number]["topic"], log_time, data[13:]
            else:
                self._keep_time(data)


@contextmanager
def viewer(address: str, **options: Any) -> Iterator[Viewer]:
    with connect(
        address, subprotocols=["foxglove.websocket.v1", "foxglove.sdk.v1"], max_size=None, close_timeout=1, **options
    ) as wire:  # type: ignore[list-item]
        yield Viewer(wire)


def in_file(path: Path) -> tuple[list[Told], dict[str, tuple[Any, Schema]]]:
    """All messages in the order of the file, and of each topic its channel and schema."""
    with Tail(path) as tail:
        pieces = [piece for found in iter(tail.read, []) for piece in found]
        contents = tail.contents
    messages = [(contents.channels[n].topic, t, payload) for piece in pieces for n, t, payload in piece.messages]
    return messages, {c.topic: (c, contents.schemas[c.schema_id]) for c in contents.channels.values()}


def by_topic(messages: list[Told]) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    for topic, log_time, payload in messages:
        found.setdefault(topic, []).append((log_time, payload))
    return found


# -- a recording that is played
def test_a_recording_is_handed_on_as_it_is() -> None:
    with command("watch", OLD, "--foxglove", 0, "--speed", 1000, "--json") as program:
        assert program.stdout is not None
        said = json.loads(program.stdout.readline())
        assert said["layout"] == str(LAYOUT) and said["live"] is False
        messages, channels = in_file(OLD)
        with viewer(said["foxglove"]) as looks:
            looks.subscribe({EXPECTED, *channels})
            for channel in looks.channels.values():
                if channel["topic"] != EXPECTED:
                    kept, schema = channels[channel["topic"]]
                    assert base64.b64decode(channel["schema"]) == schema.data
                    assert (channel["schemaName"], channel["schemaEncoding"]) == (schema.name, schema.encoding)
                    assert channel["encoding"] == kept.message_encoding == "protobuf"
            assert by_topic(list(islice(looks.told(), len(messages)))) == by_topic(messages)
            assert looks.time == max(log_time for _, log_time, _ in messages)
            program.send_signal(signal.SIGINT)  # with somebody who looks
            assert program.wait(60) == 0


# -- in this process
@contextmanager
def shown(path: Path, speed: float | None = None, model: bool = False) -> Iterator[str]:
    """The address at which a recording is handed on."""
    at = place()
    with (
        at.listening,
        Foxglove(LOOPBACK, 0) as foxglove,
        running(Show(at, ShownRecording(path), speed, model=model, foxglove=foxglove), stay=True),
    ):
        yield foxglove.address


def test_a_run_is_handed_on_while_it_is_written_to_everybody_who_looks(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder, shown(recorder.path) as address:
        with viewer(address) as one, viewer(address) as other:
            for looks in (one, other):
                looks.subscribe({"/vacuum"})
                seen = looks.told(0.2)
                while next(seen) is None:  # until the subscription counts, which no answer tells
                    recorder.push("/vacuum", 1.0, (-1.0,))
                    recorder.sync()
            for k in range(300):
                recorder.push("/vacuum", 2.0 + 1e-3 * k, (20e3 + k,))
                if k % 50 == 0:
                    recorder.sync()
            recorder.sync()
            found = []
            for looks in (one, other):
                new = (told for told in looks.told() if told[1] >= 10**18 + 2 * 10**9)
                found.append(by_topic(list(islice(new, 300)))["/vacuum"])
        recorder.close("completed")
    assert found == [by_topic(in_file(recorder.path)[0])["/vacuum"][-300:]] * 2


def test_the_tip_that_is_expected_is_that_of_the_model_at_the_newest_pressures(tmp_path: Path) -> None:
    text, pressures = paper_robot().read_bytes(), (60e3,) * 3 + (0.0,) * 6
    asked = state(rule=REST, t_start=0.5, ramp_end=0.5, targets=pressures, spine_length=0.05, tip_mass=0.02)
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": text}) as recorder:
        recorder.state(0.5, asked)
        recorder.push("/spine", 0.75, (0.04, 0.0, 0.05, True, True))
        recorder.push("/pressure", 1.5, (pressures, pressures))
        recorder.close("completed")
    with shown(recorder.path, 1000.0, model=True) as address, viewer(address) as looks:
        looks.subscribe({EXPECTED})
        topic, log_time, payload = next(told for told in looks.told() if told)
    (entity,) = SceneUpdate.FromString(payload).entities
    at = entity.spheres[0].pose.position
    robot = check(parse_yaml(text.decode(), "robot.yaml"), Robot)
    found = Predictor(robot, stated_by(robot), cores=1)(list(pressures), 0.04, 0.02, 0.0)
    assert (at.x, at.y, at.z) == pytest.approx(tuple(found.tip[0]), abs=1e-9)
    assert (topic, log_time, entity.frame_id) == (EXPECTED, 10**18 + 1_500_000_000, "base")


def test_who_takes_nothing_costs_nobody_else_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foxglove_server, "WAITING", 400)
    with Tail(OLD) as tail:
        tail.read()
        contents = tail.contents
    (number,) = [n for n, channel in contents.channels.items() if channel.topic == "/log"]
    with Foxglove(LOOPBACK, 0) as foxglove:
        foxglove.offer(contents)
        where = (LOOPBACK, int(foxglove.address.rpartition(":")[2]))
        stuck = socket.socket()
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.connect(where)
        with stuck, viewer(foxglove.address) as looks:
            key = base64.b64encode(bytes(16)).decode()
            stuck.sendall(
                f"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
            )
            assert stuck.recv(12) == b"HTTP/1.1 101"
            wanted = [{"id": 1, "channelId": looks.known({"/log"})[0]}]
            subscription = json.dumps({"op": "subscribe", "subscriptions": wanted}).encode()
            stuck.sendall(struct.pack("!BBI", 0x81, 0x80 | len(subscription), 0) + subscription)  # mask 0
            until_wanted(foxglove)
            looks.subscribe({"/log"})
            waiting, count = looks.told(0.2), 0
            while next(waiting) is None:
                foxglove.take(contents, [Piece(1, messages=[(number, 1, b"hello")])])
            told = (one for one in looks.told() if one[1] >= 10**18)
            for _ in range(40):
                batch = [(number, 10**18 + k, b"%08d" % k + bytes(4000)) for k in range(count, count + 200)]
                foxglove.take(contents, [Piece(batch[-1][1], messages=batch)])
                for sent in batch:
                    assert next(told) == ("/log", *sent[1:])
                count += len(batch)
        assert count * 4000 > 30e6  # far more than the wire and the queue of the stuck one hold


def test_who_connects_and_says_nothing_does_not_keep_it_from_ending() -> None:
    foxglove = Foxglove(LOOPBACK, 0)
    with socket.create_connection((LOOPBACK, int(foxglove.address.rpartition(":")[2]))):
        with viewer(foxglove.address):  # who comes later has been served: the silent one is known by now
            pass
        ending = timing.Thread(target=foxglove.__exit__, args=(None, None, None), daemon=True)
        ending.start()
        ending.join(20.0)
        assert not ending.is_alive()


def until_wanted(foxglove: Foxglove) -> None:
    assert timing.wait(lambda: bool(foxglove.wanted), 60)


def test_what_the_model_expects_is_a_sphere_with_its_interval_until_it_cannot_tell() -> None:
    with Foxglove(LOOPBACK, 0) as foxglove, viewer(foxglove.address) as looks:
        looks.subscribe({EXPECTED})
        until_wanted(foxglove)
        tip, low, high = (0.01, -0.02, 0.2), (0.0, -0.03, 0.19), (0.03, 0.0, 0.2)
        foxglove.expected(5, {"tip": tip, "low": low, "high": high})
        foxglove.expected(6, {"tip": tip, "low": None, "high": None})
        foxglove.expected(7, {"error": "beyond its limits"})
        told = looks.told()
        first, second, third = (SceneUpdate.FromString(next(told)[2]) for _ in range(3))
    ((cube,), (sphere,)) = first.entities[0].cubes, first.entities[0].spheres
    assert (sphere.pose.position.x, sphere.pose.position.y, sphere.pose.position.z) == tip
    middle, size = cube.pose.position, cube.size
    assert (middle.x - size.x / 2, middle.y - size.y / 2, middle.z - size.z / 2) == pytest.approx(low)
    assert (middle.x + size.x / 2, middle.y + size.y / 2, middle.z + size.z / 2) == pytest.approx(high)
    assert len(second.entities[0].spheres) == 1 and not second.entities[0].cubes
    assert not third.entities and third.deletions[0].type == 1


# -- wrong words of `lab watch`
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--bind", "here"], "--bind here: must be an address"),
        (["--bind", "192.0.2.1"], "cannot listen there"),
        (["--port", "70000"], "--port 70000"),
        (["--speed", "0"], "--speed 0"),
        (["--speed", "nan"], "--speed nan"),
        (["--foxglove", "70000"], "--foxglove 70000: must be 0"),
        (["--foxglove", "0", "--bind", "0.0.0.0"], "Foxglove has no secret"),
    ],
)
def test_wrong_words_get_one_clear_error(words: list[str], says: str, cli: Cli) -> None:
    assert says in cli("watch", OLD, *words, code=2).flat_err


def test_a_port_that_is_taken_is_told(cli: Cli) -> None:
    with Foxglove(LOOPBACK, 0) as foxglove:
        port = foxglove.address.rpartition(":")[2]
        assert f"--foxglove {port}: cannot listen there" in cli("watch", OLD, "--foxglove", port, code=2).flat_err


def test_without_its_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert "pip install 'softlab[live]'" in cli("watch", OLD, "--foxglove", "0", code=2).flat_err


# -- the layout
PART = re.compile(r"\.(\w+)|\[(\d+)\]|\{(\w+)==\w+\}")


def paths(node: Any) -> Iterator[str]:
    """Of the series of all panels."""
    if isinstance(node, dict):
        if isinstance(node.get("value"), str):
            yield node["value"]
        node = list(node.values())
    if isinstance(node, list):
        for item in node:
            yield from paths(item)


def parts(path: str) -> tuple[str, list[tuple[str, str, str]]]:
    topic = re.match(r"[/\w]+", path)
    assert topic is not None
    rest = path[topic.end() :]
    assert PART.sub("", rest) == "", path
    return topic[0], PART.findall(rest)


LAID_OUT = json.loads(LAYOUT.read_text())
PATHS = sorted(set(paths(LAID_OUT["configById"])))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with all topics that there are."""
    with Recorder(tmp_path_factory.mktemp("layout") / "run.mcap", start_wall_ns=10**18, markers=2) as recorder:
        return recorder.path


def described(schema: Schema) -> Descriptor:
    """The kind of message that a schema describes."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)  # type: ignore[no-untyped-call]
    return pool.FindMessageTypeByName(schema.name)  # type: ignore[no-untyped-call, no-any-return]


@pytest.mark.parametrize("path", PATHS)
def test_a_path_of_the_layout_names_a_number_of_the_recording(path: str, written: Path) -> None:
    topic, steps = parts(path)
    message = SceneUpdate.DESCRIPTOR if topic == EXPECTED else described(in_file(written)[1][topic][1])
    field, many = None, False
    for name, index, filtered in steps:
        if name:
            assert message is not None and not many, path
            field = message.fields_by_name[name]
            message, many = field.message_type, field.is_repeated
        elif index:
            assert many, path
            most = streams()[topic].dtype[field.name].shape if field is not None and topic in streams() else (1,)
            assert int(index) < most[0]
            many = False
        else:
            assert message is not None and filtered in message.fields_by_name
    assert field is not None and not many and message is None, path
    shown_as_state = path == "/request.kind"  # not as a number
    assert field.type != FieldDescriptor.TYPE_BYTES and (field.type == FieldDescriptor.TYPE_STRING) == shown_as_state


def test_what_the_layout_shows_of_a_real_recording_are_its_numbers() -> None:
    messages, channels = in_file(OLD)
    newest = {topic: payload for topic, _, payload in messages}
    shown = 0
    for path in PATHS:
        topic, steps = parts(path)
        if topic not in newest:
            continue
        value = GetMessageClass(described(channels[topic][1])).FromString(newest[topic])
        for name, index, _ in steps:
            value = getattr(value, name) if name else value[int(index)] if index else value
        assert np.isfinite(float(value)), path
        shown += 1
    assert shown >= 30
    assert {"/tip", "/pressure", "/force", "/spine", "/vacuum"} <= newest.keys() & {parts(path)[0] for path in PATHS}


def test_every_panel_has_its_place() -> None:
    def places(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else [p for side in ("first", "second") for p in places(node[side])]

    assert sorted(places(LAID_OUT["layout"])) == sorted(LAID_OUT["configById"])
    assert LAID_OUT["configById"]["RosOut!log"]["topicToRender"] == "/log"
