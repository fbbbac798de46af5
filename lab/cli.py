"""The `lab` command: one verb, one thing. Exit code 0 ok, 1 failed, 2 wrong usage or configuration, 3 done but data was lost."""

from __future__ import annotations

import argparse
import gc
import os
import re
import sys
from collections.abc import Callable, Collection, Sequence
from importlib import import_module

from .options import Option, Result, Verb, unknown

OK, FAILED, USAGE = 0, 1, 2

GROUPS: dict[str, dict[str, tuple[str, str]]] = {
    "rig": {
        "init": ("verbs.init", "write a commented robot.yaml, and a rig.yaml, from a few numbers"),
        "fakes": ("verbs.fakes", "start the fake instruments and print the rig.yaml that reaches them"),
        "check": ("verbs.check", "connect to each instrument: identity, rate, age, limits"),
        "jog": ("verbs.jog", "set chambers, spine and valve by hand, with all readings; Ctrl-C vents"),
        "safe": ("verbs.safe", "vent, stop and release the spine, confirmed by reading back"),
    },
    "run": {
        "plan": ("verbs.run", "show steps, duration and limits of a protocol; nothing moves"),
        "run": ("verbs.run", "run a protocol and record it"),
        "campaign": ("campaign.command", "run several protocols in a designed order; plan and resume them as a whole"),
        "watch": ("verbs.watch", "show a run live in the browser, or play a recording"),
        "investigate": ("investigation.command",
                        "diagnose, run the most informative experiment, and repeat until the cause is clear"),
    },
    "recordings": {
        "info": ("verbs.recorded", "show a recording's streams, rates, losses, provenance and outcome"),
        "runs": ("verbs.recorded", "list the recordings of a folder tree, with outcome and losses"),
        "verify": ("verbs.recorded", "compare every checksum, record and index of a recording"),
        "recover": ("verbs.recorded", "save everything readable in a damaged or truncated recording"),
        "replay": ("verbs.recorded", "compute the trials again from the recording alone and compare with the live run"),
        "export": ("verbs.export", "write recordings and cases for other programs: CSV, MATLAB, a case, an RO-Crate"),
        "import": ("verbs.import_data", "turn other programs' measurements into a case, with a map of their columns"),
    },
    "model and diagnosis": {
        "compare": ("verbs.compare", "compare measurements with the model: error table and figure"),
        "fit": ("verbs.fit", "calibrate the model on recordings or a case folder"),
        "predict": ("verbs.predict", "predict the tip with 95 % intervals, or find pressures for wanted tips"),
        "diagnose": ("verbs.diagnose", "locate the model error, name its cause, and propose the next experiment"),
        "power": ("investigation.power", "which causes a planned experiment can distinguish, and what would improve it"),
        "effects": ("verbs.effects", "list the catalogue of effects, or draw what each does to the tip"),
    },
    "for developers": {
        "demo": ("verbs.demo", "record, fit and diagnose on fake instruments, and write an HTML report"),
        "schema": ("verbs.developer",
                   "JSON schema of rig.yaml, robot.yaml, arm.yaml, map.yaml, campaign.yaml or a protocol file, for your editor"),
        "completion": ("verbs.developer", "print the shell's completion script for verbs, options and files"),
    },
}  # fmt: skip
"""Every verb once, in the order of a day's work: the module that declares it, which only its own use imports, and its summary."""
VERBS = {name: row for group in GROUPS.values() for name, row in group.items()}


def declared(name: str) -> Verb:
    """Import the module of a verb and return its declaration."""
    found: Sequence[Verb] = import_module(f"lab.{VERBS[name][0]}").VERBS
    return next(verb for verb in found if verb.name == name)


class LabParser(argparse.ArgumentParser):
    """The command, whose help lists the verbs in groups."""

    def format_help(self) -> str:
        """Return usage, description, verbs by group, and further help."""
        lines = ["usage: lab VERB ...", "", self.description or ""]
        for title, verbs in GROUPS.items():
            lines += ["", f"{title}:", *(f"  {verb:13}{summary}" for verb, (_, summary) in verbs.items())]
        lines += ["", "lab VERB --help: options and examples of a verb; lab --version: version"]
        return "\n".join([*lines, "start: docs/tutorials/first-day.md"]) + "\n"


def parser(whole: Collection[str] = tuple(VERBS)) -> argparse.ArgumentParser:
    """Return the parser of the command; only the verbs named in `whole` have their options."""
    top = LabParser(prog="lab", description="Runs a soft-robotics lab: instruments, experiments, recordings, model.")
    top.add_argument("--version", action="store_true", help="print the version, and the commit of a checkout")  # see `main`
    top.set_defaults(parser=parser)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=argparse.ArgumentParser)
    for name, (_, summary) in VERBS.items():
        said = summary.replace("%", "%%")  # argparse formats the help
        p = verbs.add_parser(name, help=said, description=summary, allow_abbrev=False)  # `safe --al` is not `--all`
        if name in whole:
            declared(name).add_to(p)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; errors become one clear message and an exit code."""
    # The matrices of fits and diagnoses are small: threads of the linear algebra would only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(20_000)  # looking for garbage took a tenth of short commands: few of the libraries' objects ever are
    from .console import complain, out, plain_failures
    from .version import strangers, version_text

    if wrong := strangers():
        complain(wrong)
        return USAGE
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words == ["help"]:
        parser(()).print_help()
        return OK if words else USAGE
    if words[0] == "--version":
        out.print(version_text())
        return OK
    if words[0] == "help":
        words = [*words[1:], "--help"]
    if not words[0].startswith("-") and words[0] not in VERBS:
        complain(unknown(f"lab {words[0]}", "a verb", words[0], VERBS, "lab help lists the verbs"))
        return USAGE
    plain_failures()
    try:
        return _run(words)
    except KeyboardInterrupt:
        complain("stopped")
        return FAILED
    except Exception as e:
        from .failures import explained  # knows the errors of every room, of which most verbs need few

        explanation = explained(e)
        if explanation is None:
            raise
        text, code = explanation
        complain(text)
        return code


def _run(words: Sequence[str]) -> int:
    """Parse the words and call their verb."""
    from .console import complain

    named = [word for word in words if word in VERBS][:1]
    if named and words[0] == named[0] and (wrong := declared(named[0]).unknown_option(words[1:])):
        complain(wrong)
        return USAGE
    top = parser(named)
    a, extra = top.parse_known_args(words)
    if extra:
        top.error(f"unrecognized arguments: {' '.join(extra)}{_hint(words, extra[0], a.verb)}")
    if getattr(a, "any_size", False):
        from recordings.file.budget import lift

        lift()
    return perform(declared(a.verb).call, a)


def _hint(words: Sequence[str], extra: str, verb: str) -> str:
    """Why a word is left over: the unit of a value without its quotes, or one more of what the verb takes once."""
    *_, option, value = ["", "", *words[: words.index(extra)]]
    if option.startswith("--") and re.search(r"(^|=)-?[\d.]+$", value):
        return f"; quote a value with spaces: {option} '{value} {extra}'"
    takes = [each for each in declared(verb).options if isinstance(each, Option) and not each.names[0].startswith("-")]
    once = takes and not extra.startswith("-") and "nargs" not in takes[-1].how
    return f"; lab {verb} takes one {takes[-1].names[0]}" if once else ""


def perform(call: Callable[[argparse.Namespace], Result], a: argparse.Namespace) -> int:
    """Do a verb, print its result as JSON or for a person, and return the exit code; raises the result's error."""
    from .console import answer, out

    out.quiet = as_json = getattr(a, "json", None) is True
    try:
        result = call(a)
    finally:
        out.quiet = False
    if as_json or result.show is None:
        answer(result.data, one_line=result.then is not None)
    else:
        result.tell()
    if result.then is not None:
        result.then()
    if result.error is not None:
        raise result.error
    return result.code


if __name__ == "__main__":
    sys.exit(main())
