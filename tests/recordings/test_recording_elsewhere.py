"""Other people's software reads the recordings: counts, order, sums, attachments, metadata, and fields by name.

The reader in JavaScript needs node and the packages @mcap/core, @mcap/support and protobufjs; say where they are with
SOFTLAB_NODE_MODULES=<folder>/node_modules.
"""

import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from mcap.reader import make_reader
from synthetic_run import OLD, Run

from recordings.events import EVENTS
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.messages import STREAMS

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def node_modules() -> Path:
    place = os.environ.get("SOFTLAB_NODE_MODULES")
    if shutil.which("node") is None or not place:
        pytest.skip("the independent reader needs node and SOFTLAB_NODE_MODULES=<folder>")
    return Path(place)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("elsewhere") / "run.mcap"
    files = {"rig.yaml": b"clock: {speed: 1}\n", "robot.yaml": b"name: r\n", "empty": b""}
    about = {"versions": {"softlab": "0.1", "text": 'with "quotes" and umlauts äöü'}}
    with Recorder(path, start_wall_ns=10**18 + 7, attachments=files, metadata=about, markers=2) as recorder:
        for k, (topic, t, values) in enumerate(Run(duration=3.0).messages()):
            recorder.push(topic, t, values)
            if k % 100 == 0:
                recorder.log("info", f"line {k}")
    return path


def read_by_node(file: Path, modules: Path) -> Any:
    command = ["node", str(HERE / "independent" / "read.cjs"), str(file)]
    environment = os.environ | {"NODE_PATH": str(modules)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def sums(recording: Recording) -> dict[str, dict[str, float]]:
    """Of every number of every stream, added in the order of the file; NaN does not count."""
    out: dict[str, dict[str, float]] = {}
    for topic in STREAMS.keys() & recording.streams:
        samples = recording.stream(topic)
        of = {name: [v for v in samples[name].ravel().astype(float).tolist() if v == v] for name in samples.dtype.names or ()}
        out[topic] = {name: sum(numbers) for name, numbers in of.items() if numbers}
    return out


def check_by_node(file: Path, modules: Path) -> None:
    recording, found = Recording.open(file), read_by_node(file, modules)
    assert found["inOrder"] and int(found["messages"]) == sum(topic["count"] for topic in found["topics"].values())
    counts = {topic: len(recording.log_times(topic)) for topic in recording.topics}
    assert {name: topic["count"] for name, topic in found["topics"].items()} == {t: n for t, n in counts.items() if n}
    for name, topic in found["topics"].items():
        log_times = recording.log_times(name)
        assert (int(topic["first"]), int(topic["last"])) == (log_times[0], log_times[-1])
        assert topic["encoding"] == "protobuf"
    for name, expected in sums(recording).items():
        assert found["topics"][name]["sums"] == expected, name
    assert found["attachments"] == {n: hashlib.sha256(d).hexdigest() for n, d in recording.attachments.items()}
    assert found["metadata"] == recording.metadata


def test_an_independent_reader_finds_equal_counts_order_sums_attachments_and_metadata(path: Path, node_modules: Path) -> None:
    check_by_node(path, node_modules)
    topics = read_by_node(path, node_modules)["topics"]
    assert topics["/force"]["metadata"]["unit.raw"] == "N, N m" and topics["/arm"]["schema"] == "lab.Arm"
    assert topics["/arm/joints"]["schema"] == "foxglove.JointStates"


def test_the_independent_reader_reads_the_old_version(node_modules: Path) -> None:
    check_by_node(OLD, node_modules)


def test_every_channel_is_described_as_viewers_need_it(path: Path) -> None:
    """What Foxglove and Lichtblick demand: protobuf in protobuf, a schema of that full name with all files that it depends on."""
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.chunk_indexes and summary.statistics is not None
    assert {channel.topic for channel in summary.channels.values()} >= {*STREAMS, *EVENTS}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf"), channel.topic
        pool = DescriptorPool()
        for part in FileDescriptorSet.FromString(schema.data).file:
            pool.Add(part)  # type: ignore[no-untyped-call]  # raises for a file whose imports are not there before it
        assert pool.FindMessageTypeByName(schema.name).fields_by_name, channel.topic  # type: ignore[no-untyped-call]
