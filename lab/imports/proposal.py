"""A proposed map in the making: each value with its reason, and what a person has to check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..files.robot_file import in_one_line


@dataclass
class Guess:
    """A map in the making: its values, and why."""

    values: dict[str, Any] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    """What a person has to look at or to fill in."""
    doubtful: set[str] = field(default_factory=set)
    """Dotted keys that a doubt names."""

    def doubt(self, key: str, text: str) -> None:
        """Add a doubt about a dotted key."""
        self.doubtful.add(key)
        self.doubts.append(f"{key}: {text}")

    def say(self, key: str, value: Any, reason: str) -> None:
        """Set a dotted key."""
        *path, last = key.split(".")
        place = self.values
        for step in path:
            place = place.setdefault(step, {})
        place[last] = value
        self.reasons[key] = reason


def asking(text: str, questions: Sequence[str]) -> str:
    """The text of map.yaml with further questions under `unconfirmed`."""
    items = [f"- {in_one_line(question)}\n" for question in questions]
    head, key, rest = f"\n{text}".partition("\nunconfirmed:")
    indent = rest[1 : len(rest) - len(rest[1:].lstrip(" "))]
    if key and not rest.startswith(f"\n{indent}- "):  # in a form of its own
        return text
    return f"{head}\nunconfirmed:\n{''.join(indent + item for item in items)}{rest[1:]}".lstrip("\n")


def guess_text(g: Guess, robot: Path, files: Sequence[Path], form: str) -> str:
    """The text of map.yaml: the doubts as `unconfirmed`, then each value below a comment with its reason."""
    lines = [f"# Proposed for {', '.join(f.name for f in files[:5])} ({form}). Check each line; the reason is above it.", ""]
    if g.doubts:
        lines += ["# Guesses that the data do not force: correct them in the map, then delete them here.", "unconfirmed:"]
        lines += [*(f"- {in_one_line(doubt)}" for doubt in g.doubts), ""]
    lines.append(f"robot: {in_one_line(str(robot))}")
    for key, value in g.values.items():
        reasons = {k.partition(".")[2]: r for k, r in g.reasons.items() if k == key or k.startswith(f"{key}.")}
        lines.append("")
        if "" in reasons:
            lines += [f"# {reasons['']}", f"{key}: {in_one_line(value)}"]
            continue
        lines.append(f"{key}:")
        last_reason = ""  # neighbours with one reason share its comment
        nested = any("." in k for k in reasons)
        for name, inner in value.items():
            if nested and isinstance(inner, dict) and name not in reasons:
                lines.append(f"  {name}:")
                for k, v in inner.items():
                    lines += [f"    # {reasons[f'{name}.{k}']}", f"    {k}: {in_one_line(v)}"]
                continue
            if reasons.get(name, last_reason) != last_reason:
                last_reason = reasons[name]
                lines.append(f"  # {last_reason}")
            lines.append(f"  {name}: {in_one_line(inner)}")
    return "\n".join(lines) + "\n"
