"""Text tables as programs and spreadsheets of any country write them."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from .map_file import Source
from .series import LARGEST, Array, Series, Texts, unique

SEPARATORS = (",", ";", "\t", "|")
HEAD = 40
"""Lines of a text table by which its form is judged."""
NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?|[-+]?nan|[-+]?inf", re.IGNORECASE)


def read_text(path: Path, source: Source) -> Series:
    """The columns of a text table; separator, decimal mark and line of the headings are seen unless `source` says them."""
    data = read_bounded(path, LARGEST, ConfigError)
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if "\0" in text:
        raise ConfigError(f"{path}: is not a text table")
    head = [line for line in text.splitlines()[:HEAD] if line.strip()]
    if not head:
        raise ConfigError(f"{path}: is empty")
    separator = source.separator or _separator(path, head)
    comma = (source.decimal or _decimal(head, separator)) == ","
    try:
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True))
    except csv.Error as e:
        raise ConfigError(f"{path}: is not a text table ({e})") from e
    at = _heading(lines) if source.heading is None else source.heading
    body = [line for line in lines[at:] if any(c.strip() for c in line)]
    if not body:
        raise ConfigError(f"{path}: has no rows below line {at}")
    width = max(map(len, body))
    names = unique([c.strip() for c in lines[at - 1]] if at else [], width)
    cells = [[c.strip() for c in line] + [""] * (width - len(line)) for line in body]
    numbers: dict[str, Array] = {}
    words: dict[str, Texts] = {}
    for name, column in zip(names, zip(*cells, strict=True), strict=True):
        there = [c for c in column if c]
        if there and all(NUMBER.fullmatch(c) for c in there):
            numbers[name] = np.array([float(c.replace(",", ".") if comma else c) if c else np.nan for c in column])
        elif there:
            words[name] = np.array(column)
    if not numbers:
        raise ConfigError(f"{path}: no column holds numbers; is {separator!r} its separator (source.separator)?")
    mark = {"\t": "tabs", " ": "spaces"}.get(separator, repr(separator))
    return Series(
        path, numbers, words, f"columns separated by {mark}, numbers with a decimal {'comma' if comma else 'point'}"
    )


def _separator(path: Path, head: list[str]) -> str:
    """What splits the lines into the same number of cells, most of them."""
    usual = "\t" if path.suffix.lower() == ".tsv" else ","
    counts = {s: [line.count(s) for line in head[-20:]] for s in SEPARATORS}
    even = {s: min(c) for s, c in counts.items() if c and min(c) > 0 and min(c) == max(c)}
    if not even:
        return (
            " " if all(len(line.split()) > 1 for line in head[-20:]) and not any(map(max, counts.values())) else usual
        )
    # a decimal comma is as even as a separator: whatever else is even goes before
    others = [s for s in even if s != ","]
    return max(others, key=lambda s: even[s]) if others else ","


def _decimal(head: list[str], separator: str) -> str:
    if separator == ",":
        return "."
    cells = [c.strip(' "') for line in head for c in line.split(separator)]
    commas = sum(bool(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", c)) for c in cells)
    points = sum(bool(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", c)) for c in cells)
    return "," if commas > points else "."


def _heading(lines: list[list[str]]) -> int:
    """The line of the headings, from 1: the last one before the numbers; 0 when the file begins with numbers."""
    for i, line in enumerate(lines[:HEAD]):
        cells = [c.strip() for c in line if c.strip()]
        if cells and sum(bool(NUMBER.fullmatch(c)) for c in cells) > len(cells) / 2:
            before = [k for k in range(i) if any(c.strip() for c in lines[k])]
            return before[-1] + 1 if before else 0
    return 1
