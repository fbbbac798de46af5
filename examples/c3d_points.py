"""Marker positions out of a C3D file: just what motion-capture exports of the examples need.

The C3D header (512 bytes) tells how many points a frame holds, where the frames begin and whether they are floats; see the
C3D file format user guide (c3d.org). Files in the byte order of Intel processors only.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

BLOCK = 512
C3D_KEY = 80
INTEL = 84


def read_points(path: Path) -> tuple[float, NDArray[np.float64]]:
    """Frame rate (Hz) and positions (frames, points, 3) in the file's unit, NaN where a marker was not seen.

    Raises ValueError for a file that is not C3D, or in another byte order or number format.
    """
    data = path.read_bytes()
    if len(data) < 2 * BLOCK or data[1] != C3D_KEY:
        raise ValueError(f"{path}: is not a C3D file (second byte is not {C3D_KEY})")
    parameters = (data[0] - 1) * BLOCK
    if data[parameters + 3] != INTEL:
        raise ValueError(
            f"{path}: numbers are in processor format {data[parameters + 3]}, only {INTEL} (Intel) is read"
        )
    points, analog, first, last = struct.unpack_from("<4H", data, 2)
    (scale,) = struct.unpack_from("<f", data, 12)
    start, _ = struct.unpack_from("<2H", data, 16)
    (rate,) = struct.unpack_from("<f", data, 20)
    if scale >= 0:
        raise ValueError(f"{path}: positions are integers (scale {scale:g}); export them as floats")
    frames, width = last - first + 1, 4 * points + analog
    numbers = np.frombuffer(data, "<f4", frames * width, (start - 1) * BLOCK).reshape(frames, width)
    rows = numbers[:, : 4 * points].reshape(frames, points, 4).astype(np.float64)
    return rate, np.where(rows[:, :, 3:] < 0, np.nan, rows[:, :, :3])
