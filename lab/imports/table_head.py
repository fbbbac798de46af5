"""What stands above the numbers of a text table: headings in one line or several, a line of units, and title lines."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..files.config import ConfigError
from .headings import is_unit, recognised, unit_named
from .map_file import Source
from .series import unique

Line = tuple[int, list[str], str]
"""Number in the file, cells, text."""
MOST_LINES = 4
"""Of headings."""
LABELS = ("id", "type", "parent")
"""Lines of headings, by the word at their begin, that name nothing: Motive writes them."""
MOTIVE = re.compile(r"\W*Format Version\W.*Take Name")
"""Begin of the files that Motive exports."""
ABOUT_UNITS = re.compile(r"unit|einheit|unité|unidad|\bin\b|\[", re.IGNORECASE)
SINGLE = frozenset({"m", "s", "g", "n", "h", "in", "at"})
"""Units that are letters or words: read as units only where `in`, `:`, `=` or a bracket stands before them."""


@dataclass(frozen=True)
class Head:
    """Names of the columns, and what is said of their units."""

    names: list[str]
    stated: frozenset[str] = frozenset()
    """Names that stand in the file."""
    units: Mapping[str, str] = field(default_factory=dict)
    """By column."""
    common_units: Mapping[str, str] = field(default_factory=dict)
    """SI unit -> unit of all such columns."""


def head_of(path: Path, above: Sequence[Line], width: int, source: Source) -> Head:
    """Judge the lines above the data; `source.heading` and `source.units` name lines by number."""
    above = [(line, [re.sub(r"\s+", " ", c).strip().strip('"').strip() for c in cells], text) for line, cells, text in above]
    named = {line: cells for line, cells, _ in above}
    for key, line in (("heading", source.heading), ("units", source.units)):
        if line and line not in named:
            raise ConfigError(f"{path}: source.{key} = {line}: this line holds no words above the numbers; correct the line")
    wide = [one for one in above if sum(map(bool, one[1])) >= max(1, 0.5 * width) and not MOTIVE.match(one[2])]
    labels = {line for line, cells, _ in above if _is_label(cells)}
    units = named[source.units] if source.units else None
    if units is None:
        found = [one for one in wide if one[0] != source.heading and are_units(one[1])]
        others = [one for one in wide if one not in found]
        units = found[-1][1] if found and (others or source.heading) else None
    heads = [one for one in wide if one[1] is not units]
    if source.heading is not None:
        heads = [one for one in above if one[0] == source.heading]
    elif units is not None and heads:  # below a line of units may stand comments
        at = next(line for line, cells, _ in above if cells is units)
        heads = [one for one in heads if one[0] < at] or heads[:1]
    cells = _joined(heads, labels)
    if source.heading is None and not labels:
        heads, cells = _telling(above, units, heads, cells)
    stated = [c for c in cells if c]
    if len(stated) * 2 == width and len(cells[: width // 2]) == len(stated) and width > 3:
        raise ConfigError(
            f"{path}, line {heads[-1][0]}: {len(stated)} headings stand above {width} columns: "
            "commas seem to be both decimal marks and separators; export with semicolons or tabs between columns"
        )
    names = unique(cells, width)
    used = {id(one[1]) for one in heads} | {id(units)}
    by_column = {n: u for n, u in zip(names, units or [], strict=False) if u}
    common: dict[str, str] = {}
    for _, line_cells, text in above:
        if id(line_cells) not in used and ABOUT_UNITS.search(text):
            listed = _listed_units(text, width)
            by_column |= {n: u for n, u in zip(names, listed, strict=False) if n not in by_column}
            if not listed:
                for si, unit in _units_in(text).items():
                    common.setdefault(si, unit)
    return Head(names, frozenset(n for n, c in zip(names, cells, strict=False) if c), by_column, common)


def are_units(cells: Sequence[str]) -> bool:
    """Whether a line is one of units."""
    said = [c for c in cells if c]
    return bool(said) and any(unit_named(c) for c in said) and sum(map(is_unit, said)) > len(said) / 2


def _joined(heads: Sequence[Line], labels: Collection[int]) -> list[str]:
    """One name for each column; where the last line alone does not tell columns apart, with the lines above it."""
    if not heads:
        return []
    names = heads[-1][1]
    said = [n for n in names if n]
    if len(set(said)) == len(said):
        return list(names)
    for k in range(len(heads) - 2, -1, -1):
        cells = heads[k][1]
        if any(line not in labels for line in range(heads[k][0] + 1, heads[k + 1][0])):
            break
        if _is_label(cells):
            continue
        names = [f"{a} {b}".strip() for a, b in zip(_carried(cells), names, strict=False)]
    return [re.sub(r"^(Name|Type) ", "", n) for n in names]


def _telling(
    above: Sequence[Line], units: Sequence[str] | None, heads: list[Line], names: list[str]
) -> tuple[list[Line], list[str]]:
    """The lines, and the names made of them, that say of most columns what they hold: those given, a line alone, or the last ones
    together, of which upper ones may name groups of columns."""
    near = [one for one in above if one[1] is not units and sum(map(bool, one[1])) > 1 and not MOTIVE.match(one[2])][-MOST_LINES:]
    ways = [(heads, names), *(([one], list(one[1])) for one in near)]
    for k in range(len(near) - 1):
        columns = zip(*(_carried(one[1]) for one in near[k:-1]), near[-1][1], strict=False)
        ways.append((near[k:], [" ".join(filter(None, cells)) for cells in columns]))
    return max(ways, key=lambda way: recognised(way[1], units or ()))


def _is_label(cells: Sequence[str]) -> bool:
    """Whether a line above the headings names nothing that tells columns apart."""
    return any(c.casefold() in LABELS for c in cells[:2])


def _carried(cells: Sequence[str]) -> list[str]:
    """A line of headings in which a name stands above the first of its columns only, or above each."""
    out: list[str] = []
    for cell in cells:
        out.append(cell or (out[-1] if out and out[-1] else ""))
    return out


def _listed_units(text: str, width: int) -> list[str]:
    """A unit for each column, as in "units: s, kPa, kPa, mm"; empty where the line does not list as many."""
    rest = re.split(r"[:=]", text, maxsplit=1)[-1]
    for way in (r"[;\t|]", r",", r"[\s,;|]+"):
        parts = [p.strip().strip('"') for p in re.split(way, rest.strip())]
        for cells in (parts, parts[1:]):
            if len(cells) == width and are_units(cells):
                return cells
    return []


def _units_in(text: str) -> dict[str, str]:
    """SI unit -> the one unit of it that a line names."""
    found: dict[str, set[str]] = {}
    for said in re.finditer(r"(?P<before>\bin\s+|[:=(\[,;]\s*|\s|^)(?P<word>[^\s,;:=()\[\]]+)", text):
        unit = unit_named(said["word"])
        if unit is None or (said["word"].casefold() in SINGLE and not re.search(r"in\s|[:=(\[]", said["before"])):
            continue
        found.setdefault(unit[0], set()).add(unit[1])
    return {si: units.pop() for si, units in found.items() if len(units) == 1}
