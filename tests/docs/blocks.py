"""The fenced blocks of README and docs, and what says that one is not run."""

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"(?m)^(?P<in> *)```(?P<kind>[^\n]*)\n(?P<text>.*?)^(?P=in)```[ ]*$", re.S)
MARK = re.compile(r"<!-- (not run|run by|file): ((?:(?!-->).)+) -->\s*\Z", re.S)
FILE = re.compile(r"# ([\w./-]+\.(?:yaml|py))\n")
"""A block that begins with a comment of nothing but a file's name is that file."""


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    page: Path
    line: int
    kind: str
    text: str
    not_run: str = ""
    """Why."""
    run_by: str = ""
    """The test that does: a file, perhaps with ::test_name."""

    named: str = ""
    """The file that a comment above says it is."""

    @property
    def file(self) -> str:
        """The file it is; empty for others."""
        found = FILE.match(self.text)
        return found[1] if found else self.named

    @property
    def where(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def pages() -> list[Path]:
    """README and docs, without what is made from the code."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [p for p in found if p.parent.name != "reference"]


def anchors(page: Path) -> set[str]:
    """What GitHub and the site call the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        mark = MARK.search(text[: match.start()])
        said = {"not run": "", "run by": "", "file": ""} | ({mark[1]: " ".join(mark[2].split())} if mark else {})
        line = text.count("\n", 0, match.start()) + 1
        kind, body = match["kind"].strip(), textwrap.dedent(match["text"])
        found.append(Block(page, line, kind, body, said["not run"], said["run by"], said["file"]))
    return found
