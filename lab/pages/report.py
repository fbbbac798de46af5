"""One offline HTML page: a sentence first, then sections of text, figures and tables. Nothing is loaded from anywhere.

In every text, a term of the glossary is linked at its first use in a section to its meaning at the end of the page, which is its
tooltip as well, and an identifier in square brackets is set in small print.
"""

from __future__ import annotations

import base64
import re
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FileSystemLoader
from markupsafe import Markup

from recordings.own_files import replaced

from ..plain import plain

GIVEN, CALIBRATED, WITH_CAUSE = "uncalibrated", "calibrated", "with cause"
"""Names of the models in every figure and table."""
NEAREST = "with the closest hypothesis"
"""Name of the last where nothing is named."""


@dataclass(frozen=True)
class Term:
    """A term, words with the same meaning separated by commas, with its unit in square brackets, and what it means."""

    heading: str
    meaning: str

    @property
    def words(self) -> list[str]:
        """What a reader may meet."""
        return self.heading.partition(" [")[0].split(", ")

    @property
    def anchor(self) -> str:
        """Name of its place at the end of the page."""
        return f"term-{TERMS.index(self)}"

    @property
    def bare(self) -> str:
        """Its meaning without Markdown."""
        return re.sub("[`*]", "", self.meaning)


_HEADINGS: dict[str, str] = yaml.safe_load(Path(__file__).with_name("glossary.yaml").read_text(encoding="utf-8"))
TERMS = tuple(Term(heading, meaning) for heading, meaning in _HEADINGS.items())
IMAGES = {".svg": "image/svg+xml", ".png": "image/png"}
NUMBER = re.compile(r"|none|[-+]?\d\S*( \.\. ([-+]?\d\S*|unbounded))?( \S+)?")
"""A cell of a column of numbers: empty, a number or a range, with or without a unit."""
BEGINS = re.compile(r"\(?[-+]?\d|$")
_TERM = {word.lower(): term for term in TERMS for word in term.words}
_ANY = re.compile(
    rf"(?<![\w./\"-])({'|'.join(map(re.escape, sorted(_TERM, key=len, reverse=True)))})(s?)(?![\w/\"-]|\.\w)", re.IGNORECASE
)
_IDENTIFIER = re.compile(r"\[(\w+)(\.\w+)?\]")


class CommandCell(str):
    """A cell with what to type."""


class Marks:
    """Turns texts into markup: terms linked, identifiers small, all else escaped."""

    def __init__(self, ids: Collection[str]) -> None:
        self._ids = ids
        self._met: set[Term] = set()
        self.used: set[Term] = set()

    def begin(self) -> str:
        """Start a section, in which each term is new."""
        self._met.clear()
        return ""

    def __call__(self, text: str) -> Markup:
        """The markup of a text."""
        if isinstance(text, CommandCell):
            return Markup("<code>{}</code>").format(plain(text))
        text = plain(text)
        made, end = Markup(""), 0
        for found in _IDENTIFIER.finditer(text):
            if found[1] in self._ids:
                made += self._linked(text[end : found.start()]) + Markup('<small class="soft">[{}{}]</small>').format(
                    found[1], Markup("<wbr>{}").format(found[2]) if found[2] else ""
                )
                end = found.end()
        return made + self._linked(text[end:])

    def _linked(self, text: str) -> Markup:
        made, end = Markup(""), 0
        for found in _ANY.finditer(text):
            term = _TERM[found[1].lower()]
            if term in self._met:
                continue
            self._met.add(term)
            self.used.add(term)
            link = Markup('<a class="term" href="#{}" title="{}">{}</a>').format(term.anchor, term.bare, found[0])
            made += Markup.escape(text[end : found.start()]) + link
            end = found.end()
        return made + Markup.escape(text[end:])


@dataclass
class PageSection:
    """A heading and what stands under it."""

    title: str
    folded: bool = False
    """Shown as its heading alone until it is opened."""
    items: list[dict[str, Any]] = field(default_factory=list)
    """Paragraphs, figures and tables, as the template takes them."""

    def text(self, *texts: str) -> PageSection:
        """Add paragraphs."""
        self.items += [{"kind": "text", "text": text} for text in texts]
        return self

    def figure(self, pictures: Path | Sequence[Path], caption: str) -> PageSection:
        """Add a picture (.svg or .png) or panels in rows, as images, so that nothing in them can run."""
        panels = [pictures] if isinstance(pictures, Path) else pictures
        data = [f"data:{IMAGES[p.suffix]};base64,{base64.b64encode(p.read_bytes()).decode()}" for p in panels]
        self.items.append({"kind": "figure", "caption": caption, "data": data})
        return self

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> PageSection:
        """Add a table; one without rows is left out."""
        if not rows:
            return self
        kinds = [""]  # class of each column: `n` numbers, `v` what begins with a number, empty: words
        for column in list(zip(*rows, strict=True))[1:]:
            begins = "v" if all(BEGINS.match(cell) for cell in column) else ""
            kinds.append("n" if all(NUMBER.fullmatch(cell) for cell in column) else begins)
        self.items.append({"kind": "table", "head": head, "rows": rows, "kinds": kinds})
        return self


@dataclass
class Report:
    """A page."""

    title: str
    source: str
    """What it was made from, which stands behind the time below the title."""
    lead: str
    warnings: Sequence[str] = ()
    """Above the lead: what has to be known before it is believed."""
    small: str = ""
    numbers: Sequence[tuple[str, str, str]] = ()
    """Name, value and how it was found, of what stands below the lead."""
    step: tuple[str, str] = ("", "")
    """What to do next, and the command to type."""
    foot: str = ""
    ids: Collection[str] = ()
    """Identifiers that texts have in square brackets, after the plain name."""
    sections: list[PageSection] = field(default_factory=list)

    def section(self, title: str, folded: bool = False) -> PageSection:
        """Start the next section."""
        self.sections.append(PageSection(title, folded))
        return self.sections[-1]

    def write(self, path: Path) -> Path:
        """Write the page."""
        environment = Environment(
            loader=FileSystemLoader(Path(__file__).parent),
            autoescape=True,
            finalize=lambda value: plain(value) if isinstance(value, str) and not isinstance(value, Markup) else value,
        )
        page = environment.get_template("report.html.j2").render(
            {name: value for name, value in vars(self).items() if name != "sections"},
            sections=[vars(s) for s in self.sections],
            when=time.strftime("%Y-%m-%d %H:%M"),
            marks=Marks(self.ids),
            terms=TERMS,
        )
        replaced(path, page)
        return path
