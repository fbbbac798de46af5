"""What `lab help` and `lab VERB --help` print beside the options: verbs in groups, two examples of each, and its page."""

from __future__ import annotations

import argparse
import difflib
from typing import NamedTuple


class Shown(NamedTuple):
    """Two command lines that show a verb, and the page of the documentation that explains it."""

    examples: tuple[str, str]
    page: str


FIRST_DAY, COMMAND, SAFETY = "docs/tutorials/first-day.md", "docs/howto/command.md", "docs/explanations/safety.md"
RECORDINGS, EFFECTS, ANSWER = (
    "docs/explanations/recordings.md",
    "docs/explanations/effects.md",
    "docs/howto/use-the-answer.md",
)

GROUPS: dict[str, dict[str, Shown]] = {
    "rig": {
        "fakes": Shown(
            ("lab fakes --rig rig/rig.yaml --speed 20", "lab fakes --list-effects"),
            "docs/howto/fakes.md",
        ),
        "check": Shown(
            ("lab check --rig rig/rig.yaml", "lab check --rig rig/rig.yaml --move"), "docs/tutorials/your-rig.md"
        ),
        "safe": Shown(("lab safe --rig rig/rig.yaml", "lab safe --all"), SAFETY),
    },
    "run": {
        "plan": Shown(("lab plan bending --rig rig/rig.yaml", "lab plan bending --keys"), FIRST_DAY),
        "run": Shown(
            (
                "lab run bending --rig rig/rig.yaml --set repeats=3 --out runs",
                "lab run --resume runs/bending-20260102-101500.mcap --rig rig/rig.yaml",
            ),
            FIRST_DAY,
        ),
        "campaign": Shown(
            (
                "lab campaign campaign.yaml --rig rig/rig.yaml --plan",
                "lab campaign --resume april --rig rig/rig.yaml",
            ),
            "docs/howto/campaign.md",
        ),
        "watch": Shown(("lab watch rig/rig.yaml", "lab watch runs/sweep.mcap --speed 10"), "docs/howto/watch.md"),
        "investigate": Shown(
            (
                "lab investigate runs/sweep.mcap --rig rig/rig.yaml --budget 30min",
                "lab investigate case --rig rig/rig.yaml --no-hands",
            ),
            "docs/howto/investigate.md",
        ),
    },
    "recordings": {
        "info": Shown(("lab info runs/sweep.mcap", "lab info runs/*.mcap --json"), RECORDINGS),
        "runs": Shown(("lab runs runs", "lab runs runs --since 2026-01-02 --where operator=Ada"), RECORDINGS),
        "verify": Shown(("lab verify runs/sweep.mcap", "lab verify runs/sweep.mcap --json"), RECORDINGS),
        "recover": Shown(
            ("lab recover runs/sweep.mcap", "lab recover runs/sweep.mcap --out saved.mcap"), "docs/howto/resume.md"
        ),
        "replay": Shown(("lab replay runs/sweep.mcap", "lab replay runs/sweep.mcap --play --speed 1"), RECORDINGS),
        "export": Shown(
            ("lab export runs/sweep.mcap --out csv", "lab export runs/*.mcap --case --out case"), RECORDINGS
        ),
        "import": Shown(
            (
                "lab import table.csv --guess --robot robot.yaml --out map",
                "lab import table.csv --map map/map.yaml --robot robot.yaml --out case",
            ),
            "docs/howto/other-data.md",
        ),
    },
    "model and diagnosis": {
        "compare": Shown(("lab compare runs/*.mcap", "lab compare case --robot robot.yaml --out figures"), FIRST_DAY),
        "fit": Shown(("lab fit runs/*.mcap --out fitted", "lab fit case --with spine_slip --out fitted"), ANSWER),
        "predict": Shown(
            (
                "lab predict --robot fitted/robot.yaml --protocol bending",
                "lab predict --robot fitted/robot.yaml --inverse targets.csv",
            ),
            ANSWER,
        ),
        "diagnose": Shown(
            (
                "lab diagnose runs/*.mcap --report diagnosis.html",
                "lab diagnose case --json diagnosis.json --protocols next",
            ),
            "docs/explanations/diagnosis.md",
        ),
        "power": Shown(
            (
                "lab power --protocol bending --rig rig/rig.yaml",
                "lab power --protocol bending --robot robot.yaml --worlds 10 --no-additions",
            ),
            "docs/explanations/experiments.md",
        ),
        "effects": Shown(("lab effects", "lab effects --robot robot.yaml --effects my_effects.py"), EFFECTS),
    },
    "for developers": {
        "demo": Shown(("lab demo", "lab demo --out demo --seed 3"), FIRST_DAY),
        "blind": Shown(("lab blind make --help", "lab blind score --help"), "docs/howto/blind.md"),
        "paper": Shown(("lab paper", "lab paper --out figures --json"), "docs/explanations/model.md"),
        "schema": Shown(("lab schema rig > rig.schema.json", "lab schema bending"), COMMAND),
        "completion": Shown(
            ("lab completion bash > completions/lab", "lab completion zsh > completions/_lab"), COMMAND
        ),
    },
}
"""Every verb once, in the order of a day's work."""

METAVARS = {"rig": "RIG.yaml", "robot": "ROBOT.yaml", "out": "FOLDER", "map": "MAP.yaml", "inputs": "INPUT"}
"""How arguments are called that state no name of their own, by destination."""


def epilog(verb: str) -> str:
    """The end of the help of a verb."""
    shown = next(group[verb] for group in GROUPS.values() if verb in group)
    examples = "\n".join(f"  {line}" for line in shown.examples)
    return f"examples:\n{examples}\n\npage: {shown.page}"


class Verbs(argparse.ArgumentParser):
    """The command, whose help lists the verbs in groups."""

    def format_help(self) -> str:
        """Usage, description, verbs by group, and where to go on."""
        told = {action.dest: action.help for action in self._listed()}
        lines = ["usage: lab VERB ...", "", self.description or ""]
        for title, verbs in GROUPS.items():
            lines += ["", f"{title}:", *(f"  {verb:13}{(told[verb] or '').replace('%%', '%')}" for verb in verbs)]
        lines += ["", "lab VERB --help: options and examples of a verb; lab --version: version", f"start: {FIRST_DAY}"]
        return "\n".join(lines) + "\n"

    def _listed(self) -> list[argparse.Action]:
        """The verbs with their help."""
        found = [a for a in self._actions if isinstance(a, argparse._SubParsersAction)]  # noqa: SLF001
        return list(found[0]._get_subactions())  # noqa: SLF001 - argparse offers no list of them


def unknown(verb: str) -> str:
    """What is said of a verb that does not exist."""
    near = difflib.get_close_matches(verb, [name for group in GROUPS.values() for name in group], 1)
    return f"lab {verb}: is not a verb; " + (f"did you mean {near[0]}?" if near else "lab help lists the verbs")
