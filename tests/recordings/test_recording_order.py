"""Equal messages give equal tables, in whatever order of chunks, however they are packed, and from a version of years ago; the
instrument's clock is found below the delays of the wire, and wall time may jump as it likes."""

import hashlib
import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Message
from mcap.writer import CompressionType, IndexType
from synthetic_run import OLD, STREAMS, TARGETS, Run, rewritten, state

from recordings import events
from recordings.campaign.info import info
from recordings.campaign.replay import compare, replay_states, table_of
from recordings.errors import MissingStream, OtherVersion
from recordings.file import samples
from recordings.file.clocks import aligned, fit
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.messages import TIP, VACUUM, Field
from recordings.states.concluding import conclude
from recordings.states.rules import Settled, Window
from recordings.trials import Table
from tests.simulated.bench import raises


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
    change = {} if numbers else {"change": lambda _, __, message: setattr(message, "sequence", 0)}
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
    raises(OtherVersion, "another message", samples.decode, VACUUM, recording.contents.schemas[channel.schema_id], [b""], 1)


# ------------------------------------------------------------------ clocks
@settings(max_examples=25)
@given(st.floats(-1e4, 1e4), st.floats(-2e-4, 2e-4), st.integers(0, 2**31))
def test_offset_and_drift_are_found_below_delays_of_any_size(offset: float, drift: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    device = 5e3 + np.arange(0, 120, 0.008)
    delay = 0.4e-3 + random.exponential(3e-3, len(device))
    model = fit(device, device + offset + drift * (device - device[0]) + delay)
    assert model.drift == pytest.approx(drift, abs=2e-6)
    assert model.offset == pytest.approx(offset + 0.4e-3, abs=0.1e-3)
    assert model.residual == pytest.approx(3e-3 * np.log(2), rel=0.1)


def test_no_sample_arrives_before_the_model_says_it_was_taken() -> None:
    random = np.random.default_rng(3)
    device = np.cumsum(random.uniform(0.005, 0.02, 5000))
    host = device * (1 + 5e-5) + 7.0 + random.gamma(2, 1e-3, 5000)
    model = fit(device, host)
    assert model is not None and (host - model.host(device)).min() > -1e-9
    assert np.abs(model.host(device) - (device * (1 + 5e-5) + 7.0)).max() < 0.3e-3


def test_a_clock_that_restarts_is_modelled_since_then_and_too_few_samples_give_none() -> None:
    device = np.concatenate([np.arange(1000, 1010, 0.01), np.arange(0, 10, 0.01)])
    host = np.arange(2000) * 0.01
    model = fit(device, host)
    assert model is not None and model.restarts == 1 and model.samples == 1000
    assert model.offset == pytest.approx(10.0) and model.drift == pytest.approx(0.0, abs=1e-9)
    assert fit(device[:5], host[:5]) is None
    assert fit(np.full(100, 3.0), host[:100]) is None


def test_the_model_is_stored_in_the_file_and_aligns_its_stream(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    taken = np.arange(1.0, 11.0, 0.01)
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        for k, t in enumerate(taken.tolist()):
            arrived = round(t + random.exponential(2e-3) * (k % 5 > 0), 9)
            values = (t + 500.0, k, (0.0, 0.0, 0.4), (1.0, 0.0, 0.0, 0.0), 1e-4, True, ())
            recorder.push("/tip", max(arrived, recorder.buffers.newest("/tip")), values)
    recording = Recording.open(tmp_path / "a.mcap")
    model = info(tmp_path / "a.mcap").clocks["/tip"]
    assert json.loads(recording.metadata["clocks"]["/tip"]) == asdict(model)
    assert np.abs(recording.stream("/tip")["t"] - taken).max() > 5e-3
    assert np.abs(aligned(recording, "/tip") - taken).max() < 1e-5
    raises(MissingStream, "/pressure", aligned, recording, "/pressure")


def test_a_step_of_wall_time_by_an_hour_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = state(rule=Window(0.2, 0.5), topics=("/pressure",))

    def run(path: Path, step: float) -> tuple[str, list[int]]:
        with monkeypatch.context() as patch, Recorder(path, start_wall_ns=10**18) as recorder:
            real, real_ns = time.time, time.time_ns
            for k in range(200):
                if k == 60:
                    patch.setattr(time, "time", lambda: real() + step)
                    patch.setattr(time, "time_ns", lambda: real_ns() + round(step * 1e9))
                recorder.push("/pressure", k * 0.01, (TARGETS, tuple(p + k for p in TARGETS)))
            row = conclude(recorder.buffers, asked)
        return row.to_json(), Recording.open(path).log_times("/pressure").tolist()

    plain = run(tmp_path / "plain.mcap", 0.0)
    assert run(tmp_path / "forward.mcap", 3600.0) == plain == run(tmp_path / "back.mcap", -3600.0)
