"""Read files that people write: YAML in, validated frozen objects out, or one message with every problem.

A file is described by a pydantic model with `extra="forbid"`; a field's unit stands in `json_schema_extra={"unit": ...}`.
Each problem names the file and line, the key, the value with its unit, the limit, and what to write instead.
"""

from __future__ import annotations

import operator
import sys
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from model.errors import alike, nearest, unit_text
from model.plain_yaml import MOST_CHARACTERS, MOST_PROBLEMS, BadYaml, parse
from recordings.bounded import read_bounded
from recordings.numbers import number

from .units import UnitError, meant, sized, to_si, written

M = TypeVar("M", bound=BaseModel)
Loc = tuple[str | int, ...]
Lines = Mapping[Loc, int]
Units = tuple[tuple[str, Mapping[str, float]], ...]
"""SI units, each with the units of its kind and their size."""
SMALLEST = sys.float_info.min
"""Magnitude of a number other than zero: smaller ones lose their digits, and dividing by them overflows."""
LIMITS = {"gt": operator.gt, "ge": operator.ge, "lt": operator.lt, "le": operator.le}


class ConfigError(Exception):
    """A file or an argument that cannot be used; its text lists every problem. Exit code 2."""

    def __init__(self, *problems: str, placed: bool = False) -> None:
        super().__init__("\n".join(problems))
        # placed: each problem begins with its place in the file that was checked
        self.problems, self.placed = problems, placed


def in_si(place: str, text: str, unit: str, units: Mapping[str, float] | None = None) -> float:
    """A quantity in the SI unit, see `to_si`; raises ConfigError, headed by its place."""
    try:
        return to_si(text, unit, units)
    except UnitError as e:
        raise ConfigError(f"{place}: {e}") from e


def demand_writable(*paths: Path | None) -> None:
    """Report a missing folder before the work, not after it. Raises ConfigError. None: no file wanted."""
    for path in paths:
        if path is not None and (path.is_dir() or not path.parent.is_dir()):
            raise ConfigError(f"{path}: cannot be written; give a file name in an existing folder")


@dataclass(frozen=True)
class Source:
    """A parsed file: its values, and the line on which each key stands."""

    name: str
    data: object
    lines: Lines
    text: bytes = b""
    units: Units = ()
    """Of its quantities, in place of those of `KINDS`."""

    @property
    def table(self) -> dict[str, Any]:
        """Its keys and values; none where it holds something else, which `check` refuses."""
        return self.data if isinstance(self.data, dict) else {}

    def at(self, loc: Loc) -> str:
        """`file:line` of the key nearest to loc."""
        while loc and loc not in self.lines:
            loc = loc[:-1]
        return f"{self.name}:{self.lines[loc]}" if loc in self.lines else self.name


def read_yaml(path: Path) -> Source:
    """Parse one YAML file (plain values only, see `model.plain_yaml`); raises ConfigError."""
    try:
        text = read_bounded(path, 4 * MOST_CHARACTERS, ConfigError).decode("utf-8")
    except UnicodeDecodeError as e:
        raise ConfigError(f"{path}: is not a text file; a YAML file is needed here") from e
    return parse_yaml(text, str(path))


def parse_yaml(text: str, name: str) -> Source:
    """Parse YAML text; `name` stands for it in messages."""
    try:
        data, node = parse(text)
    except BadYaml as e:
        raise ConfigError(f"{name}{'' if e.line is None else f':{e.line}'}: {e.why}") from e
    lines: dict[Loc, int] = {}
    if node is not None:
        _collect_lines(node, (), lines)
    return Source(name, data, lines, text.encode())


def load(path: Path, model: type[M]) -> M:
    """Read `path` as `model`; raises ConfigError with all problems of the file."""
    return check(read_yaml(path), model)


def check(source: Source, model: type[M]) -> M:
    """Turn parsed values into `model`; raises ConfigError with all problems."""
    if not isinstance(source.data, dict):
        raise ConfigError(f"{source.name}: contains {_short(source.data)}, not a table of keys and values")
    problems: dict[Loc, str | ErrorDetails] = {}
    data = _convert_model(source.data, model, (), problems, source.units)
    try:
        result = model.model_validate(data)
    except ValidationError as e:
        for error in e.errors(include_url=False):
            problems.setdefault(_own_loc(error["loc"], data), error)
    else:
        if not problems:
            return result
    order = sorted(problems, key=lambda loc: (source.lines.get(loc, 10**9), str(loc)))
    said = {loc: p if isinstance(p := problems[loc], str) else _describe(p, loc, data, model) for loc in order[:MOST_PROBLEMS]}
    texts = [f"{source.at(loc)}: {text}" for loc, text in said.items()]
    if len(order) > len(texts):
        texts.append(f"{source.name}: and {len(order) - len(texts)} more problems")
    raise ConfigError(*texts, placed=True)


# ------------------------------------------------------------------ where a key stands
def _collect_lines(node: yaml.Node, loc: Loc, lines: dict[Loc, int]) -> None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            here = (*loc, key.value)
            lines[here] = key.start_mark.line + 1
            _collect_lines(value, here, lines)
    elif isinstance(node, yaml.SequenceNode):
        for i, value in enumerate(node.value):
            lines[(*loc, i)] = value.start_mark.line + 1
            _collect_lines(value, (*loc, i), lines)


# ------------------------------------------------------------------ "250 kPa" -> 250000.0
def unit_of(field: FieldInfo) -> str | None:
    """Return the unit that a field states; None where it states none."""
    extra = field.json_schema_extra
    return str(extra["unit"]) if isinstance(extra, dict) and "unit" in extra else None


def _models(annotation: object, value: object) -> type[BaseModel] | None:
    """The model that `value` is meant to be, through unions told apart by a key that can have one value only (`driver`)."""
    if get_origin(annotation) is dict:
        return None
    options = [a for a in _leaves(annotation) if isinstance(a, type) and issubclass(a, BaseModel)]
    if len(options) > 1 and isinstance(value, dict):
        for option in options:
            for key, field in option.model_fields.items():
                if get_origin(field.annotation) is Literal and get_args(field.annotation) == (value.get(key),):
                    return option
    return options[0] if len(options) == 1 else None


def _inner(field: FieldInfo) -> FieldInfo:
    """Of a table whose keys are names that a person gives: the field that each of its values is; else the field itself."""
    tables = [a for a in _leaves(field.annotation) if isinstance(a, type) and issubclass(a, BaseModel)]
    if get_origin(field.annotation) is not dict or not tables:
        return field
    return FieldInfo.from_annotation(get_args(field.annotation)[1])


def _leaves(annotation: object) -> list[object]:
    if get_origin(annotation) in (Union, types.UnionType, Annotated, list, tuple, dict):
        return [leaf for a in get_args(annotation) for leaf in _leaves(a)]
    return [annotation]


def _convert_model(
    raw: dict[Any, Any], model: type[BaseModel], loc: Loc, problems: dict[Loc, Any], units: Units
) -> dict[Any, Any]:
    """The table `raw` with its values in SI (see `_convert`), and deviations behind +- moved to its table `uncertainty`."""
    out = dict(raw)
    deviations: dict[str, float | None] = {}
    for key, field in model.model_fields.items():
        if key not in raw:
            continue
        value, sign, spread = raw[key], "", ""
        if isinstance(value, str) and _uncertain(field):
            value, sign, spread = map(str.strip, value.replace("±", "+-").partition("+-"))
        elif isinstance(value, str) and unit_of(field) and ("+-" in value or "±" in value):
            may = ", ".join(name for name, other in model.model_fields.items() if _uncertain(other)) or "no key of this table"
            problems[(*loc, key)] = f"{_dotted((*loc, key))}: {value!r}: +- may follow {may}; for others see `uncertainty`"
            value = value.replace("±", "+-").partition("+-")[0].strip()
        if sign:
            deviations[_uncertain(field)] = _spread(value, spread, field, (*loc, key), problems)
        out[key] = _convert(value, field, (*loc, key), problems, units)
        if isinstance(value, dict) and "uncertainty" not in value:  # a part's deviations stand in the whole's table
            deviations |= out[key].pop("uncertainty", {})
    if deviations and isinstance(out.get("uncertainty", {}), dict):
        out["uncertainty"] = deviations | out.get("uncertainty", {})
    return out


def _uncertain(field: FieldInfo) -> str:
    """The entry of the table `uncertainty` in which a field's standard deviation stands; empty where there is none."""
    extra = field.json_schema_extra
    return str(extra.get("uncertainty", "")) if isinstance(extra, dict) else ""


def _spread(value: str, beside: str, field: FieldInfo, loc: Loc, problems: dict[Loc, Any]) -> float | None:
    """The deviation after +- in "505 kPa +- 30 %" or "40 cm +- 1 mm": a share or a difference, as the table has it."""
    from model.robot import Uncertainty  # with NumPy, which the guard does without

    share = unit_of(Uncertainty.model_fields[_uncertain(field)]) == "1"
    try:
        whole = to_si(value, unit_of(field) or "1")
        if beside.endswith("%"):
            return to_si(beside, "1") * (1.0 if share else whole)
        return to_si(beside, unit_of(field) or "1") / (whole if share else 1.0)
    except (UnitError, ZeroDivisionError) as e:
        problems[loc] = f"{_dotted(loc)}: {e}; write for example '505 kPa +- 30 %'"
        return None


def _convert(value: Any, field: FieldInfo, loc: Loc, problems: dict[Loc, Any], units: Units) -> Any:
    """A value, or those of its list or table, with texts such as "250 kPa" in the field's unit; else a problem is added."""
    unit = unit_of(field)
    if isinstance(value, dict):
        inner = _models(field.annotation, value)
        if inner is not None:
            return _convert_model(value, inner, loc, problems, units)
        if isinstance(field.json_schema_extra, dict) and "key_unit" in field.json_schema_extra:  # keys are numbers
            for key in (k for k in value if isinstance(k, str)):
                try:
                    number(key)
                except ValueError as e:
                    problems[(*loc, key)] = f"{_dotted(loc)}: {e}"
        return {k: _convert(v, _inner(field), (*loc, k), problems, units) for k, v in value.items()}
    if isinstance(value, list):
        return [_convert(v, field, (*loc, i), problems, units) for i, v in enumerate(value)]
    kinds = [a for a in _leaves(field.annotation) if (isinstance(a, type) and a is not type(None)) or get_origin(a)]
    # numbers or lists of them, and else tables alone
    numeric = any(k in (int, float) for k in kinds) and all(k in (int, float) or _models(k, None) for k in kinds)
    if isinstance(value, str) and (numeric or unit is not None):
        try:
            value = to_si(value, unit or "", dict(units).get(unit or ""))  # YAML takes 1e3 for a text
        except UnitError as e:
            problems[loc] = f"{_dotted(loc)}: {e}" if unit is not None else f"{_dotted(loc)} = {_short(value)}: must be a number"
    if isinstance(value, bool) and numeric:
        problems[loc] = f"{_dotted(loc)} = {str(value).lower()}: must be a number{f' in {unit}' if unit else ''}"
    elif isinstance(value, float) and 0 < abs(value) < SMALLEST:
        problems[loc] = f"{_dotted(loc)} = {f'{_short(value)} {unit or str()}'.strip()}: must be 0, or at least {SMALLEST:.1e}"
    return value


# ------------------------------------------------------------------ 250000.0 -> "250 kPa"
def in_units(table: Mapping[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """The values of a file with units behind its numbers, where the model states one; `check` reads the same values."""
    fields = model.model_fields
    return {key: _in_unit(value, fields[key]) if key in fields else value for key, value in table.items()}


def _in_unit(value: Any, field: FieldInfo) -> Any:
    if isinstance(value, Mapping):
        inner = _models(field.annotation, value)
        return {k: _in_unit(v, _inner(field)) for k, v in value.items()} if inner is None else in_units(value, inner)
    several = isinstance(value, (list, tuple))
    items = list(value) if several else [value]
    unit = unit_text(unit_of(field) or "").strip()
    if unit and all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items):
        items = list(written(items, unit))
    elif several:
        items = [_in_unit(item, field) for item in items]
    return items if several else items[0]


# ------------------------------------------------------------------ one problem, one sentence
def _own_loc(loc: Loc, data: object) -> Loc:
    """Drop what pydantic adds to a location for unions (tags, type names): keep the steps that lead through the data."""
    own: list[str | int] = []
    for left, step in zip(range(len(loc) - 1, -1, -1), loc, strict=True):
        if _holds(data, step) or (isinstance(data, dict) and not left):
            data = _inside(data, step)
            own.append(step)
    return tuple(own)


def _holds(data: object, step: str | int) -> bool:
    if isinstance(data, list):
        return isinstance(step, int) and step < len(data)
    return isinstance(data, dict) and step in data


def _inside(data: Any, step: str | int) -> object:
    """The value at a step; None if there is no such step."""
    return data[step] if _holds(data, step) else None


def _describe(error: ErrorDetails, loc: Loc, data: object, model: type[BaseModel]) -> str:
    """An error of pydantic as one sentence: key, value with unit, limit, and what to write instead."""
    kind, context = error["type"], error.get("ctx", {})
    key = _dotted(loc)
    field, siblings = field_at(loc, data, model)
    unit = (unit_of(field) or "") if field is not None else ""
    number = f"{_short(error['input'])} {unit}".strip()
    if kind == "extra_forbidden":
        return f"{key}: unknown key; " + nearest(str(loc[-1]), siblings, "known keys: " + ", ".join(siblings))
    if kind == "missing":
        extra = field.json_schema_extra if field is not None else None
        hint = f"; {extra['write']}" if isinstance(extra, dict) and "write" in extra else ""
        return f"{key}: is missing{'; give a number' if unit == '1' else f'; give it in {unit}' if unit else ''}{hint}"
    limits = {"greater_than": ("gt", "above"), "greater_than_equal": ("ge", "at least"),
              "less_than": ("lt", "below"), "less_than_equal": ("le", "at most")}  # fmt: skip
    if kind in limits:
        name, word = limits[kind]
        value, in_other_units = float(error["input"]), meant(float(error["input"]), unit, lambda v: _within(field, v))
        hint = f"; did you mean {' or '.join(in_other_units)}?" if in_other_units else ""
        return f"{key} = {sized(value, unit)}: must be {word} {sized(context[name], unit)}{hint}"
    if kind in ("union_tag_invalid", "literal_error"):
        allowed = str(context.get("expected_tags") or context.get("expected", ""))
        tag = context.get("tag", error["input"])
        near = alike(str(tag), [a.strip(" '") for a in allowed.replace(" or ", ",").split(",")])
        return f"{key} = {_short(tag)}: must be one of {allowed}" + (f"; did you mean {near}?" if near else "")
    if kind == "union_tag_not_found":
        return f"{key}: needs a key {context.get('discriminator', '')} that says which kind it is"
    if kind in ("float_parsing", "float_type", "int_parsing", "int_type"):
        return f"{key} = {_short(error['input'])}: must be a number{f' in {unit}' if unit else ''}"
    if kind == "finite_number":
        return f"{key} = {number}: must be a finite number"
    if kind == "too_long":
        return f"{key}: has {context['actual_length']} entries, must have at most {context['max_length']}"
    message = error["msg"].removeprefix("Value error, ")
    if key and not isinstance(error["input"], dict):
        return f"{key} = {number}: {message}"
    return f"{key}: {message}" if key else message


def _within(field: FieldInfo | None, value: float) -> bool:
    """Whether a number keeps the limits of a field, or of the items of its list."""
    if field is None:
        return False
    inner = [leaf for leaf in _leaves(field.annotation) if isinstance(leaf, FieldInfo)]
    told = [(name, getattr(one, name, None)) for of in (field, *inner) for one in of.metadata for name in LIMITS]
    return all(LIMITS[name](value, limit) for name, limit in told if limit is not None)


def field_at(loc: Loc, data: object, model: type[BaseModel]) -> tuple[FieldInfo | None, list[str]]:
    """The field at a location in the data of a model (None where it has none), and the keys that its table may have."""
    current: type[BaseModel] | None = model
    field: FieldInfo | None = None
    siblings = list(model.model_fields)
    for step in loc:
        if current is not None and isinstance(step, str):
            siblings = list(current.model_fields)
            field = current.model_fields.get(step)
            current = None
        data = _inside(data, step)
        if field is not None and isinstance(data, dict):
            if current is None and step not in siblings and get_origin(field.annotation) is dict:
                field = _inner(field)
            current = _models(field.annotation, data)
    return field, siblings


def _dotted(loc: Loc) -> str:
    text = ""
    for step in loc:
        text += f"[{step}]" if isinstance(step, int) else (f".{step}" if text else str(step))
    return text


def _short(value: object) -> str:
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
