"""YAML as a person writes it: tables, lists, numbers, texts, true, false and null. Everything else is an error with its line.
A file's fields are checked by a model of pydantic: each that is wrong gets a line with place, value, unit and limit.

YAML can say much more (dates, sets, references, numbers of any size, tables as deep as memory). None of it has a
meaning in the files of this project, and each is a way to make a program stumble or a small file large.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Discriminator, ValidationError

from model.errors import ModelError

M = TypeVar("M", bound=BaseModel)


class FileTable(BaseModel):
    """A table of a file: no unknown keys, no NaN, unchangeable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Nested = Mapping[str, type[BaseModel]]
"""Key -> the model of the table that it holds."""

MOST_CHARACTERS = 500_000
"""Of a file that a person writes; the longest of this project has 5000."""
MOST_PROBLEMS = 50
"""Of a file that are spelled out."""
DEEPEST = 20
"""Tables and lists within each other; the files of this project have five."""
MOST_VALUES = 10_000
"""Keys and values of a file."""
FORM = Discriminator(
    lambda value: "list" if isinstance(value, (list, tuple)) else "table" if isinstance(value, (dict, FileTable)) else "number"
)
"""Tells the forms apart that the value of one field may have."""
TAGS = ("number", "table", "list", "[key]")
"""Parts of an error's place that are no keys of a file: forms of a value, and that a key is wrong."""
LONGEST_NUMBER = 40
"""Characters of a number."""
LARGEST_INTEGER = 2**53
"""Beyond it not every whole number is a float."""

_PLAIN = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str")}
_UNSAYABLE = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
"""Characters that no name, path or unit holds: control characters and halves of a character."""
_UNUSUAL = re.compile(r"[-+]?(?:0[0-9]+$|0[xb]|.*[_:])")
"""Numbers that YAML takes for octal (010), sexagesimal (1:30), other bases (0x10) or grouped (1_000) ones."""


class BadYaml(ValueError):
    """A text that is not plain YAML. `line` counts from 1; None where no line is to blame."""

    def __init__(self, why: str, line: int | None = None) -> None:
        super().__init__(why if line is None else f"line {line}: {why}")
        self.why, self.line = why, line


class _Loader(yaml.SafeLoader):
    """Builds plain values only."""

    yaml_implicit_resolvers: dict[str, Any] = {
        first: [(tag, pattern) for tag, pattern in found if tag in _PLAIN]
        for first, found in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        self._depth = self._values = 0
        super().__init__(text)

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """A node and all in it; raises `BadYaml` for an alias or tag, and beyond the limits of size and depth."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise BadYaml(f"uses the YAML alias *{str(event.anchor)[:40]}; write the values out", line)
        tag = getattr(event, "tag", None)
        if tag is not None and tag != "!":
            raise BadYaml(f"uses the YAML tag {str(tag)[:40]!r}; write the plain value", line)
        self._values += 1
        if self._values > MOST_VALUES:
            raise BadYaml(f"has more than {MOST_VALUES} keys and values", line)
        self._depth += 1
        if self._depth > DEEPEST:
            raise BadYaml(f"has more than {DEEPEST} levels of nested tables and lists", line)
        node: yaml.Node | None = super().compose_node(parent, index)  # type: ignore[no-untyped-call]
        self._depth -= 1
        return node


def parse(text: str) -> tuple[object, yaml.Node | None]:
    """The values of a text, and its nodes (they know their lines); raises `BadYaml`, and nothing else."""
    if len(text) > MOST_CHARACTERS:
        raise BadYaml(f"has {len(text)} characters, more than the limit of {MOST_CHARACTERS}")
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        return (None if node is None else _value(loader, node)), node
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        why = getattr(error, "problem", None) or str(error).partition("\n")[0]
        raise BadYaml(f"is not valid YAML: {why}; quote text with [ ] {{ }} , : or #", mark and mark.line + 1) from error


def loaded(path: Path, name: str, start: str, make: Callable[[Mapping[str, Any]], M], refused: type[ModelError]) -> M:
    """What is made of the fields of a file, called `name`, that begins with the fields `start`; raises `refused`, as `make` does,
    with the path in its message."""
    if Path(path).exists() and not Path(path).is_file():
        raise refused(f"{path}: is not a file: give the path of {name}")
    try:
        with open(path, encoding="utf-8") as file:
            data, _ = parse(file.read(MOST_CHARACTERS + 1))
    except OSError as error:
        raise refused(f"{path}: cannot be read ({error.strerror}): check the path") from error
    except UnicodeDecodeError as error:
        raise refused(f"{path}: is not a text file: check that this is the right file") from error
    except BadYaml as error:
        raise refused(f"{path}: {error}") from error
    if not isinstance(data, dict):
        raise refused(f"{path}: holds no table of fields: start with {start}")
    try:
        return make(data)
    except refused as error:
        raise refused(f"{path}:\n{error}") from error


def checked(model: type[M], data: Mapping[str, Any], nested: Nested, refused: type[ModelError]) -> M:
    """A model of these fields; raises `refused` naming every field that is wrong."""
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        raise refused("\n".join(_complaint(e, model, nested) for e in error.errors()[:MOST_PROBLEMS])) from error


def _complaint(error: Any, model: type[BaseModel], nested: Nested) -> str:
    """Place, value, unit and limit of one error of validation."""
    place = ".".join(str(part) for part in error["loc"] if part not in TAGS) or model.__name__.lower()
    message = str(error["msg"]).removeprefix("Value error, ")
    if error["type"] in ("missing", "value_error"):
        return f"{place}: {message}"
    unit = unit_at(error["loc"], model, nested)
    return f"{place} = {repr(error['input'])[:60]}{' ' + unit if unit else ''}: {message}"


def unit_at(loc: Sequence[int | str], owner: type[BaseModel], nested: Nested) -> str:
    """The unit of the field at a place of a validation error (keys and indices from the model down); empty for none."""
    if "[key]" in loc:
        return "m"
    unit = ""
    for part in loc:
        if not isinstance(part, str):
            continue
        info = owner.model_fields.get(part)
        extra = info.json_schema_extra if info is not None else None
        if isinstance(extra, dict):
            unit = str(extra.get("unit", ""))
        owner = nested.get(part, owner)
    return "" if unit == "1" else unit


def _value(loader: _Loader, node: yaml.Node) -> object:
    """The plain value of a node; a list or table with all that it holds."""
    if isinstance(node, yaml.SequenceNode):
        return [_value(loader, item) for item in node.value]
    if isinstance(node, yaml.MappingNode):
        table: dict[object, object] = {}
        for key_node, value_node in node.value:
            # as keys, `on`, `no` and the like are names
            name = key_node.tag.endswith((":bool", ":null")) and key_node.value
            key = name or _value(loader, key_node)
            if not isinstance(key, Hashable):
                raise BadYaml("a table or list cannot be a key", _line(key_node))
            if key in table:
                raise BadYaml(f"the key {str(key)[:40]!r} appears twice in one table", _line(key_node))
            table[key] = _value(loader, value_node)
        return table
    return _scalar(loader, yaml.ScalarNode(node.tag, node.value, node.start_mark))


def _scalar(loader: _Loader, node: yaml.ScalarNode) -> object:
    """The text, number, true, false or None of a node."""
    text = node.value
    kind = node.tag.rpartition(":")[2]
    if kind == "str":
        if forbidden := _UNSAYABLE.search(text):
            raise BadYaml(f"a text contains the character {forbidden[0]!r}, which is not allowed", _line(node))
        return text
    if kind == "null":
        return None
    if kind == "bool":
        return loader.construct_yaml_bool(node)  # type: ignore[no-untyped-call]
    try:
        if len(text) > LONGEST_NUMBER:
            raise ValueError("too long")
        make = loader.construct_yaml_int if kind == "int" else loader.construct_yaml_float
        if _UNUSUAL.match(text):
            raise ValueError("unusual")
        number = make(node)  # type: ignore[no-untyped-call]
    except (ValueError, IndexError, OverflowError) as error:
        why = f"{text[:LONGEST_NUMBER]!r} is not a usable number; write a plain one, or a text in quotation marks"
        raise BadYaml(why, _line(node)) from error
    if isinstance(number, int) and abs(number) > LARGEST_INTEGER:
        raise BadYaml(f"{text[:LONGEST_NUMBER]} exceeds {LARGEST_INTEGER}; write a float", _line(node))
    if isinstance(number, float) and math.isinf(number) and "inf" not in text.lower():
        raise BadYaml(f"{text[:LONGEST_NUMBER]} is too large for a number", _line(node))
    return number


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1
