"""One offline HTML page: a sentence first, then sections of text, figures and tables. Nothing is loaded from anywhere."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, FileSystemLoader

from recordings.own_files import replaced

from ..plain import plain

IMAGES = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True)
class Item:
    """A paragraph, a figure or a table."""

    kind: str
    text: str = ""
    caption: str = ""
    data: Sequence[str] = ()
    head: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()


@dataclass
class Section:
    """A heading and what stands under it."""

    title: str
    folded: bool = False
    """Shown as its heading alone until it is opened."""
    items: list[Item] = field(default_factory=list)

    def text(self, text: str) -> Section:
        """Add a paragraph."""
        self.items.append(Item("text", text=text))
        return self

    def figure(self, pictures: Path | Sequence[Path], caption: str) -> Section:
        """Add a picture (.svg or .png), or panels that stand in rows or, on a phone, below each other.

        They are put into the page as images, so that nothing in them can run.
        """
        panels = [pictures] if isinstance(pictures, Path) else pictures
        data = [f"data:{IMAGES[p.suffix]};base64,{base64.b64encode(p.read_bytes()).decode()}" for p in panels]
        self.items.append(Item("figure", caption=caption, data=data))
        return self

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Section:
        """Add a table; one without rows is left out."""
        if not rows:
            return self
        self.items.append(Item("table", head=head, rows=rows))
        return self


@dataclass
class Report:
    """A page."""

    title: str
    subtitle: str
    lead: str
    warnings: Sequence[str] = ()
    """Above the lead: what has to be known before it is believed."""
    small: str = ""
    """Below the lead, in small print."""
    numbers: Sequence[tuple[str, str, str]] = ()
    """Name, value and how it was found, of what stands below the lead."""
    step: tuple[str, str] = ("", "")
    """What to do next, and the command to type."""
    foot: str = ""
    sections: list[Section] = field(default_factory=list)

    def section(self, title: str, folded: bool = False) -> Section:
        """Start the next section."""
        self.sections.append(Section(title, folded))
        return self.sections[-1]

    def write(self, path: Path) -> Path:
        """Write the page."""
        environment = Environment(
            loader=FileSystemLoader(Path(__file__).parent),
            autoescape=True,
            finalize=lambda value: plain(value) if isinstance(value, str) else value,
        )
        page = environment.get_template("report.html.j2").render(
            {name: value for name, value in vars(self).items() if name != "sections"},
            sections=[vars(s) for s in self.sections],
        )
        replaced(path, page)
        return path
