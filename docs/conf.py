"""The site's settings. `make docs` writes the reference pages from the code, then builds the site into out/docs."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

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
