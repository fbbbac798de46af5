"""Equal messages give equal tables, in whatever order of chunks, and however they are packed."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from synthetic_run import TARGETS, Run

from recordings import events
from recordings.campaign.info import info
from recordings.campaign.replay import compare, replay_states, table_of
from recordings.file.player import messages
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.states.rules import Settled, State
from recordings.trials import TrialRow

OLD = Path(__file__).parent / "data" / "bending-schema-1.mcap"
STREAMS = ("/pressure", "/tip", "/spine", "/vacuum", "/force", "/arm")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with three states, their rows, and log lines of equal log times."""
    path = tmp_path_factory.mktemp("order") / "run.mcap"
    rule = Settled(band=1500.0, still=0.8, still_distance=0.8e-3, smooth=8, average=0.5, min_samples=4, timeout=20.0)
    asked = State(
        trial=1, step=1, protocol="bending", repeat=1, branch="load", rule=rule, t_start=3.0, ramp_end=3.0, rate=25e3,
        targets=TARGETS, spine_length=0.2, tip_mass=0.053,
    )  # fmt: skip
    with Recorder(path, start_wall_ns=10**18, markers=2) as recorder:
        for topic, t, values in Run().messages():
            recorder.push(topic, t, values)
        for step, begin in enumerate((3.0, 5.0, 7.0), 1):
            recorder.state(10.0, replace(asked, step=step, t_start=begin))
            recorder.log("info", f"line {step}", t=10.0)
    states = replay_states(Recording.open(path))
    whole = path.with_name("whole.mcap")
    rows = {state.number: state.row for state in states}
    assert len(rows) == 3
    add_rows(path, whole, rows)
    return whole


def add_rows(source: Path, target: Path, rows: dict[int, TrialRow | None]) -> None:
    """A copy in which every state has its row."""
    kept = rewritten(source, target.with_name("copy.mcap"))
    payloads = [
        (n, events.encoded(events.TRIAL, row, t=11.0, number=n, json=row.to_json())) for n, row in rows.items() if row is not None
    ]
    rewritten(kept, target, more=[("/trial", payload, n) for n, payload in payloads])


def rewritten(
    source: Path,
    target: Path,
    seed: int | None = None,
    numbers: bool = True,
    more: list[tuple[str, bytes, int]] | None = None,
    **how: object,
) -> Path:
    """The same messages by the library's writer; with a seed in another order, so that its chunks hold others."""
    with open(source, "rb") as file, open(target, "wb") as out:
        reader = make_reader(file)
        found = list(reader.iter_messages(log_time_order=False))
        summary = reader.get_summary()
        assert summary is not None
        random.Random(seed).shuffle(found) if seed is not None else None
        writer = Writer(out, **how)  # type: ignore[arg-type]
        writer.start()
        for record in reader.iter_metadata():
            if record.name not in ("counts", "clocks"):
                writer.add_metadata(record.name, dict(record.metadata))
        channels: dict[str, int] = {}
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", number, channel.metadata)
        for _, channel, m in found:
            sequence = m.sequence if numbers else 0
            writer.add_message(channels[channel.topic], m.log_time, m.data, m.publish_time, sequence)
        for topic, data, sequence in more or []:
            writer.add_message(channels[topic], 10**18 + 11 * 10**9, data, 10**18 + 11 * 10**9, sequence)
        writer.finish()
    return target


@pytest.mark.parametrize("numbers", [True, False], ids=["numbered", "without numbers"])
@pytest.mark.parametrize(
    "how",
    [
        {"seed": 1, "chunk_size": 700},
        {"seed": 2, "chunk_size": 5000, "compression": CompressionType.LZ4},
        {"seed": 3, "chunk_size": 2**22, "compression": CompressionType.NONE},
        {"seed": None, "chunk_size": 900},
    ],
    ids=["small chunks", "lz4", "one chunk", "packed anew"],
)
def test_tables_replay_and_what_is_played_do_not_depend_on_the_order_in_the_file(
    run: Path, tmp_path: Path, how: dict[str, object], numbers: bool
) -> None:
    first = rewritten(run, tmp_path / "a.mcap", numbers=numbers)
    a, b = Recording.open(first), Recording.open(rewritten(run, tmp_path / "b.mcap", numbers=numbers, **how))
    for topic in STREAMS:
        one, other = a.stream(topic), b.stream(topic)
        assert all(one[name].tobytes() == other[name].tobytes() for name in one.dtype.names or ())
        assert a.log_times(topic).tolist() == b.log_times(topic).tolist()
    assert [r.to_json() for r in table_of(a)] == [r.to_json() for r in table_of(b)]
    assert [s.number for s in a.states] == [s.number for s in b.states] == [1, 2, 3]
    assert [line.text for line in a.log] == [line.text for line in b.log]
    assert replay_states(a) == replay_states(b)
    assert compare(a).equal and compare(b).equal and compare(b).live == 3
    assert [m.to_json() for m in messages(a)] == [m.to_json() for m in messages(b)]


def test_an_old_recording_in_another_order_is_concluded_to_the_same_bits(tmp_path: Path) -> None:
    a, b = Recording.open(OLD), Recording.open(rewritten(OLD, tmp_path / "b.mcap", seed=4, chunk_size=600))
    assert replay_states(a) == replay_states(b) and compare(b).equal
    assert [r.to_json() for r in table_of(a)] == [r.to_json() for r in table_of(b)]


# ------------------------------------------------------------------ counts
def test_numbers_that_go_back_in_time_are_a_stream_that_began_anew(run: Path, tmp_path: Path) -> None:
    assert {topic: s.restarts for topic, s in info(run).streams.items() if s.restarts} == {}
    shuffled = rewritten(run, tmp_path / "a.mcap", seed=1, chunk_size=700)
    assert not any(s.restarts for s in info(shuffled).streams.values())
    twice = tmp_path / "b.mcap"
    with open(run, "rb") as file, open(twice, "wb") as out:
        writer = Writer(out)
        writer.start()
        writer.add_metadata("recording", {"start_wall_ns": str(10**18)})
        channel = None
        found = list(make_reader(file).iter_messages(["/vacuum"]))
        for i, (schema, old, m) in enumerate(found):
            assert schema is not None
            if channel is None:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channel = writer.register_channel(old.topic, "protobuf", number, old.metadata)
            writer.add_message(channel, m.log_time, m.data, m.publish_time, 1 + i % (len(found) // 2))
        writer.finish()
    assert info(twice).streams["/vacuum"].restarts >= 1
    rescued = recover(twice, tmp_path / "c.mcap")
    assert rescued.lost == {} and rescued.messages["/vacuum"] == len(found)


def test_a_recorder_takes_no_losses_below_zero(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0) as recorder:
        with pytest.raises(ValueError, match="/force: -3 lost samples"):
            recorder.note_lost("/force", -3)
        assert recorder.counts()["/force"].lost == 0


def test_counts_below_zero_in_a_file_are_no_counts_and_verify_says_so(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    with open(run, "rb") as file, open(path, "wb") as out:
        writer = Writer(out, enable_data_crcs=True)
        writer.start()
        told = {"lost": -5, "dropped": -1, "written": -2, "generated": 3}
        writer.add_metadata("counts", {"/vacuum": json.dumps(told)})
        for schema, channel, m in make_reader(file).iter_messages(["/vacuum"]):
            assert schema is not None
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            topic = writer.register_channel(channel.topic, "protobuf", number, channel.metadata)
            writer.add_message(topic, m.log_time, m.data, m.publish_time, m.sequence)
            break
        writer.finish()
    found = info(path).streams["/vacuum"]
    assert found.lost is None and found.dropped is None
    texts = [p.text for p in verify(path).problems]
    assert any("lost is given as -5" in text for text in texts) and any("written is given as -2" in text for text in texts)
