"""Text from instruments, files and people, made fit to be shown: it says what it says and does nothing."""

from __future__ import annotations

import re
import shlex

_ACTS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but tab and newline, what turns the direction of writing, and halves of characters."""


def plain(text: str) -> str:
    """The text with every character that would act on a terminal or page written out, as in \\x1b, but tabs and line ends."""
    return _ACTS.sub(lambda found: found[0].encode("unicode_escape").decode(), text.replace("\r\n", "\n"))


def one_line(text: str) -> str:
    """The same on a single line, for files that are read line by line."""
    return plain(text).replace("\n", "\\n")


def typed(*words: object) -> str:
    """A command as a person types it: paths with spaces are quoted."""
    return shlex.join(map(str, words))
