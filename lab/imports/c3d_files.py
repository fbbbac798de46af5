"""C3D files of motion capture: markers, and analog channels brought to the frames of the cameras."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from .map_file import Source
from .series import LARGEST, Series, package, unique

RATES = (0.01, 1e5)
"""Hz of cameras that can be."""


def read_c3d(path: Path, source: Source) -> Series:
    """Columns `time`, LABEL.x .. of each marker and the mean of each analog channel over a frame; raises ConfigError."""
    library = package("c3d", path)
    data = read_bounded(path, LARGEST, ConfigError)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            reader = library.Reader(io.BytesIO(data))
            # frames of no bytes would be read as often as the file claims
            if not reader.point_used and not reader.analog_used * reader.analog_per_frame:
                raise ConfigError(f"{path}: has neither markers nor analog channels; export the take again")
            frames = [(points, analog) for _, points, analog in reader.read_frames(copy=True)]
            labels, channels = _labels(reader, "POINT"), _labels(reader, "ANALOG")
            unit, units = "".join(_texts(reader, "POINT:UNITS")[:1]), _texts(reader, "ANALOG:UNITS")
            rate = float(reader.point_rate or 0.0)
    except ConfigError:
        raise
    except Exception as e:
        raise ConfigError(f"{path}: is not a C3D file ({type(e).__name__}: {str(e)[:200]}); export it again") from e
    if not frames:
        raise ConfigError(f"{path}: has no frames; export the take again")
    if not RATES[0] <= rate <= RATES[1]:
        raise ConfigError(f"{path}: states {rate:g} frames a second, which no camera has; export the take again")
    points = np.array([p for p, _ in frames], np.float64)
    seen = np.where(points[:, :, 3:4] < 0, np.nan, points[:, :, :3])
    columns = {"time": np.arange(len(seen)) / rate}
    for k, label in enumerate(unique(labels, seen.shape[1])):
        columns |= {f"{label}.{axis}": seen[:, k, i] for i, axis in enumerate("xyz")}
    known = dict.fromkeys([c for c in columns if c != "time"], unit) if unit else {}
    if frames[0][1].size:
        means = np.array([a.mean(axis=1) for _, a in frames], np.float64)
        for k, label in enumerate(unique(channels, means.shape[1])):
            name = label if label not in columns else f"{label} (analog)"
            columns[name] = means[:, k]
            if k < len(units) and units[k]:
                known[name] = units[k]
    return Series(path, columns, f"C3D, {rate:g} Hz", known)


def _texts(reader: Any, key: str) -> list[str]:
    """Texts of a parameter, none where it is missing or no text."""
    found = reader.get(key)
    if found is None:
        return []
    try:
        return [str(t).strip(" \0") for t in found.string_array.reshape(-1)]
    except (TypeError, ValueError, AttributeError, UnicodeDecodeError):
        return []


def _labels(reader: Any, group: str) -> list[str]:
    """Labels of more than 255 markers go on in LABELS2 .."""
    return [t for k in ("", *range(2, 10)) for t in _texts(reader, f"{group}:LABELS{k}")]
