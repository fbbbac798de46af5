"""The reference pages and the glossary, made from the code: files, protocols, effects, instruments, streams, Python."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

import lab
from diagnosis.findings import TEMPLATES
from drivers import interfaces
from drivers.registry import ROLES
from lab.files.all_protocols import found_protocols
from lab.files.campaign_file import CampaignFile
from lab.files.map_file import Map
from lab.files.rig_file import RigFile, drivers
from lab.pages.report import TERMS
from model.effects import CATALOGUE
from model.effects.history import History
from model.effects.quantities import Quantities
from model.effects.readings import Readings
from model.effects.spec import STAGES, Parameter
from model.robot import Robot
from protocols import actions, suspension, visits
from protocols.bench import Bench, Setup
from protocols.experiment import Ask, Plan, Reading, Step, Trials
from protocols.visits import Sweep, Visit
from recordings import trials
from recordings.messages import STREAMS, MessageType
from recordings.states.rules import Crossing, Settled, Window

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
WITHIN: Mapping[type, Sequence[str]] = {
    Trials: ("begin_again", "zero", "soft"),
    Bench: (
        *("recorder", "narrator", "recoverable", "recover", "steering", "rest", "repeatable", "stood", "patience"),
        *("jammed", "bodies", "has_topic", "look_anew"),
    ),
    Quantities: ("robot", "design"),
    History: ("quantities", "path"),
    Readings: ("design",),
}
"""Members that only the project's own code uses."""
HELPERS = (
    "in_one_jamming",
    "setpoints",
    "change_of",
    "signed",
    "planned_rest",
    "around",
    "jam_lost",
    "release",
    "jam",
    "grow",
)
"""Functions likewise."""
MADE = "This page is made from the code."
WIDTH = 120
"""Of a line."""
VALUES = "[How to read a line](index.md)."


def write_all(folder: Path) -> None:
    """Write every page into `folder`."""
    pages = {
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
        "findings": findings(),
        "python": python(),
    }
    pages["../glossary"] = glossary()
    folder.mkdir(parents=True, exist_ok=True)
    for name, lines in pages.items():
        text = re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).rstrip() + "\n"
        page = folder / f"{name}.md"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def glossary() -> Iterator[str]:
    """Terms of the reports, as their pages explain them."""
    yield from ("# Glossary", "", "Look up the terms of code, command line and reports: term [unit]: meaning.")
    yield from ("Symbols are those of [the rod model](explanations/model.md).", "")
    yield from _list((f"**{term.heading}**", "", term.meaning) for term in TERMS)
    yield MADE


def rig_file() -> Iterator[str]:
    """Every table of rig.yaml but those of the instruments."""
    yield from ("# rig.yaml", "", "The tables of `instruments` are on [a page of their own](instruments.md).")
    yield from _file(RigFile, "rig", leave_out=("instruments",))


def robot_file() -> Iterator[str]:
    """Every table of robot.yaml."""
    yield from ("# robot.yaml", "", *_file(Robot, "robot"))


def map_file() -> Iterator[str]:
    """Every table of map.yaml."""
    yield from ("# map.yaml", "", "What it is for: [data from elsewhere](../howto/other-data.md).")
    yield from _file(Map, "map")


def campaign_file() -> Iterator[str]:
    """Every table of campaign.yaml."""
    yield from ("# campaign.yaml", "", "What it is for: [run a campaign](../howto/campaign.md).")
    yield from _file(CampaignFile, "campaign")


def _file(model: type[BaseModel], name: str, leave_out: Sequence[str] = ()) -> Iterator[str]:
    yield from (f"For an editor: `lab schema {name}`. {VALUES}", "", *_prose(model))
    for key, prose, rows in _tables(model, leave_out):
        yield from (*((f"## {key}", "", *prose) if key else ()), *_list(rows))


def trials_file() -> Iterator[str]:
    """The columns of trials.csv, as their module describes them."""
    yield from ("# trials.csv", "")
    yield from _prose(trials)
    yield from ("| column | unit | meaning |", "|---|---|---|")
    for pattern, unit, meaning in trials.COLUMNS:
        if meaning:
            names = ", ".join(f"`{name}`" for name in pattern.replace("[0-9]+", "1").replace(".*", "..").split("|"))
            yield f"| {names} | {unit} | {meaning} |"


def protocol_files() -> Iterator[str]:
    """The parameters of each protocol."""
    yield from ("# Protocols", "", "These are the keys of a protocol file, and of `--set` (`settle.band=2 kPa`).")
    yield from (VALUES, "")
    found = found_protocols().usable
    tables = {name: list(_tables(one.parameters)) for name, one in found.items()}
    several = _several(rows for each in tables.values() for _, _, rows in each[:1])
    for name, one in found.items():
        yield from (f"## {name}", "", *_prose(inspect.getmodule(one.parameters)), f"Needs: {', '.join(one.needs)}.", "")
        rows = tables[name][0][2]
        yield from _but(rows, several)
    yield from ("## Keys of several protocols", "", *_list(several))
    inner = {key: (prose, rows) for each in tables.values() for key, prose, rows in each[1:]}
    for key, (prose, rows) in inner.items():
        yield from (f"### {key}", "", *prose, *_list(rows))


def protocol_calls() -> Iterator[str]:
    """What a protocol of one's own calls."""
    yield from ("# Calls of a protocol", "")
    yield from ("How they fit together: [a protocol of your own](../howto/protocol.md).", "")
    yield from _wrapped(
        "All values are in SI units, times are rig time in s. `Settle`, `Jam` and `SpineMotion` have the keys of "
        "[`settle`, `jam` and `spine`](protocols.md) as fields."
    )
    yield ""
    for kind in (Visit, Sweep, Trials, Bench, Setup, Plan, Step, Ask, Reading, Settled, Window, Crossing):
        yield from _class(kind, kind.__name__, made=kind not in (Trials, Bench))
    for module in (visits, actions, suspension):
        yield from (f"## {module.__name__}", "", *_prose(module))
        yield from _list(
            (_code(f"{name}{_signature(f)}"), "", inspect.getdoc(f) or "")
            for name, f in vars(module).items()
            if inspect.isfunction(f) and f.__module__ == module.__name__ and name[0] != "_" and name not in HELPERS
        )


def quantities() -> Iterator[str]:
    """What laws of effects may change, with shapes."""
    yield from ("# Quantities that effects change", "")
    yield from ("How a law is written: [an effect of your own](../howto/effect.md).", "")
    yield from ("v: variants, n: states. An array of chambers has one axis more, so that a law writes", "")
    yield from ("```python", 'q.pressure = q.pressure * (1 - v["share"][..., None])', "```", "")
    for kind, part in ((Quantities, "before"), (History, "path"), (Readings, "after")):
        yield from _class(kind, f"{kind.__name__}: `{part}`")


def _class(kind: type, title: str, made: bool = False) -> Iterator[str]:
    """Fields and methods of a class, with their notes; `made`: a protocol makes it, so that its arguments count."""
    yield from (f"## {title}", "")
    yield from (*_wrapped(_code(f"{kind.__name__}{_signature(kind)}")), "") if made else ()
    yield from _prose(kind)
    notes, leave_out = _notes(kind), WITHIN.get(kind, ())
    said = kind.__doc__ or ""
    leave_out = (*leave_out, *(n for n in inspect.get_annotations(kind) if n not in notes and f"`{n}`" in said))
    fields = [n for n in inspect.get_annotations(kind) if n[0] != "_" and n not in leave_out]
    methods = {n: f for n, f in vars(kind).items() if inspect.isfunction(f) and n[0] != "_"}
    known = (*fields, *leave_out)
    rows = [(_code(f"{n}{_signature(f)}"), "", f.__doc__ or "") for n, f in methods.items() if n not in known]
    yield from _fields([n for n in fields if notes.get(n)] if made else fields, notes, rows)


def _fields(fields: Sequence[str], notes: Mapping[str, str], more: Sequence[Row] = ()) -> Iterator[str]:
    """Fields with a note and other rows as a list, the names of the rest in one line."""
    yield from _list([*((_code(n), "", notes[n]) for n in fields if notes.get(n)), *more])
    bare = ", ".join(_code(n) for n in fields if not notes.get(n))
    yield from _wrapped(f"{'Also' if len(bare.split()) < len(fields) else 'Fields:'} {bare}.") if bare else ()
    yield ""


def instruments() -> Iterator[str]:
    """What a driver of each role offers, and the project's own with the keys of their tables in rig.yaml."""
    yield from ("# Instruments", "")
    yield from ("`driver:` names the driver; a package of yours [adds its own](../howto/driver.md).", VALUES, "")
    yield from ("## What every driver does", "", *_prose(interfaces))
    offers = {role: _calls(OFFERS[role]) for role in ROLES}
    every = [row for row in offers["arm"] if all(row in rows for rows in offers.values())]
    yield from _list(every)
    own = {name: d for name, d in drivers().items() if d.config.__module__.startswith("drivers.")}
    tables = {name: list(_tables(driver.config, leave_out=("driver",))) for name, driver in own.items()}
    several = _several(each[0][2] for each in tables.values())
    yield from ("## Keys of several drivers", "", *_list(several))
    for role in ROLES:
        yield from (f"## {role}", "", f"`drivers.interfaces.{OFFERS[role].__name__}`:", *_prose(OFFERS[role]))
        yield from _list(row for row in offers[role] if row not in every)
        for name in (name for name, driver in own.items() if driver.role == role):
            yield from (f"### {name}", "", *_prose(inspect.getmodule(own[name].config)))
            (_, _, rows), *inner = tables[name]
            yield from _but(rows, several)
            for key, prose, rows in inner:
                yield from (f"#### {key}", "", *prose, *_list(rows))
    samples = [k for n, k in vars(interfaces).items() if n.endswith("Sample")]
    yield from ("## Samples", "", "`t`: when it arrived, s of the rig's clock.", "")
    yield from _list((_code(f"{k.__name__}({', '.join(inspect.get_annotations(k))})"), "", k.__doc__ or "") for k in samples)
    yield ""


def _calls(interface: type) -> list[Row]:
    own = [vars(one) for one in reversed(interface.__mro__) if one.__module__ == interfaces.__name__]
    found = {name: f for members in own for name, f in members.items() if inspect.isfunction(f)}
    return [(_code(f"{name}{_signature(f)}"), "", inspect.getdoc(f) or "") for name, f in found.items() if name[0] != "_"]


def effects() -> Iterator[str]:
    """The catalogue of effects, stage by stage."""
    yield from ("# Effects", "", "`lab effects` draws what each does.")
    yield from ("[Why they are as they are](../explanations/effects.md).", "")
    yield from _wrapped(
        "Of each parameter: a plausible size on the paper's robot (prior standard deviation; others in proportion), and its "
        "bounds. A *shape* changes how a law acts, not whether."
    )
    yield ""
    for stage in STAGES:
        yield from (f"## {stage}", "")
        for e in (e for e in CATALOGUE.values() if e.stage == stage):
            yield from (f"### {e.id}", "", f"{_sentence(e.name())}", "", *_wrapped(f"`{e.equation}`"), "")
            yield from _wrapped("; ".join(map(_parameter, e.parameters)) + ".")
            source = f" Source: {e.citation}." if len(e.citation.split()) > 1 else ""
            yield from ("", *_wrapped(f"Shows in: {e.seen_best_in}.{source}"), "")


def _parameter(p: Parameter) -> str:
    unit = "" if p.unit == "1" else f" {p.unit}"
    bounds = f"+-{p.high:.4g}" if p.low == -p.high else f"[{p.low:.4g}, {p.high:.4g}]"
    return f"{'shape ' if p.role == 'shape' else ''}`{p.name}` {p.scale:.4g}{unit}, {bounds}"


def findings() -> Iterator[str]:
    """Codes of what an answer states besides its numbers, by severity."""
    yield from ("# Findings", "", "Codes in diagnosis.json (`findings`: `code`, `severity`, `values`, `text`).", "")
    for severity, texts in TEMPLATES.items():
        yield from (*_wrapped(f"**{severity}**: {', '.join(map(_code, texts))}."), "")


def streams() -> Iterator[str]:
    """The streams of a recording, with the fields of their messages."""
    yield from ("# Streams of a recording", "", "A field without a type is a double.", "")
    several = _several(map(_stream, STREAMS.values()))
    yield from ("Of all streams:", "", *_list(several))
    for topic, message in STREAMS.items():
        yield from (f"## {topic}", "", *([_sentence(message.doc), ""] if message.doc else []))
        yield from _list(row for row in _stream(message) if row not in several)


def _stream(message: MessageType) -> list[Row]:
    """Field, its type and size with its unit, meaning."""
    rows = []
    for f in message.fields:
        parts = (
            f.kind * (f.kind != "double"),
            f"[{'x'.join(map(str, f.shape))}]" * bool(f.shape),
            f.unit.replace("1", ""),
        )
        rows.append((_code(f.name), " ".join(part for part in parts if part), f.doc))
    return rows


def python() -> Iterator[str]:
    """The names of `import lab`."""
    yield from ("# Python", "")
    for name in lab.__all__:
        found = getattr(lab, name)
        yield from (f"## lab.{name}", "", *_wrapped(_code(f"{name}{_signature(found)}")), "", *_prose(found))
        if inspect.isclass(found):
            members = [n for n in getattr(found, "__annotations__", ()) if not n.startswith("_")]
            methods = {n: inspect.getdoc(m) or "" for n, m in vars(found).items() if n[0] != "_" and inspect.getdoc(m)}
            more = [(_code(n), "", d) for n, d in methods.items() if n not in members]
            yield from _fields(members, _notes(found), more)


def _signature(found: Any) -> str:
    """Names, defaults and what is returned; types and units are in the code and the text."""
    whole = inspect.signature(found)
    bare = [p.replace(annotation=p.empty, default=_short(p.default)) for name, p in whole.parameters.items() if name != "self"]
    text = str(whole.replace(parameters=bare, return_annotation=whole.empty))
    returned = str(whole.return_annotation)
    return text if returned in ("None", str(whole.empty)) else f"{text} -> {returned}"


def _short(default: Any) -> Any:
    """A default value; of one that has fields only the name of its class, of one that is made anew `..`."""
    if repr(default) == "<factory>":
        return _Named("..")
    whole = isinstance(default, BaseModel) or (is_dataclass(default) and not isinstance(default, type))
    return _Named(f"{type(default).__name__}()") if whole else default


class _Named(str):
    """Text that stands for a value as it is."""

    __repr__ = str.__str__


def _tables(model: type[BaseModel], leave_out: Sequence[str] = ()) -> Iterator[tuple[str, list[str], list[Row]]]:
    """Key, prose and rows of a model (its key is empty), and of each model inside it."""
    schema = model.model_json_schema()
    inner = _inside(model, leave_out)
    names = {one.__name__: key for one, key in inner.items()}
    for one, key in {model: "", **inner}.items():
        own = schema if one is model else schema["$defs"][one.__name__]
        notes, needed = _notes(one), own.get("required", ())
        rows = [
            (_code(k), _form(field, names, k in needed), notes.get(k, ""))
            for k, field in own["properties"].items()
            if one is not model or k not in leave_out
        ]
        yield key, list(_prose(one)), rows


def _inside(model: type[BaseModel], leave_out: Sequence[str] = ()) -> dict[type[BaseModel], str]:
    """The models of a model's fields, each once, with the key under which it is met first."""
    found: dict[type[BaseModel], str] = {}
    for key, field in model.model_fields.items():
        for inner in () if key in leave_out else _models(field.annotation):
            found.setdefault(inner, key)
            for deeper, below in _inside(inner).items():
                found.setdefault(deeper, f"{key}.{below}")
    return found


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


WORDS = {"number": "", "integer": "integer", "string": "text", "boolean": "", "array": "list", "object": "table"}


def _form(field: Mapping[str, Any], names: Mapping[str, str], needed: bool = False) -> str:
    """What may stand in a field, from its schema: default with unit, or that it is required, kind, limits."""
    kind, limits = _kind(field, names)
    unit = "" if field.get("unit") in (None, "1") else str(field["unit"])
    default = "" if needed else _default(field)
    first = f"{default} {unit}".strip() if default else ", ".join(p for p in ("required" * needed, unit) if p)
    shown = kind if not default or " or " in kind or "one of" in kind else ""
    return ", ".join(p for p in (first, shown, limits) if p)


def _kind(field: Mapping[str, Any], names: Mapping[str, str]) -> tuple[str, str]:
    """Kind and limits; a number's kind is empty."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"table `{names.get(name, name)}`", ""
    kinds = [k for k in (*field.get("anyOf", ()), *field.get("oneOf", ())) if k.get("type") != "null"]
    if kinds:
        found = list(dict.fromkeys(_kind(k, names) for k in kinds))
        if len(found) == 1:
            return found[0]
        if len({limits for _, limits in found}) == 1:
            return " or ".join(kind or "number" for kind, _ in found), found[0][1]
        return " or ".join(" in ".join(p for p in (kind or "number", limits) if p) for kind, limits in found), ""
    if "enum" in field or "const" in field:
        choices = [str(value) for value in field.get("enum", (field.get("const"),))]
        return " or ".join(choices) if len(choices) < 3 else f"one of {', '.join(choices)}", ""
    if field.get("type") == "array":
        items = field.get("items") or (field.get("prefixItems") or [{}])[0]
        kind, limits = _kind(items, names)
        many = re.sub(r"\b(list|number|integer)\b", r"\1s", kind or "number", count=1)
        few = len(field["prefixItems"]) if "prefixItems" in field else 0
        return (f"{few} {many}" if few else f"list of {many}"), limits
    return WORDS.get(field.get("type", ""), "any"), _limits(field)


def _limits(field: Mapping[str, Any]) -> str:
    """An interval, or the one bound there is."""
    above, least, below, most = (field.get(k) for k in ("exclusiveMinimum", "minimum", "exclusiveMaximum", "maximum"))
    low, high = above if least is None else least, below if most is None else most
    if low is None and high is None:
        return ""
    if high is None:
        return f"{'>' if least is None else '>='}{low:g}"
    start = "(-inf" if low is None else f"{'(' if least is None else '['}{low:g}"
    return f"{start}, {high:g}{')' if most is None else ']'}"


def _default(field: Mapping[str, Any]) -> str:
    value = field.get("default")
    return "" if isinstance(value, dict) or value in (None, "", []) else _shown(value)


def _shown(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


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
    quoted, paragraph = "", ""
    for line in (*(inspect.getdoc(of) or "").splitlines(), ""):
        if line.startswith(">>> ") and not quoted:
            inside = "python"
        elif quoted == "python":
            inside = quoted if line else ""
        else:
            inside = "text" if line.startswith("    ") else ""
        if paragraph and (inside or not line or line.startswith("- ")):
            yield from _wrapped(paragraph, "  " if paragraph.startswith("- ") else "")
            paragraph = ""
        if inside != quoted:
            yield from ("```", "") if quoted else ("", f"```{inside}")
            quoted = inside
        if quoted or not line:
            yield line
        else:
            paragraph = f"{paragraph} {line.strip()}".strip()


Row = tuple[str, str, str]
"""Name, form of the value, meaning."""


def _several(tables: Iterable[Sequence[Row]]) -> list[Row]:
    """The rows with a meaning that most of several tables have, one for each name, whether required there or not."""
    counts = Counter(
        (name, form.removeprefix("required").removeprefix(", "), text) for rows in tables for name, form, text in rows if text
    )
    found = [row for row, count in counts.most_common() if count > 1]
    names = [row[0].strip("`").split()[0] for row in found]
    return [row for n, row in enumerate(found) if names[n] not in names[:n]]


def _but(rows: Sequence[Row], several: Sequence[Row]) -> Iterator[str]:
    """The rows of a table; the names alone of those that are explained elsewhere on the page, as tables of their own are."""
    known = {
        (name, form, text)
        for name, form, text in rows
        if (name, form.removeprefix("required").removeprefix(", "), text) in several or (form.startswith("table") and not text)
    }
    yield from _list(row for row in rows if row not in known)
    names = (
        f"`{name.strip('`').split()[0]}`{' (required)' * form.startswith('required')}"
        for name, form, text in rows
        if (name, form, text) in known
    )
    yield from (*_wrapped(f"Also {', '.join(names)}."), "") if known else ()


def _list(rows: Iterable[Row]) -> Iterator[str]:
    for name, form, meaning in rows:
        text = " ".join(meaning.split())
        yield from _wrapped(": ".join(p for p in (f"- {name}", ". ".join(q for q in (form, text) if q)) if p), "  ")
    yield ""


def _wrapped(text: str, indent: str = "") -> list[str]:
    """Lines of which none begins with what Markdown would take for the start of a list, a quotation or a table."""
    glued = re.sub(r" (?=([-+*>=|#]+|\d+[.)])( |$))", "\0", text)
    lines = textwrap.wrap(
        glued, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False, drop_whitespace=True
    )
    return [line.replace("\0", " ") for line in lines]


def _code(text: str) -> str:
    return f"`{' '.join(text.split())}`"


def _sentence(text: str | None) -> str:
    text = (text or "").strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


if __name__ == "__main__":
    write_all(Path(__file__).parent / "reference")
