"""`lab completion`: what a shell needs to complete verbs, options, files and the names of protocols."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import shtab

from model.effects import CATALOGUE

from ..files.all_protocols import found_protocols
from ..files.protocol_keys import protocol_keys
from ..options import Verb, option
from .fakes import effect_names

SHELLS = ("bash", "zsh")
FOLDERS = ("folder",)
"""Arguments, by their name, that are folders."""

CHOOSE = {
    "bash": """
_lab_protocols() { compgen -W "%(protocols)s" -- "$1"; compgen -f -X '!*.py' -- "$1"; compgen -f -X '!*.yaml' -- "$1"; \
compgen -d -- "$1"; }
_lab_keys() { compgen -W "%(keys)s" -S = -- "$1"; }
_lab_effects() { compgen -W "%(effects)s" -- "$1"; }
_lab_played() { compgen -W "%(played)s" -- "$1"; }
""",
    "zsh": """
_lab_protocols() { _alternative "protocols:protocol:(%(protocols)s)" 'files:file:_files -g "*.(py|yaml)"' }
_lab_keys() { compadd -S = -- %(keys)s }
_lab_effects() { compadd -- %(effects)s }
_lab_played() { compadd -- %(played)s }
""",
}
"""What is offered for a protocol (a name or a file), a key of `--set`, an effect of the model, and one of the fakes."""
OFFERED = {"protocol": "_lab_protocols", "set": "_lab_keys", "with_effects": "_lab_effects", "effect": "_lab_played"}
"""By the destination of the argument."""


def completion(shell: str, top: argparse.ArgumentParser) -> int:
    """Print the completion of `top` for a shell."""
    for action in arguments(top):
        if action.dest in OFFERED:
            action.complete = dict.fromkeys(SHELLS, OFFERED[action.dest])  # type: ignore[attr-defined]
        elif action.type is not None and getattr(action.type, "__name__", "") == "Path":
            action.complete = shtab.DIRECTORY if action.dest in FOLDERS else shtab.FILE  # type: ignore[attr-defined]
    protocols = found_protocols().usable
    names = {
        "protocols": protocols,
        "keys": sorted({key.name for p in protocols.values() for key in protocol_keys(p.parameters, {})}),
        "effects": CATALOGUE,
        "played": effect_names(),
    }
    words = CHOOSE[shell] % {what: " ".join(those) for what, those in names.items()}
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


VERBS = (
    Verb(
        "completion",
        lambda a: completion(a.shell, a.parser()),
        options=(option("shell", choices=SHELLS),),
        examples=("lab completion bash > completions/lab", "lab completion zsh > completions/_lab"),
        page="docs/howto/command.md",
    ),
)
