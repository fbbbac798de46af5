"""Units a person may write in a file, turned into the SI unit of the field: "250 kPa" -> 250000.0."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence

from model.errors import unit_text
from recordings.numbers import NUMBER

KINDS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "Pa": {
        "Pa": 1.0, "hPa": 1e2, "mbar": 1e2, "kPa": 1e3, "bar": 1e5, "MPa": 1e6, "GPa": 1e9, "psi": 6894.757293168,
        "atm": 101_325.0, "mmHg": 133.322387415, "Torr": 101_325.0 / 760, "inHg": 3386.389, "cmH2O": 98.0665, "inH2O": 249.08891,
        "kgf/cm2": 98_066.5, "N/cm^2": 1e4,
    },
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.44822},
    "N m": {"N m": 1.0, "Nm": 1.0, "mNm": 1e-3},
    "N m^2": {"N m^2": 1.0, "Nm^2": 1.0, "N mm^2": 1e-6},
    "kg": {"kg": 1.0, "g": 1e-3},
    "kg/m": {"kg/m": 1.0, "g/m": 1e-3},
    "kg/m^3": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "rad": {"rad": 1.0, "deg": math.pi / 180},
    "deg": {"deg": 1.0, "rad": 180 / math.pi},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2},
    "m/s^2": {"m/s^2": 1.0, "mm/s^2": 1e-3},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "1": {"1": 1.0, "%": 1e-2},
    "A": {"A": 1.0, "mA": 1e-3},
}  # fmt: skip
KINDS |= {f"{kind}/s": {f"{unit}/s": size for unit, size in KINDS[kind].items()} for kind in ("Pa", "N")}
"""SI unit -> units of its kind, and their size: of files, headings of tables and the command line."""
_SPELLINGS = {
    "m": "meter meters metre metres mètres metros м", "cm": "centimeter centimeters centimetre centimetres zentimeter см",
    "mm": "millimeter millimeters millimetre millimetres millimètres milímetros мм",
    "um": "µm μm micrometer micrometers", "s": "sec secs second seconds sek sekunde sekunden secondes segundos с сек",
    "ms": "msec millis millisecond milliseconds millisekunden мс", "us": "µs μs usec micros microsecond microseconds",
    "ns": "nanosecond nanoseconds", "deg": "° degree degrees grad degrés grados град", "rad": "radian radians",
    "Pa": "pascal па", "kPa": "kilopascal kpag kpa(g) кпа", "bar": "barg bar(g) бар", "psi": "psig", "g": "gram grams gramm г",
    "kg": "kilogram kilograms кг", "N": "newton newtons н", "mbar": "millibar мбар", "hPa": "hektopascal", "in": "inch inches",
    "kgf/cm2": "kgf/cm² kgf/cm^2 kg/cm2 kg/cm² kg/cm^2", "d": "day days tag tage", "MPa": "megapascal мпа", "GPa": "gigapascal",
}  # fmt: skip
SPELLED = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
"""Another way in which a unit is written, in lower case -> the unit."""


def plain_unit(name: str) -> str:
    """The unit that a name is a spelling of, else the name.

    >>> plain_unit("Millimeter"), plain_unit("°"), plain_unit("mm"), to_si("5 µm", "m"), to_si("1 atm/s", "Pa/s")
    ('mm', 'deg', 'mm', 5e-06, 101325.0)
    """
    return SPELLED.get(name.casefold(), name)


LONGEST = 100
"""Characters of a quantity; matching takes a time that grows with the square of it."""
_QUANTITY = re.compile(rf"\s*({NUMBER})\s*(\S.*?)?\s*")


class UnitError(ValueError):
    """A quantity that cannot be turned into the unit asked for."""


def to_si(text: str, unit: str, known: Mapping[str, float] | None = None) -> float:
    """The number in `text` ("250 kPa", "3e5") in `unit`; a bare number is taken to be in `unit` already.

    `known`: the units that will do, and their size; all of this SI unit unless given. Raises UnitError naming them."""
    match = _QUANTITY.fullmatch(text) if len(text) <= LONGEST else None
    if match is None:
        raise UnitError(f"{text[:LONGEST]!r} is not a number with a unit; write for example {example(unit)}")
    value = float(match[1])
    if match[2] is None:
        return value
    name = plain_unit(match[2])
    factors = KINDS.get(unit, {unit: 1.0}) if known is None else known
    if name not in factors:
        alike = [other for other in factors if other.lower() == name.lower()]
        hint = f"did you mean {' or '.join(alike)}?" if alike else f"use one of {', '.join(factors)}"
        if unit == "Pa" and name in KINDS["N"]:
            hint = "of tendons, max_tension takes N; elsewhere write 10 kPa for 1 N"
        raise UnitError(f"{text!r} has the unit {name!r}, but a value in {unit} is needed; {hint}")
    factor = factors[name]
    return value / round(1 / factor) if round(1 / factor) * factor == 1 else value * factor  # 35 / 100, as 35 * 0.01 is not 0.35


def example(unit: str) -> str:
    """A quantity as one would write it."""
    return {"Pa": "'50 kPa'", "m": "'5 cm'", "Pa/s": "'20 kPa/s'"}.get(unit, f"'1 {unit}'")


USUAL = {"Pa": "kPa", "Pa/s": "kPa/s", "m": "cm", "m/s": "cm/s", "kg": "g"}
"""SI unit -> the unit in which people read such values at a rig."""


def usual(unit: str, value: float = 0.0) -> tuple[float, str]:
    """Return the size of the unit in which people read such a value of an SI unit, and its name; "" for a pure number."""
    name = "mm" if unit == "m" and 0 < abs(value) < 0.01 else USUAL.get(unit, unit)
    return KINDS.get(unit, {}).get(name, 1.0), "" if name == "1" else name


def shown(value: float, unit: str) -> str:
    """Return an SI value as people read it at a rig: `250 kPa`."""
    factor, name = usual(unit, value)
    return f"{value / factor:.4g}{unit_text(name)}"


def sized(value: float, unit: str) -> str:
    """Return an SI value in the largest of its unit, k, M and G that leaves 1 or more.

    >>> sized(1e3, "Pa"), sized(1e11, "Pa"), sized(0.5, "m"), sized(5.0, "")
    ('1 kPa', '100 GPa', '0.5 m', '5')
    """
    multiples = {f"{prefix}{unit}" for prefix in "kMG"} & set(KINDS.get(unit, ()))
    size, name = max([(1.0, unit), *((f, n) for n, f in KINDS.get(unit, {}).items() if n in multiples and f <= abs(value))])
    return f"{value / size:g}{unit_text(name)}"


def meant(value: float, unit: str, fits: Callable[[float], bool]) -> list[str]:
    """Return the number with each other unit in which it `fits`, such as `505 kPa` for 505 Pa."""
    metric = {f"{prefix}{unit}" for prefix in "cmkMG"} | {unit.removeprefix("k")}
    return [f"{value:g} {n}" for n, f in KINDS.get(unit, {}).items() if n in metric - {unit} and fits(value * f)]


SHORT = 15
"""Most characters of a quantity that a person would write in a file."""


def written(values: Sequence[float], unit: str) -> list[str]:
    """Return SI values as a person writes them in a file: in the usual unit, or in one in which they are short, where `to_si`
    reads the same to the last bit.

    >>> written([400e3], "Pa"), written([0.5, 0.7], "m"), written([0.0, 0.006], "m"), written([math.pi / 2], "rad")
    (['400 kPa'], ['50 cm', '70 cm'], ['0 mm', '6 mm'], ['90 deg'])
    >>> written([0.0, 68947.57293168], "Pa")
    ['0 psi', '10 psi']
    """
    sizes = KINDS.get(unit, {unit: 1.0})
    names = (usual(unit, max(map(abs, values), default=0.0))[1], "deg" if unit == "rad" else unit, *sizes)
    found = [[f"{value / sizes.get(name, 1.0):.15g} {name}" for value in values] for name in dict.fromkeys(names)]
    found = [texts for texts in found if [to_si(text, unit) for text in texts] == list(values)]
    found.append([f"{value!r} {unit}" for value in values])
    return next((texts for texts in found if max(map(len, texts), default=0) <= SHORT), found[0])
