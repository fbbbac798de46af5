"""`lab completion`: what a shell needs to complete verbs, options, files and the names of protocols."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import shtab

from ..files.all_protocols import found_protocols

SHELLS = ("bash", "zsh")
FOLDERS = ("folder",)
"""Arguments, by their name, that are folders."""

CHOOSE = {
    "bash": """
_lab_protocols() { compgen -W "%s" -- "$1"; compgen -f -- "$1"; }
""",
    "zsh": """
_lab_protocols() { _alternative "protocols:protocol:(%s)" "files:file:_files" }
""",
}
"""A protocol is named, or is a file."""


def completion(shell: str, top: argparse.ArgumentParser) -> int:
    """Print the completion of `top` for a shell."""
    for action in arguments(top):
        if action.dest == "protocol" and not action.option_strings:
            action.complete = dict.fromkeys(SHELLS, "_lab_protocols")  # type: ignore[attr-defined]
        elif action.type is not None and getattr(action.type, "__name__", "") == "Path":
            action.complete = shtab.DIRECTORY if action.dest in FOLDERS else shtab.FILE  # type: ignore[attr-defined]
    words = CHOOSE[shell] % " ".join(found_protocols().usable)
    sys.stdout.write(shtab.complete(top, shell, preamble=words) + "\n")
    return 0


def arguments(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Every argument of a parser and of its verbs."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no other list of them
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                yield from arguments(inner)
        else:
            yield action
