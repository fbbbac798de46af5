"""Topics of a recording of another robot as columns `/topic.field`, at the times of one of them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from numpy.typing import NDArray

from ..files.config import ConfigError
from .map_file import Source

Array = NDArray[np.float64]

LARGEST = 2_000_000_000
"""Bytes of a file."""
MOST_FIELDS = 500
"""Numbers of one message."""
STALE = 0.5
"""s beyond which a reading of another topic is too old to stand beside one."""
DECODERS = {"ros2": "mcap_ros2.decoder", "ros1": "mcap_ros1.decoder", "protobuf": "mcap_protobuf.decoder"}
"""Package by encoding; JSON needs none."""


def read_topics(path: Path, source: Source) -> dict[str, Array]:
    """(n,) numbers of all topics at the log times of `source.topic`, or of the topic with most messages that has positions."""
    if not path.is_file():
        raise ConfigError(f"{path}: cannot be read; check the path")
    if path.stat().st_size > LARGEST:
        raise ConfigError(f"{path}: has more than {LARGEST / 1e9:g} GB")
    times: dict[str, list[float]] = {}
    found: dict[str, list[dict[str, float]]] = {}
    unread: dict[str, str] = {}
    try:
        for topic, t, message in _messages(path, unread):
            times.setdefault(topic, []).append(t)
            found.setdefault(topic, []).append(message)
    except (McapError, ValueError, EOFError, struct.error) as e:
        raise ConfigError(f"{path}: cannot be read as MCAP ({type(e).__name__}: {e})") from e
    topics = {t: rows for t, rows in found.items() if any(rows)}
    if not topics:
        why = "; ".join(f"{what}: {why}" for what, why in unread.items())
        raise ConfigError(f"{path}: no topic holds numbers that can be read{f' ({why})' if why else ''}")
    if source.topic is not None and source.topic not in topics:
        raise ConfigError(
            f"{path}: has no topic {source.topic!r} with numbers (source.topic); it has {', '.join(topics)}"
        )
    leading = source.topic or max(topics, key=lambda t: (_places(topics[t]), len(topics[t])))
    start = min(min(own) for own in times.values())
    at = np.array(times[leading])
    out: dict[str, Array] = {"time": at - start}
    for topic, rows in topics.items():
        own = np.array(times[topic])
        names = list(dict.fromkeys(name for row in rows for name in row))
        for name in names:
            values = np.array([row.get(name, np.nan) for row in rows])
            out[f"{topic}.{name}"] = values if topic == leading else _at(at, own, values)
    return out


def _places(rows: list[dict[str, float]]) -> int:
    """1 for a topic whose messages hold a position."""
    return int(any(name.endswith(("position.x", "translation.x", "tip_1", ".x")) or name == "x" for name in rows[0]))


def _at(at: Array, times: Array, values: Array) -> Array:
    """Values at other times; NaN where the nearest reading is older than `STALE`."""
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    seen = np.isfinite(values)
    if not seen.any():
        return np.full(len(at), np.nan)
    times, values = times[seen], values[seen]
    after = np.clip(np.searchsorted(times, at), 0, len(times) - 1)
    before = np.clip(after - 1, 0, None)
    far = np.minimum(np.abs(times[after] - at), np.abs(times[before] - at)) > STALE
    return np.where(far, np.nan, np.interp(at, times, values))


def _messages(path: Path, unread: dict[str, str]) -> Iterator[tuple[str, float, dict[str, float]]]:
    """Topic, s, numbers by field of each message that can be read; encodings that cannot, and why, go to `unread`."""
    with open(path, "rb") as file:
        reader = make_reader(file)
        decoders: dict[int, Any] = {}
        for schema, channel, message in reader.iter_messages():
            encoding = channel.message_encoding
            if encoding == "json":
                decoded: Any = json.loads(message.data)
            else:
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(encoding, schema, unread)
                decode = decoders[channel.id]
                if decode is None:
                    continue
                decoded = decode(message.data)
            yield channel.topic, message.log_time / 1e9, dict(_numbers("", decoded))


def _decoder(encoding: str, schema: Any, unread: dict[str, str]) -> Any:
    own = {"cdr": "ros2", "ros1": "ros1", "protobuf": "protobuf"}.get(encoding)
    if own is None:
        unread[encoding] = "messages of this encoding are not read"
        return None
    try:
        factory = import_module(DECODERS[own]).DecoderFactory()
    except ImportError:
        unread[encoding] = f"needs the package of {DECODERS[own].partition('.')[0]}; pip install 'softlab[import]'"
        return None
    return factory.decoder_for(encoding, schema)


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Numbers of a message by the path of their fields, lists from 1."""
    if isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else str(key), inner)
    elif isinstance(value, list | tuple | np.ndarray):
        for i, inner in enumerate(value[:MOST_FIELDS], 1):
            yield from _numbers(f"{name}.{i}" if name else str(i), inner)
    elif hasattr(value, "DESCRIPTOR"):
        for field in value.DESCRIPTOR.fields:
            yield from _numbers(f"{name}.{field.name}" if name else field.name, getattr(value, field.name))
    elif hasattr(value, "__slots__"):
        for slot in value.__slots__:
            yield from _numbers(f"{name}.{slot}" if name else slot, getattr(value, slot))
    elif hasattr(value, "__iter__") and not isinstance(value, str | bytes):
        yield from _numbers(name, list(value))
