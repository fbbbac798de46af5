"""The figures of the recordings: `python -m benchmarks.recording [--quick] [--json FILE]`.

Exit code 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

from ..figures import Figure, show
from . import speed
from .stream import record

HOUR, SHORT = 3600.0, 120.0


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    p = argparse.ArgumentParser(description="Measures the figures of the recordings.")
    p.add_argument("--quick", action="store_true", help="ten seconds instead of a minute")
    p.add_argument("--json", type=Path, default=Path("out/recording.json"), help="where the table is written as JSON")
    p.add_argument("--only", default="", help="figures whose name has this word")
    a = p.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="recording-") as name:
        folder = Path(name)
        hour, short = folder / "hour.mcap", folder / "short.mcap"

        def made(path: Path, seconds: float) -> Path:
            if not path.exists():
                record(path, seconds)
            return path

        wall = 10.0 if a.quick else 60.0
        todo: dict[str, Callable[[], Figure]] = {
            "start": lambda: speed.start_up(folder),
            "paced": lambda: speed.paced(folder, wall),
            "reading": lambda: speed.reading(made(hour, HOUR), made(short, SHORT)),
            "table": lambda: speed.table(made(hour, HOUR)),
        }
        figures = [measure() for name, measure in todo.items() if a.only in name]
    return show("Recordings", figures, a.json)


if __name__ == "__main__":
    raise SystemExit(main())
