"""`lab completion`: what a shell needs to complete verbs, options, files and the names of protocols."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import shtab

from model.effects import CATALOGUE

from ..files.all_protocols import found_protocols, protocol_keys
from ..options import Result, Verb, option
from .fakes import effect_names

SHELLS = ("bash", "zsh")
FOLDERS = ("folder",)
"""Arguments, by their name, that are folders."""

FUNCTIONS = {
    "bash": """
_lab_protocol() { compgen -W "%s" -- "$1"; compgen -f -X '!*.py' -- "$1"; compgen -f -X '!*.yaml' -- "$1"; compgen -d -- "$1"; }
_lab_set() { compgen -W "%s" -S = -- "$1"; }
""",
    "zsh": """
_lab_protocol() { _alternative "protocols:protocol:(%s)" 'files:file:_files -g "*.(py|yaml)"' }
_lab_set() { compadd -S = -- %s }
""",
}
"""What is offered for a protocol (a name or a file) and for a key of `--set`, by the destination of the argument."""


def completion(shell: str, top: argparse.ArgumentParser) -> Result:
    """Print the completion of `top` for a shell."""
    protocols = found_protocols().usable
    keys = {key.name for p in protocols.values() for key in protocol_keys(p.parameters, {})}
    words = {"with_effects": list(CATALOGUE), "effect": list(effect_names())}
    for action in arguments(top):
        if action.dest in words:
            action.choices = words[action.dest]
        elif action.dest in ("protocol", "set"):
            action.complete = {shell: f"_lab_{action.dest}"}  # type: ignore[attr-defined]
        elif action.type is not None and getattr(action.type, "__name__", "") == "Path":
            action.complete = shtab.DIRECTORY if action.dest in FOLDERS else shtab.FILE  # type: ignore[attr-defined]
    functions = FUNCTIONS[shell] % (" ".join(protocols), " ".join(sorted(keys)))
    sys.stdout.write(shtab.complete(top, shell, preamble=functions) + "\n")
    return Result()


def arguments(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Every argument of a parser and of its verbs."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no other list of them
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                yield from arguments(inner)
        else:
            yield action


VERBS = (
    Verb(
        "completion",
        lambda a: completion(a.shell, a.parser()),
        options=(option("shell", choices=SHELLS),),
        examples=("lab completion bash > completions/lab", "lab completion zsh > completions/_lab"),
        page="docs/howto/command.md",
    ),
)
