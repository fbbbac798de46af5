"""Streams of sensors of a lab's own: their message from name and quantities, and back from a file's schema."""

from __future__ import annotations

import pytest

from recordings.errors import BadMessage
from recordings.messages import FORCE, is_stream, message_name, sensor, stream_message, streams

SKIN = sensor("skin", {"temperature": "K", "humidity": "1"})


def test_a_file_s_schema_gives_the_message_back() -> None:
    units = {key.removeprefix("unit."): text for key, text in SKIN.metadata.items() if key.startswith("unit.")}
    assert stream_message("/sensor/skin", SKIN.schema, units) == SKIN
    assert stream_message("/force", b"", {}) is FORCE
    assert message_name("/sensor/skin") == SKIN.full_name and message_name("/state") is None


def test_its_samples_are_numbers_by_name() -> None:
    samples = SKIN.decode(SKIN.encode(1.5, (296.4, 0.38)))
    assert samples[0].tolist() == (1.5, 296.4, 0.38)
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
    with pytest.raises(BadMessage, match=words):
        sensor(name, quantities)


@pytest.mark.parametrize("schema", [b"\xff\xff\xff", b"", FORCE.schema[:-4], b"\x0a\x00"])
def test_a_schema_that_is_none_is_refused(schema: bytes) -> None:
    with pytest.raises(BadMessage, match=r"/sensor/skin: its schema"):
        stream_message("/sensor/skin", schema, {})
