"""What a page says, without its markup of terms and identifiers."""

from __future__ import annotations

import re


def read_as_text(page: str) -> str:
    """The page without links, small print and classes."""
    return re.sub(r"</?a\b[^>]*>|</?small[^>]*>|<wbr>| class=\"\w+\"", "", page)
