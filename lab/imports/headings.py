"""What the headings of a file say: quantity, axis and unit of each column."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..files.units import KINDS

WORDS = {
    "t": "t time zeit temps tiempo timestamp seconds sec elapsed",
    "trial": "trial run experiment exp versuch inflation",
    "repeat": "repeat repetition rep wiederholung",
    "branch": "branch direction phase richtung",
    "spine_length": "spine spinelength growth grown insertion",
    "tip_mass": "mass weight payload masse gewicht",
    "roll_deg": "roll",
    "vacuum": "vacuum vakuum",
    "force": "force kraft",
}
"""Words of a heading by column of trials.csv."""
PRESSURE = re.compile(r"(?:p|pressures?|druck|chamber|kammer|press|pr|ch)(\d+)")
PRESSURE_WORDS = frozenset(["p", "pressure", "pressures", "druck", "chamber", "kammer", "press", "presion"])
ASKED_FOR = frozenset(
    ["set", "setpoint", "soll", "cmd", "command", "commanded", "target", "desired", "ref", "reference", "des", "goal"]
)
TIP_WORDS = frozenset(["tip", "ee", "end", "effector", "endeffector", "spitze", "top", "tcp", "tool", "head", "distal"])
BASE_WORDS = frozenset(["base", "root", "basis", "origin", "fixed", "foot", "proximal", "bottom"])
WORDS_OF_BRANCH = {
    "load": "load up loading inflate inflating inflation rise rising increase auf hin forward",
    "unload": "unload down unloading deflate deflating deflation fall falling decrease ab zurueck backward",
}
UNITS = {
    unit.casefold(): (kind, unit)
    for kind in ("m", "Pa", "s", "kg", "N", "deg")
    for unit in KINDS[kind]
    if unit != "rad"
}


@dataclass(frozen=True)
class Heading:
    """A heading taken apart."""

    name: str
    words: tuple[str, ...]
    """Lower case, without its unit; letters and digits apart from each other only where the writer set them apart."""
    unit: str = ""
    kind: str = ""
    """SI unit that the unit is one of."""

    @property
    def asked_for(self) -> bool:
        """A set-point rather than a reading."""
        return bool(ASKED_FOR & set(self.words))


def heading(name: str) -> Heading:
    """Words and unit: "Tip X [mm]", "p1_kPa", "tip.x (m)"."""
    unit, kind, rest = "", "", name
    if bracket := re.search(r"[\[(/]\s*([^\])/]+?)\s*[\])]?\s*$", name):
        found = UNITS.get(bracket[1].strip().casefold())
        if found:
            (kind, unit), rest = found, name[: bracket.start()]
    parts = [w for w in re.split(r"[^0-9A-Za-zÀ-ÿ]+", rest) if w]
    if not unit and parts and (len(parts) > 1 or parts[0] in ("mm", "s", "ms")) and parts[-1].casefold() in UNITS:
        kind, unit = UNITS[parts[-1].casefold()] if len(parts[-1]) > 1 or len(parts) == 1 else ("", "")
        parts = parts[: -1 if unit and len(parts) > 1 else None]
    words = [w for part in parts for w in re.sub(r"(?<=[a-z])(?=[A-Z])", " ", part).split()]
    return Heading(name, tuple(w.casefold() for w in words), unit, kind)


def quantity(h: Heading) -> str | None:
    """The column of trials.csv that one heading names by itself."""
    for column, words in WORDS.items():
        if set(words.split()) & set(h.words) or (column == "t" and h.words == ("s",)):
            return column
    return None


def chamber(h: Heading) -> int | None:
    """The number of a chamber whose pressure a heading names, from 0 or 1 as its writer counts."""
    joined = " ".join(h.words)
    if found := PRESSURE.search(joined):
        return int(found[1])
    if PRESSURE_WORDS & set(h.words) or h.kind == "Pa":
        digits = [int(w) for w in h.words if w.isdigit()]
        return digits[0] if digits else 1
    return None


@dataclass(frozen=True)
class Triple:
    """Three columns that differ by x, y and z alone."""

    columns: tuple[str, str, str]
    words: frozenset[str]
    """What else the headings say."""
    unit: str


def triples(headings: Sequence[Heading]) -> list[Triple]:
    """Groups x, y, z, without those that are a quaternion's."""
    return [Triple((c["x"], c["y"], c["z"]), words, unit) for words, unit, c in _groups(headings) if len(c) == 3]


def quadruples(headings: Sequence[Heading]) -> list[tuple[str, str, str, str]]:
    """Groups w, x, y, z."""
    return [(c["w"], c["x"], c["y"], c["z"]) for _, _, c in _groups(headings) if len(c) == 4]


def _groups(headings: Sequence[Heading]) -> Iterator[tuple[frozenset[str], str, Mapping[str, str]]]:
    found: dict[tuple[str, ...], dict[str, Heading]] = {}
    for h in headings:
        for k, word in enumerate(h.words):
            match = re.fullmatch(r"(.*?)([wxyz])|([wxyz])(\d*)", word)
            if match is None:
                continue
            stem, axis = (match[1], match[2]) if match[2] else (match[4] or "", match[3])
            if len(stem) > 12:
                continue
            key = (*h.words[:k], f"{stem}*", *h.words[k + 1 :])
            found.setdefault(key, {}).setdefault(axis, h)
    used: set[str] = set()
    for key, group in sorted(found.items(), key=lambda item: -len(item[1])):
        names = {axis: h.name for axis, h in group.items()}
        whole = set(names) == set("wxyz") or set(names) == set("xyz")
        if whole and not used & set(names.values()):
            used |= set(names.values())
            said = frozenset(re.sub(r"[*\d]", "", w) for k in key for w in k.split()) - {""}
            yield said, next(iter(group.values())).unit, names
