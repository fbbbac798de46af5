"""Figures that were promised, what was measured, and the files and tables of them."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Figure:
    """One line of the table."""

    name: str
    target: str
    measured: str
    met: bool
    values: dict[str, float]
    """The numbers behind it."""


def write(path: Path, key: str, found: Sequence[Any], **more: Any) -> None:
    """Write what was measured (dataclasses or tables) as JSON under a key, with the machine that it was measured on."""
    host = {"system": platform.platform(), "processors": os.cpu_count(), "load": os.getloadavg()}
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [asdict(each) if is_dataclass(each) and not isinstance(each, type) else each for each in found]
    path.write_text(json.dumps({**more, "host": host, key: rows}, indent=1), encoding="utf-8")


def show(title: str, figures: list[Figure], path: Path | None) -> int:
    """Print the table, write it as JSON when a path is given; 0 when every target is met, else 1."""
    table = Table(title=title, title_justify="left")
    for column in ("figure", "target", "measured", "met"):
        table.add_column(column, overflow="fold")
    for figure in figures:
        table.add_row(figure.name, figure.target, figure.measured, "yes" if figure.met else "NO")
    console = Console(width=None if os.isatty(1) else 150)
    console.print(table)
    if path is not None:
        write(path, "figures", figures, title=title)
        console.print(str(path))
    return 0 if all(figure.met for figure in figures) else 1
