"""Write robot.yaml: a new file, or a given one with only its changed values replaced.

A given file is edited at the places that its parser reports, not written anew: so comments, layout and numbers as their
author wrote them stay, and the text is read in one dialect of YAML only.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from model.plain_yaml import BadYaml, parse
from model.robot import Robot
from recordings.numbers import NUMBER
from recordings.own_files import replaced

from .config import ConfigError, Loc, Source, check, field_at, unit_of
from .units import KINDS

WRITTEN_DIGITS = 13
"""Significant digits of a number in a unit that is not the SI unit."""


def robot_yaml(robot: Robot, given: str = "") -> str:
    """Return the text of its robot.yaml; it reads back as the same robot.

    `given`: the robot.yaml that it was derived from, whose comments, order and layout are kept. A changed value stands in the
    unit that it had, to `WRITTEN_DIGITS`. What the robot has no more is removed, or commented out where it holds a comment.
    A text that cannot be edited is replaced as a whole."""
    text = given
    try:
        # the last pass finds nothing to change
        for _ in range(3):
            edited = _Edited(text, robot).text
            if edited == text:
                return text
            text = edited
    except (BadYaml, ConfigError, _Anew):
        pass
    return "".join(_entry(key, value) for key, value in _stated(robot.model_dump()).items())


def write_robot(robot: Robot, path: Path, given: str = "") -> Path:
    """Write it, see `robot_yaml`, and return where."""
    replaced(path, robot_yaml(robot, given))
    return path


def in_one_line(value: Any) -> str:
    """Return a value as YAML of one line."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10_000, allow_unicode=True, sort_keys=False)
    return text.strip().removesuffix("...").strip()


def _entry(key: Any, value: Any) -> str:
    """A key and its value, each list and table of plain values on one line."""
    if not isinstance(value, (dict, list)):
        return f"{in_one_line(key)}: {in_one_line(value)}\n"
    text: str = yaml.safe_dump({key: value}, default_flow_style=None, width=10_000, allow_unicode=True, sort_keys=False)
    return text


def _stated(value: Any) -> Any:
    """The same without None and what is empty."""
    if isinstance(value, Mapping):
        found = {key: _stated(inner) for key, inner in value.items()}
        return {key: inner for key, inner in found.items() if inner not in (None, {}, [])}
    return [_stated(inner) for inner in value] if isinstance(value, (list, tuple)) else value


class _Anew(Exception):
    """An entry of a table cannot be edited; it is written anew."""


class _Edit(NamedTuple):
    """A stretch of the text, and what takes its place."""

    start: int
    end: int
    new: str


class _EntryNodes(NamedTuple):
    """An entry of a table in the text: its key as parsed, and both nodes."""

    own: Any
    name: yaml.Node
    value: yaml.Node


WRITTEN = re.compile(NUMBER)
ANCHOR = re.compile(r"(?:[&!]\S*\s+)*")


class _Edited:
    """The text of a robot.yaml, edited to read as `robot`. Raises BadYaml, ConfigError, _Anew."""

    def __init__(self, given: str, robot: Robot) -> None:
        self._given, self._newline = given, "\r\n" if "\r\n" in given else "\n"
        self._data, root = parse(given)
        before = _stated(check(Source("robot.yaml", self._data, {}), Robot).model_dump())
        assert isinstance(root, yaml.MappingNode)  # or the check would have failed
        self._root = root
        self.text = self._with(0, len(given), self._table(root, self._data, before, _stated(robot.model_dump()), ()))

    def _with(self, start: int, end: int, edits: Iterable[_Edit]) -> str:
        """A stretch of the text with its edits."""
        parts = []
        for edit in sorted(edits):
            parts += [self._given[start : edit.start], edit.new]
            start = edit.end
        return "".join([*parts, self._given[start:end]])

    def _value(self, node: yaml.Node, data: Any, before: Any, after: Any, loc: Loc) -> Iterator[_Edit]:
        """Edits of the text that change a value from `before` to `after`. Raises _Anew, on which the entry is written anew."""
        if isinstance(node, yaml.MappingNode) and isinstance(before, dict) and isinstance(after, dict):
            yield from self._table(node, data, before, after, loc)
            return
        if isinstance(node, yaml.SequenceNode) and isinstance(after, list) and len(node.value) == len(after):
            for i, (item, old, new) in enumerate(zip(node.value, before, after, strict=True)):
                if old != new:
                    yield from self._value(item, data[i], old, new, (*loc, i))
            return
        start, end = node.start_mark.index, node.end_mark.index
        raw = self._given[start:end]
        if isinstance(node, yaml.CollectionNode) and (not node.flow_style or "#" in raw):
            raise _Anew  # no text of one line can take the place of several lines or of a comment
        anchor = ANCHOR.match(raw)
        # kept: an anchor or tag before, white space after; nothing at all needs a blank after its colon
        head, tail = anchor[0] if anchor and raw else " ", raw[len(raw.rstrip()) :]
        new = self._written(after, node, loc)
        if isinstance(node, yaml.ScalarNode) and node.style in ("'", '"') and isinstance(after, (int, float)):
            new = f"{node.style}{new}{node.style}"
        yield _Edit(start, end, head + new + tail)

    def _written(self, value: Any, like: yaml.Node | None, loc: Loc) -> str:
        """A value in one line; a number with the unit, and whatever else, that stands behind the number of `like`."""
        text = str(like.value) if isinstance(like, yaml.ScalarNode) else ""
        found = WRITTEN.match(text)
        if found is None or not isinstance(value, (int, float)):
            return in_one_line(value)
        rest = text[found.end() :]
        name = re.split(r"\+-|±", rest)[0].strip()
        field, _ = field_at(loc, self._data, Robot)
        known = KINDS.get((unit_of(field) if field is not None else None) or "", {})
        if name in known:
            return f"{value / known[name]:.{WRITTEN_DIGITS}g}{rest}"
        return in_one_line(value) + ("" if name else rest)

    def _table(
        self, node: yaml.MappingNode, data: Any, before: dict[Any, Any], after: dict[Any, Any], loc: Loc
    ) -> Iterator[_Edit]:
        """Edits that turn a table into another one: of values that differ, and of entries that only one of the two has."""
        by_number = all(isinstance(key, float) for key in (*before, *after))
        entries = {float(raw) if by_number else raw: _EntryNodes(raw, *pair) for raw, pair in zip(data, node.value, strict=True)}
        converted = [key for key, entry in entries.items() if isinstance(before.get(key), str) and data[entry.own] != before[key]]
        if converted and before != after:  # a unit, so that the numbers in the text mean others
            raise _Anew
        removed = [key for key in entries if key in before and key not in after]
        added = {key: value for key, value in after.items() if key not in entries and before.get(key) != value}
        edits: dict[Any, list[_Edit]] = {key: [] for key in entries}
        for key, (raw, _, value) in entries.items():
            if key in after and before.get(key) != after[key]:
                try:
                    edits[key] += self._value(value, data[raw], before.get(key), after[key], (*loc, raw))
                except _Anew:
                    if node.flow_style:
                        raise
                    edits[key] = [self._without(entries[key], _entry(key, after[key]))]
        like = next((entry.value for entry in entries.values() if by_number), None)
        lines = {key: f"{in_one_line(key)}: {self._written(value, like, loc)}" for key, value in added.items()}
        if not node.flow_style:
            edits |= {key: [self._without(entries[key])] for key in removed}
            fresh = {key: f"{lines[key]}\n" if by_number else _entry(key, value) for key, value in added.items()}
            yield from itertools.chain(*edits.values(), self._added(node, entries, fresh))
        elif removed or added:
            start, end = node.start_mark.index, node.end_mark.index
            if "#" in self._given[start:end]:
                raise _Anew
            for key in entries.keys() - removed:
                lines[key] = self._with(entries[key].name.start_mark.index, entries[key].value.end_mark.index, edits[key])
            order = sorted(lines) if by_number else [*(key for key in entries if key in lines), *added]
            yield _Edit(start, end, f"{{{', '.join(lines[key] for key in order)}}}")
        else:
            yield from itertools.chain(*edits.values())

    def _added(self, node: yaml.MappingNode, entries: Mapping[Any, _EntryNodes], fresh: Mapping[Any, str]) -> Iterator[_Edit]:
        """New entries of a block: each before the next larger number, else at the end of the block."""
        if not fresh:
            return
        _, end, indent = self._lines(list(entries.values())[-1])
        if node is self._root:
            end = node.end_mark.index
        insertions: dict[int, str] = {}
        for key in sorted(fresh) if isinstance(next(iter(fresh)), float) else fresh:
            larger = [number for number in entries if isinstance(number, float) and number > key]
            place = self._lines(entries[min(larger)])[0] if larger else end
            insertions[place] = insertions.get(place, "") + self._indented(fresh[key], indent)
        for place, text in insertions.items():
            begun = self._given[place - 1] == "\n"
            yield _Edit(place, place, text if begun else self._newline + text.removesuffix(self._newline))

    def _without(self, entry: _EntryNodes, fresh: str = "") -> _Edit:
        """The lines of an entry replaced by a fresh one; those that hold a comment stay, commented out."""
        start, end, indent = self._lines(entry)
        lines = self._given[start:end]
        kept = re.sub("(?m)^(?=.)", "# ", lines) if "#" in lines else ""
        return _Edit(start, end, self._indented(fresh, indent) + kept)

    def _lines(self, entry: _EntryNodes) -> tuple[int, int, str]:
        """Where the lines of an entry of a block begin and end, and what it is indented by; _Anew where they hold more."""
        start = self._given.rfind("\n", 0, entry.name.start_mark.index) + 1
        indent = self._given[start : entry.name.start_mark.index]
        if indent.strip():
            raise _Anew
        last = entry.value
        while isinstance(last, yaml.CollectionNode) and not last.flow_style:
            last = last.value[-1][1] if isinstance(last, yaml.MappingNode) else last.value[-1]
        end = self._given.find("\n", len(self._given[: last.end_mark.index].rstrip()))
        return start, end + 1 if end >= 0 else len(self._given), indent

    def _indented(self, text: str, indent: str) -> str:
        return re.sub("(?m)^(?=.)", indent, text).replace("\n", self._newline)


def paper_robot() -> Path:
    """The robot.yaml of the paper's robot: examples/paper/robot.yaml, which an installed package holds as a copy."""
    return Path(__file__).with_name("paper_robot.yaml").resolve()
