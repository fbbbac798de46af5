"""Every message has one definition, from which schema, bytes and arrays agree, also those of a lab's own sensors."""

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from recordings.errors import BadMessage
from recordings.messages import FORCE, STREAMS, Field, MessageType, is_stream, message_name, sensor, stream_message, streams
from tests.simulated.bench import raises

MESSAGES = streams(chambers=6, markers=2)
DOUBLES = st.floats(allow_nan=True, width=64)
KINDS: dict[str, st.SearchStrategy[Any]] = {
    "double": DOUBLES,
    "sfixed64": st.integers(-(2**63), 2**63 - 1),
    "fixed32": st.integers(0, 2**32 - 1),
    "bool": st.booleans(),
}


def value_of(field: Field) -> st.SearchStrategy[Any]:
    one = KINDS[field.kind]
    for size in reversed(field.shape):
        one = st.tuples(*[one] * size)
    return one


def independent(message: MessageType) -> Callable[[bytes], Any]:
    schema = Schema(id=1, data=message.schema, encoding="protobuf", name=message.full_name)
    decoder = DecoderFactory().decoder_for("protobuf", schema)
    if decoder is None:
        raise LookupError(message.topic)
    return decoder


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit, NaN included."""
    if isinstance(a, float):
        return struct.pack("<d", a) == struct.pack("<d", b) or (math.isnan(a) and math.isnan(b))
    return bool(a == b)


@pytest.mark.parametrize("topic", MESSAGES)
@settings(max_examples=25)
@given(data=st.data())
def test_an_independent_protobuf_decoder_and_the_array_give_back_the_values(topic: str, data: st.DataObject) -> None:
    message = MESSAGES[topic]
    values = data.draw(st.tuples(*map(value_of, message.fields[1:])))
    t = data.draw(st.floats(0, 1e6))
    payload = message.encode(t, values)
    assert len(payload) == message.size and message.fits(np.frombuffer(payload, np.uint8).reshape(1, -1))
    parsed, row = independent(message)(payload), message.decode(payload)[0]
    assert same(parsed.t, t) and same(float(row["t"]), t)
    for field, value in zip(message.fields[1:], values, strict=True):
        expected = np.array(value, dtype=object).reshape(-1).tolist() if field.shape else [value]
        by_runtime = list(getattr(parsed, field.name)) if field.shape else [getattr(parsed, field.name)]
        by_array = row[field.name].reshape(-1).tolist() if field.shape else [row[field.name].item()]
        assert len(expected) == len(by_runtime) == len(by_array)
        assert all(same(a, b) and same(a, c) for a, b, c in zip(expected, by_runtime, by_array, strict=True))


@pytest.mark.parametrize("topic", MESSAGES)
def test_the_protobuf_runtime_writes_the_same_bytes(topic: str) -> None:
    message = MESSAGES[topic]
    values = [np.ones(f.shape).tolist() if f.shape else (True if f.kind == "bool" else 7) for f in message.fields[1:]]
    payload = message.encode(0.0, values)
    assert independent(message)(payload).SerializeToString() == payload


def test_a_tag_that_differs_is_noticed() -> None:
    message = STREAMS["/vacuum"]
    payload = bytearray(message.encode(1.0, (2.0,)))
    payload[9] ^= 1
    assert not message.fits(np.frombuffer(bytes(payload), np.uint8).reshape(1, -1))


def test_a_tip_without_body_markers_has_no_bytes_for_them() -> None:
    message = STREAMS["/tip"]
    payload = message.encode(0.0, (0.0, 1, (1, 2, 3), (1, 0, 0, 0), 0.0, True, ()))
    assert list(independent(message)(payload).markers) == []
    assert message.decode(payload)["markers"].shape == (1, 0, 3)


@pytest.mark.parametrize(
    ("topic", "values", "word"),
    [
        ("/vacuum", (), "absolute"),
        ("/vacuum", ("high",), "absolute"),
        ("/pressure", ((0.0,) * 8, (0.0,) * 9), "setpoint"),
        ("/pressure", (0.0, (0.0,) * 9), "setpoint"),
        ("/tip", (0.0, 1.5, (1, 2, 3), (1, 0, 0, 0), 0.0, True, ()), "frame"),
        ("/tip", (0.0, 1, (1, 2, 3), (1, 0, 0, 0), 0.0, True, ((0, 0, 0),)), "markers"),
        ("/arm", (0.0, (0,) * 6, (0,) * 6, (0,) * 6, -1, True), "safety_bits"),
    ],
)
def test_values_that_do_not_fit_are_refused_with_the_name_of_the_field(topic: str, values: tuple[object, ...], word: str) -> None:
    assert topic in raises(BadMessage, word, STREAMS[topic].encode, 0.0, values)


def test_units_and_version_are_in_the_channel_metadata() -> None:
    metadata = MESSAGES["/pressure"].metadata
    assert metadata["unit.measured"] == "Pa" and metadata["shape.measured"] == "6" and metadata["schema_version"] == "1"


SKIN = sensor("skin", {"temperature": "K", "humidity": "1"})


def test_a_file_s_schema_gives_the_message_back() -> None:
    units = {key.removeprefix("unit."): text for key, text in SKIN.metadata.items() if key.startswith("unit.")}
    assert stream_message("/sensor/skin", SKIN.schema, units) == SKIN
    assert stream_message("/force", b"", {}) is FORCE
    assert message_name("/sensor/skin") == SKIN.full_name and message_name("/state") is None


def test_its_samples_are_numbers_by_name() -> None:
    assert SKIN.decode(SKIN.encode(1.5, (296.4, 0.38)))[0].tolist() == (1.5, 296.4, 0.38)
    assert streams(sensors=[SKIN])["/sensor/skin"] is SKIN and is_stream("/sensor/skin") and not is_stream("/log")


@pytest.mark.parametrize(
    ("name", "quantities", "words"),
    [
        ("Skin", {"x": "m"}, "'Skin' must be lower-case letters"),
        ("skin", {"": "m"}, "'' must be lower-case letters"),
        ("skin", {"t": "s"}, "'t' must be lower-case letters"),
        ("skin", {}, "measures 0 quantities"),
        ("skin", {f"q{i}": "1" for i in range(101)}, "measures 101 quantities"),
    ],
)
def test_what_cannot_be_a_column_is_refused(name: str, quantities: dict[str, str], words: str) -> None:
    raises(BadMessage, words, sensor, name, quantities)


@pytest.mark.parametrize("schema", [b"\xff\xff\xff", b"", FORCE.schema[:-4], b"\x0a\x00"])
def test_a_schema_that_is_none_is_refused(schema: bytes) -> None:
    raises(BadMessage, r"/sensor/skin: its schema", stream_message, "/sensor/skin", schema, {})
