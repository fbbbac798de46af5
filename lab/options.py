"""Declare a verb of the command: options, examples, page and function. Each declaration follows its function."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recordings.numbers import number, whole_number


@dataclass(frozen=True)
class Option:
    """One argument of a verb."""

    names: tuple[str, ...]
    how: dict[str, Any]

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Have it parsed."""
        parser.add_argument(*self.names, **self.how)


class OneOf:
    """Options of which at most one may be given; exactly one if `required`."""

    def __init__(self, *options: Option, required: bool = False) -> None:
        self.options, self.required = options, required

    @property
    def names(self) -> tuple[str, ...]:
        """Of all of them."""
        return tuple(name for one in self.options for name in one.names)

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Have them parsed."""
        group = parser.add_mutually_exclusive_group(required=self.required)
        for one in self.options:
            one.add_to(group)


Options = Sequence[Option | OneOf]


@dataclass(frozen=True)
class Result:
    """The result of a verb: as JSON, as text for a person, and as an exit code."""

    data: object = None
    show: Callable[[], object] | None = None
    """Prints it for a person; None: the JSON serves people too, or everything has been printed already."""
    code: int = 0
    error: BaseException | None = None
    """Raised once the result is printed."""
    then: Callable[[], object] | None = None
    """Runs after printing, until a person ends it."""
    safe: bool = True
    """The safe state of the rig was confirmed."""
    again: str | None = None
    """The command that continues it."""

    def tell(self) -> None:
        """Print it for a person."""
        from .console import err, out  # declaring options must not import the console

        if self.show is not None:
            self.show()
        if not self.safe:
            err.print("The safe state is not confirmed: use the vent valve and the emergency stop.", style="red")
        if self.again is not None:
            out.print(f"go on with: {self.again}", soft_wrap=True)


@dataclass(frozen=True)
class Verb:
    """A verb without its group and summary, which are in the table of `lab.cli`."""

    name: str
    call: Callable[[argparse.Namespace], Result]
    """The function: takes the parsed arguments; with --json, `console.out` prints nothing while it works."""
    options: Options
    examples: tuple[str, str]
    page: str
    """The page of the documentation that explains it."""

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add options and the end of the help to the verb's parser."""
        lines = "\n".join(f"  {line}" for line in self.examples)
        parser.epilog = f"examples:\n{lines}\n\npage: {self.page}"
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        for one in self.options:
            one.add_to(parser)

    def unknown_option(self, words: Sequence[str]) -> str:
        """Return the error for the first unknown option in the words; "" if all are known."""
        known = ["-h", "--help", *(name for one in self.options for name in one.names)]
        given = words[: words.index("--")] if "--" in words else words
        if {"-h", "--help"} & set(given):
            return ""
        for name in (word.partition("=")[0] for word in given):
            if OPTION.fullmatch(name) and name not in known:
                return unknown(f"lab {self.name} {name}", "an option", name, known, f"lab {self.name} --help lists the options")
        return ""


OPTION = re.compile(r"--?[a-zA-Z][^\s]*")
"""A word that is an option, not a value."""


def unknown(said: str, kind: str, name: str, known: Iterable[str], otherwise: str) -> str:
    """Return the error for an unknown name: the nearest known one, or where to look."""
    from model.errors import nearest  # after a module of another package by this name was told

    return f"{said}: is not {kind}; {nearest(name, known, otherwise)}"


TYPES: dict[Any, Callable[[str], float]] = {float: number, int: whole_number}
"""Parser for each number type on the command line."""


def option(name: str, metavar: str | None = None, help: str | None = None, **how: Any) -> Option:
    """Return an option or a positional argument; `how` as for argparse's add_argument."""
    how |= {"help": help} | ({} if metavar is None else {"metavar": metavar})
    if how.get("type") in TYPES:
        how["type"] = TYPES[how["type"]]
    return Option((name,), how)


def path_option(name: str, metavar: str, help: str, **how: Any) -> Option:
    """Return an option that names a file or folder."""
    return option(name, metavar, help, type=Path, **how)


def rig(required: bool = True) -> Option:
    """Return the option --rig."""
    return path_option("--rig", "RIG.yaml", "rig.yaml", required=required)


def repeatable(name: str, metavar: str, help: str) -> Option:
    """Return an option that may be given several times."""
    return option(name, metavar, help, action="append", default=[])


def inputs(text: str) -> Option:
    """Return the argument for one or more files or folders."""
    return option("inputs", type=Path, nargs="+", metavar="INPUT", help=text)


JSON = option("--json", action="store_true", help="print the result as JSON")
ANY_SIZE = option(
    "--any-size", action="store_true", help="accept files with an unusually high compression ratio; only if you trust them"
)
"""For every verb that reads recordings: lifts the limits of size."""
REPLACE = option("--replace", action="store_true", help="delete and replace the output folder with everything in it")
INPUTS = inputs("recordings (.mcap) or case folders, read as one campaign")
ROBOT = path_option("--robot", "ROBOT.yaml", "robot.yaml (default: the one in the input)")
READS, OF_CASE = (JSON, ANY_SIZE), (ANY_SIZE, INPUTS, ROBOT)
WORKERS = option("--workers", type=int, metavar="N", help="processor cores to use (default: all)")
SCHEDULER = option("--scheduler", help="use a Dask scheduler instead, tcp://host:port (extra `cluster`)")
OWN_EFFECTS = path_option("--effects", "FILE.py", "Python file with your own effects (a tuple named EFFECTS)")
YES = option("--yes", action="store_true", help="do not ask: all is prepared, and nobody is within reach")
LABELS = (
    option("--operator", "NAME", "name of the operator; recorded, as are the next two"),
    option("--specimen", "NAME", "name of the mounted specimen"),
    repeatable("--tag", "KEY=VALUE", "a label of your own (repeatable)"),
)


def given_labels(a: argparse.Namespace) -> dict[str, str]:
    """Return names and texts of the given LABELS. Raises ConfigError."""
    from recordings.campaign.labels import labels, split
    from recordings.errors import BadMessage

    from .files.config import ConfigError

    named = [(name, text) for name in ("operator", "specimen") if (text := getattr(a, name)) is not None]
    place = "--tag "  # prefix of messages while tags are read
    try:
        tags = [split(text) for text in a.tag]
        place = ""
        return labels([*named, *tags])
    except BadMessage as e:
        raise ConfigError(f"{place}{e}") from e
