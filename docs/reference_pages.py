"""The reference pages and the glossary, made from the code: command, files, protocols, effects, instruments, streams, Python."""

from __future__ import annotations

import argparse
import ast
import inspect
import os
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

from pydantic import BaseModel

import lab
from drivers import interfaces
from drivers.registry import ROLES
from drivers.retries import Retries
from drivers.serial_line import SerialLine
from lab.cli import parser
from lab.files.all_drivers import drivers
from lab.files.all_protocols import found_protocols
from lab.files.campaign_file import CampaignFile
from lab.files.rig_file import RigFile
from lab.imports.map_file import Map
from lab.pages.glossary import TERMS
from model.effects import CATALOGUE
from model.effects.history import History
from model.effects.quantities import Quantities
from model.effects.readings import Readings
from model.effects.spec import STAGES, Parameter
from model.robot import Robot
from protocols import actions, suspension, visits
from protocols.bench import Bench, Setup
from protocols.experiment import Ask, Plan, Reading, Step, Trials
from protocols.parameters import Jam, Settle, SpineMotion
from protocols.visits import Sweep, Visit, Walk
from recordings import trials
from recordings.messages import STREAMS
from recordings.states.rules import Crossing, Settled, Window
from sim_fakes.pty_fake import PtyFake

OFFERS: Mapping[str, type] = {
    "arm": interfaces.ArmDriver,
    "force": interfaces.ForceSensor,
    "pressure": interfaces.PressureRegulators,
    "spine": interfaces.LengthUnit,
    "valve": interfaces.JammingValve,
    "gauge": interfaces.VacuumGauge,
    "mocap": interfaces.MotionCapture,
    "sensor": interfaces.Stream,
}
"""What a driver of each role is."""
MADE = "This page is made from the code."


def write_all(folder: Path) -> None:
    """Write every page into `folder`."""
    os.environ["COLUMNS"] = "100"  # the width of argparse's lines, wherever this is run
    pages = {
        "command": command(),
        "rig": rig_file(),
        "robot": robot_file(),
        "map": map_file(),
        "campaign": campaign_file(),
        "trials": trials_file(),
        "protocols": protocol_files(),
        "instruments": instruments(),
        "protocol-calls": protocol_calls(),
        "effects": effects(),
        "quantities": quantities(),
        "streams": streams(),
        "python": python(),
    }
    pages["../glossary"] = glossary()
    folder.mkdir(parents=True, exist_ok=True)
    for name, lines in pages.items():
        text = "\n".join(lines) + "\n"
        page = folder / f"{name}.md"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def glossary() -> Iterator[str]:
    """Terms of the reports, as their pages explain them."""
    yield "# Glossary"
    yield "The terms that the code, the command line and the reports use. Units are in brackets; symbols are those of"
    yield "[the rod model](explanations/model.md)."
    yield from _table(("term", "meaning"), ((term.heading, _cell(term.meaning)) for term in TERMS))
    yield MADE


def command() -> Iterator[str]:
    """Every verb with its arguments, from the parser itself."""
    yield from (
        "# The command",
        "",
        MADE,
        "",
        "Exit code 0: done; 1: failed; 2: wrong usage or configuration; 3: done, but data was lost.",
    )
    for name, verb in _verbs(parser()):
        yield from (
            "",
            f"## lab {name}",
            "",
            f"{_sentence((verb.description or '').replace('%%', '%'))}",
            "",
            "```text",
        )
        yield from (textwrap.dedent(verb.format_usage()).removeprefix("usage: ").rstrip(), "```")
        rows = [
            (_code(", ".join(a.option_strings) or a.metavar or a.dest), _cell(a.help or ""))
            for a in verb._actions  # noqa: SLF001 - argparse has no other list of them
            if not isinstance(a, (argparse._HelpAction, argparse._SubParsersAction))  # noqa: SLF001
        ]
        yield from _table(("argument", "meaning"), rows)


def _verbs(top: argparse.ArgumentParser, before: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in top._actions:  # noqa: SLF001
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for name, verb in action.choices.items():
                yield before + name, verb
                yield from _verbs(verb, f"{before}{name} ")


def rig_file() -> Iterator[str]:
    """Every table of rig.yaml but those of the instruments."""
    yield from ("# rig.yaml", "", MADE, "The tables of `instruments` are on [a page of their own](instruments.md).")
    yield from ("A number may carry its unit: `250 kPa`. For an editor: `lab schema rig`.", "")
    yield from _tables(RigFile, "", leave_out=("instruments",))


def robot_file() -> Iterator[str]:
    """Every table of robot.yaml."""
    yield from (
        "# robot.yaml",
        "",
        MADE,
        "A number may carry its unit: `40 cm`. For an editor: `lab schema robot`.",
        "",
    )
    yield from _tables(Robot, "")


def map_file() -> Iterator[str]:
    """Every table of map.yaml."""
    yield from ("# map.yaml", "", MADE, "What it is for: [data from elsewhere](../howto/other-data.md).")
    yield from ("A number may carry its unit: `1 kPa`. For an editor: `lab schema map`.", "")
    yield from _tables(Map, "")


def campaign_file() -> Iterator[str]:
    """Every table of campaign.yaml."""
    yield from ("# campaign.yaml", "", MADE, "What it is for: [run a campaign](../howto/campaign.md).")
    yield from ("A number may carry its unit: `1 h`. For an editor: `lab schema campaign`.", "")
    yield from _tables(CampaignFile, "")


def trials_file() -> Iterator[str]:
    """The columns of trials.csv, as their module describes them."""
    yield from ("# trials.csv", "", MADE, "")
    yield from _prose(trials)
    yield from ("| column | unit | meaning |", "|---|---|---|")
    for pattern, unit, meaning in trials.COLUMNS:
        if meaning:
            names = ", ".join(f"`{name}`" for name in pattern.replace("[0-9]+", "1").split("|"))
            yield f"| {names} | {unit} | {meaning} |"


def protocol_files() -> Iterator[str]:
    """The parameters of each protocol."""
    yield from ("# Protocols", "", MADE, "These are the keys of a protocol file, and of `--set`.", "")
    for name, found in found_protocols().usable.items():
        yield from (
            f"## {name}",
            "",
            *_prose(inspect.getmodule(found.parameters)),
            f"Needs: {', '.join(found.needs)}.",
            "",
        )
        yield from _tables(found.parameters, "", level=3)


def protocol_calls() -> Iterator[str]:
    """What a protocol of one's own calls."""
    yield from (
        "# Calls of a protocol",
        "",
        MADE,
        "How they fit together: [a protocol of your own](../howto/protocol.md).",
    )
    yield from ("All values are in SI units, times are rig time in s.", "")
    for kind in (
        Visit,
        Sweep,
        Walk,
        Trials,
        Bench,
        Setup,
        Plan,
        Step,
        Ask,
        Reading,
        Settled,
        Window,
        Crossing,
        Settle,
        Jam,
        SpineMotion,
    ):
        yield from _class(kind, kind.__name__)
    for module in (visits, actions, suspension):
        yield from (f"## {module.__name__}", "", *_prose(module))
        rows = [
            (_code(f"{name}{_signature(f)}"), _cell(inspect.getdoc(f) or ""))
            for name, f in vars(module).items()
            if inspect.isfunction(f) and f.__module__ == module.__name__ and not name.startswith("_")
        ]
        yield from _table(("call", "does"), rows)


def quantities() -> Iterator[str]:
    """What laws of effects may change, with shapes."""
    yield from ("# Quantities that effects change", "", MADE)
    yield from ("How a law is written: [an effect of your own](../howto/effect.md).", "")
    yield from (
        "v: variants, n: states, either may be 1. An array of chambers has one axis more, so that a law writes",
        "",
    )
    yield from ("```python", 'q.pressure = q.pressure * (1 - v["share"][..., None])', "```", "")
    for kind, part in ((Quantities, "before"), (History, "path"), (Readings, "after")):
        yield from _class(kind, f"{kind.__name__}: `{part}`")


def _class(kind: type, title: str, made: bool = False) -> Iterator[str]:
    """Fields and methods of a class, with their notes; `made`: how it is made, too."""
    yield from (f"## {title}", "", *_prose(kind))
    notes = _notes(kind)
    fields = inspect.get_annotations(kind)
    rows = [(_code(name), _cell(notes.get(name, ""))) for name in fields if not name.startswith("_")]
    methods = [
        (name, f)
        for name, f in vars(kind).items()
        if inspect.isfunction(f) and (not name.startswith("_") or (made and name == "__init__")) and name not in fields
    ]
    calls = {name: kind.__name__ if name == "__init__" else name for name, _ in methods}
    rows += [(_code(f"{calls[name]}{_signature(f)}"), _cell(f.__doc__ or "")) for name, f in methods]
    yield from _table(("name", "meaning"), rows)


def instruments() -> Iterator[str]:
    """What a driver of each role offers, and the project's own with the keys of their tables in rig.yaml."""
    yield from ("# Instruments", "", MADE)
    yield from ("`driver:` names the driver; a package of yours [adds its own](../howto/driver.md).", "")
    yield from ("## What every driver does", "", *_prose(interfaces))
    for role in ROLES:
        yield from (
            f"## {role}",
            "",
            f"Interface: `drivers.interfaces.{OFFERS[role].__name__}`.",
            "",
            *_prose(OFFERS[role]),
        )
        rows = [(_code(f"{name}{_signature(f)}"), _cell(inspect.getdoc(f) or "")) for name, f in _methods(OFFERS[role])]
        yield from _table(("call", "does"), rows)
        for name, driver in drivers().items():
            if driver.role == role and driver.config.__module__.startswith("drivers."):
                yield from (f"### {name}", "", *_prose(inspect.getmodule(driver.config)))
                yield from _tables(driver.config, "", level=4, leave_out=("driver",))
    for kind in (SerialLine, Retries, PtyFake):
        yield from _class(kind, f"{kind.__module__}.{kind.__name__}", made=True)


def _methods(interface: type) -> Iterable[tuple[str, Any]]:
    own = [vars(one) for one in reversed(interface.__mro__) if one.__module__ == interfaces.__name__]
    found = {name: f for members in own for name, f in members.items() if inspect.isfunction(f)}
    return [(name, f) for name, f in found.items() if not name.startswith("_")]


def effects() -> Iterator[str]:
    """The catalogue of effects, stage by stage."""
    yield from (
        "# Effects",
        "",
        MADE,
        "Sizes are what is plausible on a robot like the paper's: standard deviations of the prior.",
    )
    yield from ("`lab effects` draws what each does; [why they are as they are](../explanations/effects.md).", "")
    for stage in STAGES:
        yield from (f"## {stage}", "")
        for e in (e for e in CATALOGUE.values() if e.stage == stage):
            yield from (
                f"### {e.id}",
                "",
                _sentence(e.name),
                "",
                _code(e.equation),
                "",
                f"Seen best in: {e.seen_best_in}. Source: {e.citation}.",
                "",
            )
            rows = [(_code(p.name), p.role, p.unit, f"{p.scale:.4g}", _bounds(p)) for p in e.parameters]
            yield from _table(("parameter", "role", "unit", "plausible", "bounds"), rows)


def _bounds(p: Parameter) -> str:
    return f"{p.low:.4g} .. {p.high:.4g}"


def streams() -> Iterator[str]:
    """The streams of a recording, with the fields of their messages."""
    yield from ("# Streams of a recording", "", MADE, "")
    for topic, message in STREAMS.items():
        yield from (f"## {topic}", "", *([_sentence(message.doc), ""] if message.doc else []))
        rows = [
            (_code(f.name), f.kind + (f" {'x'.join(map(str, f.shape))}" if f.shape else ""), f.unit, _cell(f.doc))
            for f in message.fields
        ]
        yield from _table(("field", "type", "unit", "meaning"), rows)


def python() -> Iterator[str]:
    """The names of `import lab`."""
    yield from ("# Python", "", MADE, "")
    for name in lab.__all__:
        found = getattr(lab, name)
        yield from (f"## lab.{name}", "", "```text", f"{name}{_signature(found)}", "```", "", *_prose(found))
        if inspect.isclass(found):
            notes = _notes(found)
            members = (
                [n for n in found.__annotations__ if not n.startswith("_")] if hasattr(found, "__annotations__") else []
            )
            methods = {
                n: inspect.getdoc(m) or ""
                for n, m in vars(found).items()
                if not n.startswith("_") and inspect.getdoc(m)
            }
            rows = [(_code(n), _cell(notes.get(n, ""))) for n in members] + [
                (_code(n), _cell(d)) for n, d in methods.items() if n not in members
            ]
            yield from _table(("name", "meaning"), rows)


def _signature(found: Any) -> str:
    return str(inspect.signature(found)).replace("'", "").replace("(self, ", "(").replace("(self)", "()")


def _tables(model: type[BaseModel], title: str, level: int = 2, leave_out: Sequence[str] = ()) -> Iterator[str]:
    """A table of keys for a model, under no heading without a title, and one for each model inside it."""
    schema = model.model_json_schema()
    inner = _inside(model, leave_out)
    names = {one.__name__: key for one, key in inner.items()}
    for one, key in {model: title, **inner}.items():
        own = schema if one is model else schema["$defs"][one.__name__]
        if key:
            yield from (f"{'#' * level} {key}", "")
        yield from _prose(one)
        notes, needed = _notes(one), own.get("required", ())
        rows = [
            (_code(k), _form(field, names), "required" if k in needed else _default(field), _cell(notes.get(k, "")))
            for k, field in own["properties"].items()
            if one is not model or k not in leave_out
        ]
        yield from _table(("key", "value", "default", "meaning"), rows)


def _inside(model: type[BaseModel], leave_out: Sequence[str] = ()) -> dict[type[BaseModel], str]:
    """The models of a model's fields, each once, with the key under which it is met first."""
    found: dict[type[BaseModel], str] = {}
    for key, field in model.model_fields.items():
        for inner in () if key in leave_out else _models(field.annotation):
            found.setdefault(inner, key)
            found = {**{m: f"{key}.{k}" for m, k in _inside(inner).items()}, **found}
    return found


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


WORDS = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "array": "list",
    "object": "table",
}
BOUNDS = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}


def _form(field: Mapping[str, Any], names: Mapping[str, str] = MappingProxyType({})) -> str:
    """What may stand in a field, from its schema: kind, unit, limits."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"the table {_code(names.get(name, name))}"
    kinds = [k for k in (*field.get("anyOf", ()), *field.get("oneOf", ())) if k.get("type") != "null"]
    if kinds:
        words = " or ".join(dict.fromkeys(_form(k, names) for k in kinds))
    elif "enum" in field or "const" in field:
        words = " or ".join(map(str, field.get("enum", (field.get("const"),))))
    elif field.get("type") == "array":
        items = field.get("items") or (field.get("prefixItems") or [{}])[0]
        few = len(field["prefixItems"]) if "prefixItems" in field else 0
        kind = re.sub(r"\b(list|number)\b", r"\1s", _form(items, names), count=1)
        words = f"{few} {kind}" if few else f"list of {kind}"
    else:
        words = WORDS.get(field.get("type", ""), "any")
    limits = " ".join(f"{word} {field[key]:g}" for key, word in BOUNDS.items() if key in field)
    unit = field.get("unit", "")
    return _cell(", ".join(part for part in (words, limits, "" if unit == "1" else unit) if part))


def _default(field: Mapping[str, Any]) -> str:
    value = field.get("default")
    if isinstance(value, dict):
        return ""
    return "" if value in (None, "", [], {}) else _cell(str(value).lower() if isinstance(value, bool) else f"{value}")


def _notes(model: type) -> dict[str, str]:
    """The docstrings under the fields of a class and of those it derives from."""
    found: dict[str, str] = {}
    for one in reversed(model.__mro__):
        try:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(one))).body
        except (OSError, TypeError):
            continue
        body = getattr(tree, "body", [])
        for field, note in zip(body, body[1:], strict=False):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(note, ast.Expr)
                and isinstance(note.value, ast.Constant)
            ):
                found[field.target.id] = str(note.value.value)
    return found


def _prose(of: Any) -> Iterator[str]:
    """A docstring; what is indented in it stays as it stands, and an example up to the next empty line."""
    quoted = ""
    for line in (inspect.getdoc(of) or "").splitlines():
        if line.startswith(">>> ") and not quoted:
            inside = "python"
        elif quoted == "python":
            inside = quoted if line else ""
        else:
            inside = "text" if line.startswith("    ") or (quoted and not line) else ""
        if inside != quoted:
            yield from ("```", "") if quoted else (f"```{inside}",)
            quoted = inside
        yield line
    if quoted:
        yield "```"
    yield ""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    rows = list(rows)
    if rows:
        yield from ("", f"| {' | '.join(head)} |", "|" + "---|" * len(head))
        yield from (f"| {' | '.join(row)} |" for row in rows)
    yield ""


def _code(text: str) -> str:
    return f"`{_cell(text)}`"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _sentence(text: str | None) -> str:
    text = (text or "").strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


if __name__ == "__main__":
    write_all(Path(__file__).parent / "reference")
