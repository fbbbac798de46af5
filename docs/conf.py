"""The site's settings. `make docs` writes the reference pages from the code, then builds the site into out/docs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from notebook import executed  # noqa: E402 - it lies beside this file
from reference_pages import write_all  # noqa: E402 - it lies beside this file

from lab.version import installed  # noqa: E402

write_all(HERE / "reference")

project = "softlab"
author = "softlab"
release = version = installed("softlab")
html_title = "softlab"
html_theme = "furo"
html_copy_source = False
html_show_copyright = html_show_sphinx = False
extensions = ["myst_parser"]
highlight_language = "text"
myst_heading_anchors = 3
exclude_patterns = ["_*"]
source_suffix = {".md": "markdown", ".ipynb": "markdown"}


def setup(app: Any) -> None:
    """Show notebooks as Markdown with what their cells give."""

    def as_markdown(app: Any, page: str, content: list[str]) -> None:
        if page.startswith("notebooks/"):
            content[0] = executed((HERE / f"{page}.ipynb").resolve())[0]

    app.connect("source-read", as_markdown)
