"""A recording of schema version 1, written before clock models and views for markers and joints, and kept since."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from synthetic_run import OLD, STREAMS

from recordings.campaign.info import info
from recordings.campaign.replay import compare, replay_states
from recordings.errors import OtherVersion
from recordings.file import samples
from recordings.file.reader import Recording
from recordings.file.verify import verify
from recordings.messages import TIP, VACUUM, Field
from recordings.trials import Table

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
    assert Table(tuple(e.row for e in recording.trials))["x"] == pytest.approx([0.0993], abs=1e-4)


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
