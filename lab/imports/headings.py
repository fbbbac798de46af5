"""Read the headings of a file: quantity, axis and unit of each column."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from recordings.trials import column_order

from ..files.units import KINDS, SPELLED

WORDS = {
    "t": "t time timestamp datetime clock seconds sec elapsed millis micros zeit uhrzeit laufzeit messzeit zeitpunkt temps heure "
    "tiempo hora tempo ora",
    "trial": "trial trials run runs experiment exp versuch inflation sweep cycle zyklus lauf messreihe essai ensayo prova",
    "repeat": "repeat repeats repetition rep reps pass passes wiederholung wdh durchlauf durchgang répétition passage repetición "
    "ripetizione",
    "branch": "branch direction phase richtung",
    "spine_length": "spine spinelength growth grown insertion",
    "tip_mass": "mass weight payload masse gewicht spitzenmasse endmasse zusatzmasse tipmass",
    "roll_deg": "roll",
    "vacuum": "vacuum vakuum",
    "force": "force kraft",
}
"""Words of a heading by column of trials.csv."""


def word_set(text: str) -> frozenset[str]:
    """Words between blanks."""
    return frozenset(text.split())


TENDON = word_set("""
tendon tendons tension tensions cable cables wire wires rope ropes pull pulls
zug züge seil seile sehne sehnen zugkraft zugkräfte seilkraft seilkräfte sehnenkraft sehnenkräfte draht drähte bowdenzug
câble câbles fil fils corde cordes tirant tirants
tendón tendones tensión tensiones hilo hilos cuerda cuerdas cordón cordones tirante tirantes cordon
cavo cavi filo fili fune funi tendine tendini tensione tensioni tiranti
""")
"""Words of a heading for a tendon or its tension."""
INFLATED = TENDON | word_set("""
chamber chambers kammer kammern actuator actuators aktor aktoren muscle muscles muskel muskeln
bladder bladders pouch pouches valve valves ventil ventile channel channels kanal kanäle inflated active aktiv group gruppe side
seite direction richtung pattern muster combination kombination
""")
"""Words of a heading under which stands what is inflated or pulled, as a number or a word."""
PRESSURE = re.compile(r"(?<![^\W\d_])(?:p|pressures?|druck|chamber|kammer|press|pr|ch|sp|pv)(\d+)")
PRESSURE_WORDS = word_set("p pressure pressures druck chamber kammer press presion regulator regulators regler")
ASKED_FOR = word_set("""
set setpoint setpoints setpt sp soll sollwert cmd command commanded target desired ref reference des goal demand
demanded requested req consigne vorgabe consigna input
""")
OTHER_PRESSURES = word_set("""
supply reservoir tank source vacuum vakuum ambient atmosphere atmospheric barometric baro inlet compressor versorgung
umgebung jamming layout offset stamp stride status
""")
"""Words of pressures that are none of a chamber."""
READ = word_set("meas measured mes mesure ist istwert act actual pv fb feedback read reading sensor sensed real medida")
COMPOUND = re.compile(
    rf"^(p|pr|press|pressure|druck|chamber|kammer)(\d*)({'|'.join(sorted(ASKED_FOR | READ, key=len, reverse=True))})(\d*)$"
)
"""Quantity and what it is, written as one word."""
TIP_WORDS = frozenset(["tip", "ee", "end", "effector", "endeffector", "spitze", "top", "tcp", "tool", "head", "distal"])
PLACE_WORDS = TIP_WORDS | {"pos", "position", "place", "xyz", "coordinates", "translation", "ort", "lage"}
BASE_WORDS = frozenset(["base", "root", "basis", "origin", "fixed", "foot", "proximal", "bottom"])
WORDS_OF_BRANCH = {
    "load": "load up loading inflate inflating inflation rise rising increase auf hin forward",
    "unload": "unload down unloading deflate deflating deflation fall falling decrease ab zurueck backward",
}
UNITS = {unit.casefold(): (kind, unit) for kind in ("m", "Pa", "Pa/s", "s", "kg", "N", "N/s", "deg") for unit in KINDS[kind]}
UNITS |= {word: UNITS[unit.casefold()] for word, unit in SPELLED.items()}
UNSTATED = word_set("1 - -- – a.u. au n/a none n.u. frame frames sample samples # date iso8601 date/time unitless") | {""}
"""Cells in a row of units that state no unit."""
OTHER_UNITS = UNSTATED | word_set("""
v mv uv ma a hz khz °c c k % nm n·m n*m m/s mm/s rad/s deg/s °/s m/s² m/s^2 in/s ft kgf lbf gf lb oz at °f °k g/s l/min ml/min
sccm v/v bool boolean px counts lsb s^-1 ohm kohm nt ut mt gauss hh:mm:ss hh:mm:ss.000
""")
LOADS = word_set("""
load loads weights payloads last lasten anhängelast hängelast nutzlast zusatzlast zuladung gewichte massen charge charges poids
lest carga cargas peso pesos masa carico carichi massa
""")
"""Words of a heading for the mass at the tip if its unit is one of a mass; else it may be a force, or a branch."""
OF_QUANTITY = dict.fromkeys(("m", "in"), word_set("x y z")) | {"s": word_set(WORDS["t"])}
OF_QUANTITY |= {"g": word_set(WORDS["tip_mass"]) | LOADS, "n": word_set(WORDS["force"]) | TENDON | {"fx", "fy", "fz"}}
"""Units that may be words: they end a heading with one of these words, such as "weight_g"."""
ALONE = frozenset(["mm", "s", "ms", "millis", "micros"])
"""Units that may be all of a heading."""
ELECTRIC = frozenset({"v", "mv", "ma", "a", "counts", "lsb"})
"""Units, in lower case, of sensors that nobody has scaled."""


@dataclass(frozen=True)
class Heading:
    """A heading taken apart."""

    name: str
    words: tuple[str, ...]
    """Lower case, without its unit; letters and digits apart from each other only where the writer set them apart."""
    unit: str = ""
    kind: str = ""
    """SI unit that the unit is one of."""
    stated: str = ""
    """The stated unit, in brackets or elsewhere in the file, even if it is unknown here."""

    def says(self, words: Container[str]) -> bool:
        """Whether a word of it, numbers aside, is one of these: a set-point with `ASKED_FOR`, a reading with `READ`."""
        return any(w.rstrip("0123456789") in words for w in self.words)


def unit_named(text: str) -> tuple[str, str] | None:
    """SI unit and unit of a cell such as "[mm]" or "Sekunden"; None for anything that is no unit of this software."""
    return UNITS.get(text.strip().strip("[](){}<>").strip().casefold()) or UNITS.get(text.strip().casefold())


def is_unit(text: str) -> bool:
    """Whether a cell could stand in a row of units."""
    return unit_named(text) is not None or text.strip().strip("[](){}<>").strip().casefold() in OTHER_UNITS


def heading(name: str, unit: str = "") -> Heading:
    """Words and unit of a heading, such as "Tip X [mm]", "p1_kPa", "Time, s"; else `unit`, what the file says elsewhere."""
    stated = unit if is_unit(unit) else ""
    kind, unit = unit_named(unit) or ("", "")
    rest = name
    bracketed = list(re.finditer(r"[\[(]([^\])]+)[\])]", name))
    for match in bracketed or re.finditer(r"(?:[/,]|\s[iI][nN]\s)\s*([^/,]+?)\s*$", name):
        if known := unit_named(match[1]) or unit_named((match[1].split() or [""])[0]):
            (kind, unit), rest = known, f"{name[: match.start()]} {name[match.end() :]}"
            stated = match[1]
            break
        # a unit that this software does not know
        if bracketed and match.end() == len(name.rstrip()) and is_unit(match[1]) and match[1] not in UNSTATED:
            stated, rest = match[1], f"{name[: match.start()]} {name[match.end() :]}"
    parts = [w for w in re.split(r"[^0-9A-Za-zÀ-ÿ]+", rest) if w]
    last = parts[-1].casefold() if parts and not stated and (len(parts) > 1 or parts[0] in ALONE) else ""
    if last in UNITS:
        word = (len(parts[-1]) == 1 or last == "in") and len(parts) > 1  # a unit only behind a word for its quantity
        of_quantity = {w.casefold() for w in parts[:-1]} & OF_QUANTITY.get(last, frozenset())
        kind, unit = UNITS[last] if not word or of_quantity else ("", "")
        parts = parts[: -1 if unit and len(parts) > 1 else None]
    words = [w.casefold() for part in parts for w in re.sub(r"(?<=[a-z])(?=[A-Z])", " ", part).split()]
    apart = [w for word in words for w in COMPOUND.sub(r"\1\2 \3 \4", word).split()]
    return Heading(name, tuple(apart), unit, kind, "" if stated.strip().casefold() in UNSTATED else stated)


def quantity(h: Heading) -> str | None:
    """The column of trials.csv that one heading names by itself."""
    for column, words in WORDS.items():
        if set(words.split()) & set(h.words) or (column == "t" and h.words in (("s",), ("x", "value"))):
            return column
    return "tip_mass" if h.kind == "kg" and LOADS & set(h.words) else None


def own_column(h: Heading) -> str | None:
    """The column of trials.csv of which a heading is the very name, its unit aside: "hold", "rate [N/s]"."""
    name = re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", h.name.strip())
    return name if column_order(name) is not None else None


def names_inflated(h: Heading) -> bool:
    """Whether what is inflated may stand under a heading: "chambers", but not "chamber 1" or "chamber [kPa]"."""
    return bool(INFLATED & set(h.words)) and not h.stated and not any(c.isdigit() for w in h.words for c in w)


def chamber(h: Heading) -> int | None:
    """The number of a chamber whose pressure a heading names, from 0 or 1 as its writer counts."""
    joined = " ".join(h.words)
    if OTHER_PRESSURES & set(h.words) or (h.stated and h.kind != "Pa" and h.stated.casefold() not in ELECTRIC):
        return None
    if found := PRESSURE.search(joined):
        return int(found[1])
    if PRESSURE_WORDS & set(h.words) or h.kind == "Pa":
        numbered = [n for w in h.words if (n := re.fullmatch(r"([^\d]*)(\d+)", w))]
        numbered.sort(key=lambda n: n[1] not in {"", *ASKED_FOR, *READ})
        return int(numbered[0][2]) if numbered else 1
    return None


COMPOUND_TENDON = r"[^\W\d_]*(?:seil|sehne|kabel|draht|bowden|tendon|cable)[^\W\d_]*"
"""A word made of others, such as Seilzug or Zugseil."""
TENSION = re.compile(
    rf"(?<![^\W\d_])({'|'.join(sorted(TENDON, key=len, reverse=True))}|{COMPOUND_TENDON}|kraft|force|fuerza|forza|load|f|t|p)"
    r"\s?(\d+)(?!\d)"
)


def tendon(h: Heading) -> int | None:
    """The number of a tendon whose tension a heading names, from 0 or 1 as its writer counts."""
    found = TENSION.search(" ".join(h.words))
    if h.stated and h.kind != "N":
        return None
    if not found:
        return 1 if set(h.words) & TENDON and set(h.words) <= TENDON | ASKED_FOR | READ else None
    return int(found[2]) if h.kind == "N" or found[1] not in ("f", "t", "p") else None


TURN_WORDS = word_set("rotation rot euler angle angles winkel orientation attitude rotvec rpy turn drehung")
TURNS = (("roll", "pitch", "yaw"), ("rollen", "nicken", "gieren"), ("roulis", "tangage", "lacet"),
         ("alabeo", "cabeceo", "guiñada"),
         ("rollio", "beccheggio", "imbardata"), ("bank", "pitch", "heading"), ("roll", "nick", "gier"), ("rx", "ry", "rz"),
         ("rotx", "roty", "rotz"), ("alpha", "beta", "gamma"), ("phi", "theta", "psi"))  # fmt: skip
"""Names of turns about x, y and z."""


@dataclass(frozen=True)
class Triple:
    """Three columns that differ by x, y and z alone."""

    columns: tuple[str, str, str]
    words: frozenset[str]
    unit: str


def triples(headings: Sequence[Heading]) -> list[Triple]:
    """Groups x, y, z, without those that are a quaternion's or turns."""
    turns = {name for t in turning(headings) for name in t.columns}
    headings = [h for h in headings if h.name not in turns]
    found = [Triple((c["x"], c["y"], c["z"]), words, unit) for words, unit, c in _groups(headings) if len(c) == 3]
    return found or _counted(headings)


def unseen_axis(headings: Sequence[Heading]) -> tuple[str, str]:
    """The coordinate that one camera does not see, and a heading for it; empty unless one place alone has two coordinates."""
    groups = [(c, words, unit) for words, unit, c in _groups(headings) if unit in ("", *KINDS["m"])]
    pairs = [c for c, words, unit in groups if len(c) == 2 and (unit or words & PLACE_WORDS)]
    if len(pairs) != 1 or any(len(c) == 3 for c, _, _ in groups):
        return "", ""
    (axis,) = set("xyz") - set(pairs[0])
    seen, name = next(iter(pairs[0].items()))
    made = re.sub(rf"(?i)(?<![a-z]){seen}(?![a-z])", axis, name)
    return ("", "") if made in [h.name for h in headings] else (axis, made)


def _counted(headings: Sequence[Heading]) -> list[Triple]:
    """Columns 1, 2 and 3, and no more, of an array whose name says that it is a place."""
    groups: dict[tuple[str, ...], list[Heading]] = {}
    for h in headings:
        if h.words and h.words[-1].isdigit() and set(h.words) & PLACE_WORDS:
            groups.setdefault(h.words[:-1], []).append(h)
    return [
        Triple((of[0].name, of[1].name, of[2].name), frozenset(words), of[0].unit or of[0].stated)
        for words, of in groups.items()
        if tuple(h.words[-1] for h in of) in [("1", "2", "3"), ("0", "1", "2")]
    ]


def turning(headings: Sequence[Heading]) -> list[Triple]:
    """Groups of three angles: roll, pitch, yaw, or x, y, z of a rotation or in deg."""
    triples_found: list[Triple] = []
    used: set[str] = set()
    for names in TURNS:
        groups: dict[tuple[str, ...], dict[str, Heading]] = {}  # words with * for the angle's name -> name -> heading
        for h in headings:
            joined = " ".join(h.words)
            for name in names:
                if re.search(rf"(?:^|[ \d]){name}(?:$|[ \d])", joined) and h.name not in used:
                    groups.setdefault(tuple(joined.replace(name, "*").split()), {})[name] = h
        for pattern, group in groups.items():
            if len(group) == 3:
                three = [group[n] for n in names]
                words = frozenset(w for key in pattern for w in [re.sub(r"[*\d]", "", key)] if w) | set(names)
                triples_found.append(Triple((three[0].name, three[1].name, three[2].name), words, three[0].unit))
                used |= {h.name for h in three}
    for words, unit, c in _groups([h for h in headings if h.name not in used]):
        if len(c) == 3 and (unit in KINDS["deg"] or (not unit and words & TURN_WORDS)):
            triples_found.append(Triple((c["x"], c["y"], c["z"]), words, unit))
    return triples_found


def recognised(names: Sequence[str], units: Sequence[str] = ()) -> int:
    """How many columns different headings name a quantity of; `units` as a line of the file states them."""
    headings = _headings([n if names.count(n) == 1 else "" for n in names], units)
    places = {c for t in triples(headings) for c in t.columns}
    return sum(h.name in places or any(of(h) is not None for of in (quantity, chamber, tendon)) for h in headings)


def name_tip_and_actuators(names: Sequence[str], units: Sequence[str] = ()) -> bool:
    """Whether headings differ from each other and name, without lines above them, a place and a chamber or tendon."""
    headings = _headings(names, units)
    distinct = len({h.name for h in headings}) == len(headings)
    return distinct and bool(triples(headings)) and any(chamber(h) is not None or tendon(h) is not None for h in headings)


def _headings(names: Sequence[str], units: Sequence[str]) -> list[Heading]:
    return [heading(n, u) for n, u in zip(names, [*units, *[""] * len(names)], strict=False) if n]


def quadruples(headings: Sequence[Heading]) -> list[tuple[str, str, str, str]]:
    """Groups w, x, y, z; a quaternion's q0 is w, and q1 to q3 are x to z."""
    letter = partial(re.sub, "(?<=^q)[0-3]$|(?<=quat)[0-3]$", lambda digit: "wxyz"[int(digit[0])])
    lettered = [replace(h, words=tuple(map(letter, h.words))) for h in headings]
    return [(c["w"], c["x"], c["y"], c["z"]) for _, _, c in _groups(lettered) if len(c) == 4]


def _groups(headings: Sequence[Heading]) -> Iterator[tuple[frozenset[str], str, Mapping[str, str]]]:
    """Headings that differ by x, y, z (and w), or two of x, y, z, alone: the words they share, their unit, and axis -> column; no
    column twice."""
    groups: dict[tuple[str, ...], dict[str, Heading]] = {}  # words with * for the axis -> axis -> heading
    for h in headings:
        for k, word in enumerate(h.words):
            match = re.fullmatch(r"(.*?)([wxyz])|([wxyz])(\d*)", word)
            if match is None:
                continue
            stem, axis = (match[1], match[2]) if match[2] else (match[4] or "", match[3])
            if len(stem) > 12:  # letters: a long word that happens to end in x is no marker's name
                continue
            key = (*h.words[:k], f"{stem}*", *h.words[k + 1 :])
            groups.setdefault(key, {}).setdefault(axis, h)
    used: set[str] = set()
    for key, group in sorted(groups.items(), key=lambda item: -len(item[1])):
        names = {axis: h.name for axis, h in group.items()}
        complete = set(names) in (set("wxyz"), set("xyz")) or ("w" not in names and len(names) == 2)
        if complete and not used & set(names.values()):
            used |= set(names.values())
            shared = frozenset(re.sub(r"[*\d]", "", w) for k in key for w in k.split()) - {""}
            first = next(iter(group.values()))
            yield shared, first.unit or first.stated, names
