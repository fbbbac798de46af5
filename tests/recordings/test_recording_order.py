"""Equal messages give equal tables, in whatever order of chunks, however they are packed, and from a version of years ago."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.records import Message
from mcap.writer import CompressionType, IndexType
from synthetic_run import OLD, STREAMS, Run, rewritten, state

from recordings import events
from recordings.campaign.info import info
from recordings.campaign.replay import compare, replay_states, table_of
from recordings.errors import OtherVersion
from recordings.file import samples
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.messages import TIP, VACUUM, Field
from recordings.states.rules import Settled
from recordings.trials import Table


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with three states, their rows, and log lines of equal log times."""
    path = tmp_path_factory.mktemp("order") / "run.mcap"
    rule = Settled(band=1500.0, still=0.8, still_distance=0.8e-3, smooth=8, average=0.5, min_samples=4, timeout=20.0)
    with Recorder(path, start_wall_ns=10**18, markers=2) as recorder:
        for topic, t, values in Run().messages():
            recorder.push(topic, t, values)
        for step, begin in enumerate((3.0, 5.0, 7.0), 1):
            recorder.state(10.0, state(rule=rule, step=step, t_start=begin, ramp_end=3.0, spine_length=0.2))
            recorder.log("info", f"line {step}", t=10.0)
    rows = {again.number: again.row for again in replay_states(Recording.open(path)) if again.row is not None}
    assert len(rows) == 3
    encoded = [events.encoded(events.TRIAL, row, t=11.0, number=n, json=row.to_json()) for n, row in rows.items()]
    return rewritten(path, path.with_name("whole.mcap"), more=[("/trial", p, n) for n, p in zip(rows, encoded, strict=True)])


def unnumbered(topic: str, number: int, message: Message) -> None:
    message.sequence = 0


SMALL = {"seed": 1, "chunk_size": 700}
BARE = dict.fromkeys(("use_statistics", "repeat_channels", "repeat_schemas", "enable_crcs"), False)


@pytest.mark.parametrize(
    ("how", "numbers"),
    [
        pytest.param(SMALL, True, id="small chunks"),
        pytest.param(SMALL, False, id="small chunks without numbers"),
        pytest.param({"seed": 2, "chunk_size": 5000, "compression": CompressionType.LZ4}, False, id="lz4"),
        pytest.param({"seed": 3, "chunk_size": 2**22, "compression": CompressionType.NONE}, True, id="one chunk"),
        pytest.param({"chunk_size": 900}, False, id="packed anew"),
        pytest.param({"chunk_size": 4000, "index_types": IndexType.NONE}, True, id="no index"),
        pytest.param(BARE, True, id="no summary"),
    ],
)
def test_tables_replay_and_what_is_played_do_not_depend_on_the_order_in_the_file(
    run: Path, tmp_path: Path, how: dict[str, object], numbers: bool
) -> None:
    change = {} if numbers else {"change": unnumbered}
    a = Recording.open(rewritten(run, tmp_path / "a.mcap", **change))
    b = Recording.open(rewritten(run, tmp_path / "b.mcap", **change, **how))
    for topic in STREAMS:
        one, other = a.stream(topic), b.stream(topic)
        assert all(one[name].tobytes() == other[name].tobytes() for name in one.dtype.names or ())
        assert a.log_times(topic).tolist() == b.log_times(topic).tolist()
    assert [r.to_json() for r in table_of(a)] == [r.to_json() for r in table_of(b)]
    assert [s.number for s in a.states] == [s.number for s in b.states] == [1, 2, 3]
    assert [line.text for line in a.log] == [line.text for line in b.log]
    assert replay_states(a) == replay_states(b)
    assert compare(a).equal and compare(b).equal and compare(b).live == 3


# ------------------------------------------------------------------ counts
def test_numbers_that_go_back_in_time_are_a_stream_that_began_anew(run: Path, tmp_path: Path) -> None:
    assert {topic: s.restarts for topic, s in info(run).streams.items() if s.restarts} == {}
    shuffled = rewritten(run, tmp_path / "a.mcap", seed=1, chunk_size=700)
    assert not any(s.restarts for s in info(shuffled).streams.values())
    count = len(Recording.open(run).log_times("/vacuum"))

    def begun_anew(topic: str, number: int, message: Message) -> None:
        message.sequence = 1 + number % (count // 2)

    twice = rewritten(run, tmp_path / "b.mcap", begun_anew, topics=["/vacuum"])
    assert info(twice).streams["/vacuum"].restarts >= 1
    rescued = recover(twice, tmp_path / "c.mcap")
    assert rescued.lost == {} and rescued.messages["/vacuum"] == count


def test_counts_below_zero_in_a_file_are_no_counts_and_verify_says_so(run: Path, tmp_path: Path) -> None:
    told = json.dumps({"lost": -5, "dropped": -1, "written": -2, "generated": 3})
    path = rewritten(run, tmp_path / "b.mcap", topics=["/vacuum"], metadata={"counts": {"/vacuum": told}}, enable_data_crcs=True)
    found = info(path).streams["/vacuum"]
    assert found.lost is None and found.dropped is None
    texts = [p.text for p in verify(path).problems]
    assert any("lost is given as -5" in text for text in texts) and any("written is given as -2" in text for text in texts)


ROWS = "da6d84d895c56a82090180ffc0f5f7c9d00ac08e6b23e46202a8829fd361d3a4"
"""sha256 of its rows, concluded by the version that wrote it."""


def test_it_reads_in_full() -> None:
    recording = Recording.open(OLD)
    assert recording.metadata["recording"]["schema_version"] == "1"
    counts = {topic: len(recording.stream(topic)) for topic in STREAMS}
    assert counts == {"/pressure": 90, "/tip": 112, "/spine": 22, "/vacuum": 22, "/force": 22, "/arm": 28}
    assert recording.stream("/tip")["markers"].shape == (112, 2, 3)
    assert [line.text for line in recording.log] == ["recording starts", "written by version 0.1.0"]
    assert verify(OLD).ok and info(OLD).complete


def test_its_state_is_concluded_as_it_was_then_to_the_last_bit() -> None:
    recording = Recording.open(OLD)
    assert compare(recording).equal
    rows = [again.row.to_json() for again in replay_states(recording) if again.row is not None]
    assert hashlib.sha256("\n".join(rows).encode()).hexdigest() == ROWS
    assert Table.of(e.row for e in recording.trials)["x"] == pytest.approx([0.0993], abs=1e-4)


def test_a_field_that_came_later_is_nan_or_zero_and_the_rest_is_as_it_was() -> None:
    recording = Recording.open(OLD)
    channel = next(c for c in recording.contents.channels.values() if c.topic == "/tip")
    schema = recording.contents.schemas[channel.schema_id]
    later = replace(TIP, fields=(*TIP.fields, Field("exposure", "double", (), "s"), Field("cameras", "fixed32")))
    payload = TIP.sized(markers=(0, 3)).encode(1.0, (1.0, 7, (1, 2, 3), (1, 0, 0, 0), 0.1, True, ()))
    (row,) = samples.decode(later, schema, [payload], 1)
    assert np.isnan(row["exposure"]) and row["cameras"] == 0
    assert row["frame"] == 7 and row["position"].tolist() == [1, 2, 3]


def test_a_message_that_is_another_one_altogether_is_refused() -> None:
    recording = Recording.open(OLD)
    channel = next(c for c in recording.contents.channels.values() if c.topic == "/log")
    with pytest.raises(OtherVersion, match="another message"):
        samples.decode(VACUUM, recording.contents.schemas[channel.schema_id], [b""], 1)
