"""`lab init`: a commented robot.yaml of a robot that is described in a few words, and a rig.yaml of its instruments."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path
from string import ascii_uppercase

from model.actuators import PULL_AREA
from model.robot import Robot
from recordings.own_files import replaced

from ..console import out
from ..files.config import ConfigError, check, demand_writable, in_si, parse_yaml
from ..files.rig_file import RigFile, drivers
from ..files.units import to_si, written
from ..options import OneOf, Result, Verb, option, path_option
from ..rig.limits import NO_TENDONS

HARDWARE = Path(__file__).parents[1] / "files" / "hardware_rig.yaml"
"""examples/rig/rig.yaml, which explains every key of every driver of the project; an installed package holds it as a copy."""
GUESSED = "CHECK: guessed"
SHARES = {"inner_radius": 0.0, "path_radius": 0.6, "chamber_radius": 0.2}
"""Of the outer radius, itself a tenth of the length, where a dimension is not given."""
COMMENTS = 40
"""Their column in it."""
SCALED = ("max_pressure", "pressure_error", "full_scale")
"""Its pressures that follow what the robot bears."""
OF = {
    "max_total_pressure": "pressure", "pressure_error": "pressure", "pressure_error_time": "pressure", "vented_below": "pressure",
    "max_force": "force", "max_moment": "force", "max_age_in_motion": "arm force", "max_vacuum": "gauge", "keep_vacuum": "valve",
    "max_hidden": "mocap", "order": "arm pressure spine valve",
}  # fmt: skip
"""Key of limits and safe -> the instruments without which it says nothing."""
USUAL = {"pressure": "alicat", "mocap": "natnet"}
"""What a first rig needs, and the drivers to start from."""
NEEDS = {
    "max_pressure": ("chambers", "is of chambers; a robot with tendons has --max-tension"),
    "chamber_radius": ("chambers", "is of chambers; leave it out for a robot with tendons"),
    "max_tension": ("tendons", "is of tendons; a robot with chambers has --max-pressure"),
    "instruments": ("rig", "needs --rig RIG.yaml"),
}
"""Option -> another without which it says nothing, and what is answered."""


def robot_text(a: argparse.Namespace) -> str:
    """The robot.yaml that the options describe; raises ConfigError."""
    count, tendons = a.chambers or a.tendons, a.chambers is None
    length, modulus = in_si("--length", a.length, "m"), in_si("--modulus", a.modulus or "500 kPa", "Pa")
    outer = in_si("--outer-radius", a.outer_radius, "m") if a.outer_radius else 0.1 * length

    def line(key: str, value: str, comment: str, given: object = True) -> str:
        return f"{key + ': ' + value:<32} # {comment}{'' if given else f'; {GUESSED}'}"

    def dimension(key: str, comment: str) -> str:
        given = getattr(a, key)
        return line(key.removeprefix("chamber_"), given or f"{1e3 * SHARES.get(key, 1.0) * outer:.4g} mm", comment, given)

    most = "max_tension: 10 N" if tendons else "max_pressure: 80 kPa"
    limit = a.max_tension if tendons else a.max_pressure
    actuators = [] if tendons else [f"  {dimension('chamber_radius', 'of the round channel')}"]
    directions = ", ".join(f"{360 * k / count:g}" for k in range(count))
    return "\n".join([
        "# Written by lab init. Numbers may carry units. Correct what is marked CHECK; docs/reference/robot.md has every key.",
        line("name", a.name, "stands in tables and recordings"),
        line("length", a.length, "of the part that bends"),
        dimension("outer_radius", "of the body"),
        dimension("inner_radius", "of the channel along its axis; 0 for none"),
        line("density", a.density or "1070", "kg/m^3", a.density),
        line("youngs_modulus", written([modulus], "Pa")[0], "data sheet; `lab fit` corrects it", a.modulus),
        line("shear_modulus", written([float(f"{modulus / 3:.4g}")], "Pa")[0], "E / 3 for rubber, E / 2.6 for metal"),
        line("tip_mass", "0 kg", "what hangs at its end"),
        line("gravity", "[0, 0, 9.81]", "m/s^2, z from base to tip: this one hangs; [0, 0, -9.81] stands", False),
        line(most.partition(":")[0], limit, "what it bears") if limit else
        line(f"# {most.partition(':')[0]}", most.partition(": ")[2], "what it bears; nothing is driven without it"),
        "tendons:" if tendons else "chambers:",
        *actuators,
        "  " + dimension("path_radius", "from the axis to the actuator"),
        "  " + line("azimuths_deg", f"[{directions}]", "where each is about the axis, the first on x", False),
        line("area_factor", "1.0", "effective over geometric effect; `lab fit` corrects it"), "",
    ])  # fmt: skip


def rig_text(instruments: Mapping[str, str], robot: str, count: int, most: float | None) -> str:
    """A rig.yaml for hardware, cut from the example that explains every key; raises ConfigError.

    `count`, `most`: of the robot's chambers, and the pressure (Pa) that they bear, to which the example's are scaled."""
    example = HARDWARE.read_text(encoding="utf-8")
    head, _, rest = example.partition("\ninstruments:\n")
    tables, _, rest = rest.partition("\nstand:")
    stand, _, limits = rest.partition("\nlimits:")
    blocks = {}
    for role, block in re.findall(r"^  (\w+):\n((?:    .*\n)+)", re.sub(r"(?m)^  #\| ", "  ", tables), re.M):
        blocks[role, re.findall(r"driver: (\w+)", block)[0]] = block
    lines = [head, "\ninstruments:\n"]
    for role, driver in instruments.items():
        if driver not in drivers() or drivers()[driver].role != role:
            own = ", ".join(name for name, one in drivers().items() if one.role == role)
            raise ConfigError(f"--instruments {role}={driver}: there is no such driver" + (f"; there are {own}" if own else ""))
        block = blocks.get((role, driver)) or _own_table(driver, "".join(text for of, text in blocks.items() if of[0] == role))
        ports = "".join(f"      - /dev/ttyUSB{i}    # yours\n" for i in range(count))
        lines += [f"  {role}:\n", re.sub(r"(?:      - /dev.*\n)+", ports, block), "\n"]
    absent = "|".join(key for key, roles in OF.items() if not set(roles.split()) <= instruments.keys())
    limits = re.sub(rf"(?m)^  (?:{absent}):.*\n", "", limits) if absent else limits
    text = "".join([*lines, *(["stand:", stand, "\n"] if "arm" in instruments else []), "limits:", limits])

    highest, error, full_scale = (to_si(re.findall(rf" {key}: (.*?) +#", example)[0], "Pa") for key in SCALED)
    top = min(most or highest, 1e6)  # this and the other bounds are rig.yaml's own
    if "pressure" in instruments and ("pressure", instruments["pressure"]) not in blocks:
        range_of = drivers()[instruments["pressure"]].config.model_fields["full_scale"]
        top = top if range_of.is_required() else min(top, range_of.default)
    least, total = max(float(f"{error * top / highest:.3g}"), 5e3), min(count * top, 3e6)
    pressures = {"max_pressure": top, "max_total_pressure": total, "pressure_error": least}
    if top > full_scale:
        pressures["full_scale"] = top
    values = {"robot": robot, "chambers": [[i] for i in range(1, count + 1)], "units": f"[{', '.join(ascii_uppercase[:count])}]",
              **{key: written([value], "Pa")[0] for key, value in pressures.items()}}  # fmt: skip
    line = rf"(?m)^( *({'|'.join(values)}): )[^#\n]*(#?)"
    return re.sub(line, lambda m: (f"{m[1]}{values[m[2]]} ".ljust(COMMENTS) + m[3]).rstrip(), text)


def _own_table(driver: str, examples: str) -> str:
    """The lines that the table of a lab's own driver needs: as in `examples` of its role, and empty where these lack a key."""
    lines = re.findall(r"(?m)^    (\w+)(:.*\n(?:      .*\n)*)", examples)
    known = {key: f"    {key}{text}" for key, text in reversed(lines)}
    needed = (key for key, field in drivers()[driver].config.model_fields.items() if field.is_required() or key == "max_pressure")
    unknown = (f"    driver: {driver}", *(known.get(key, f"    {key}:") for key in needed))
    return "".join(line if "\n" in line else f"{line.ljust(COMMENTS)}# yours\n" for line in unknown)


def init(a: argparse.Namespace) -> Result:
    """Write robot.yaml, and with --rig a rig.yaml; neither is replaced."""
    for path in (a.out, a.rig):
        if path is not None and path.suffix not in (".yaml", ".yml"):
            raise ConfigError(f"{path}: must end in .yaml: write {path}.yaml")
        if path is not None and path.exists():
            raise ConfigError(f"{path}: is there already; give another name, or delete it")
    if a.rig is not None and a.tendons:
        raise ConfigError(f"--rig {a.rig}: {NO_TENDONS}")
    for key, (needed, answer) in NEEDS.items():
        if (given := getattr(a, key)) is not None and getattr(a, needed) is None:
            raise ConfigError(f"--{key.replace('_', '-')} {given}: {answer}")
    demand_writable(a.out, a.rig)
    for name, count in (("--chambers", a.chambers), ("--tendons", a.tendons)):
        if count is not None and not 1 <= count <= 26:
            raise ConfigError(f"{name} {count}: must be 1 to 26")
    text = robot_text(a)
    robot = check(parse_yaml(text, str(a.out)), Robot)
    rig = ""
    if a.rig is not None:
        pairs = (one.strip().partition("=") for one in (a.instruments or "pressure,mocap").split(","))
        named = {role: driver or USUAL.get(role, "") for role, _, driver in pairs}
        place = a.out.name if a.out.parent == a.rig.parent else str(a.out.resolve())
        rig = rig_text(named, place, a.chambers, robot.highest_limit)
        if not re.search(r"(?m)^    \w+: +# yours$", rig):  # else a key of an own driver is still empty
            check(parse_yaml(rig, str(a.rig)), RigFile)
    for path, content in ((a.out, text), (a.rig, rig)):
        if path is not None:
            replaced(path, content)
            out.print(f"written: {path}; correct the {content.count('CHECK:') or content.count('# yours')} lines marked "
                      f"{'CHECK' if content is text else 'yours'}")  # fmt: skip
    return Result()


VERBS = (
    Verb(
        "init",
        init,
        options=(
            OneOf(option("--chambers", type=int, metavar="N", help="chambers about the axis, evenly spaced"),
                  option("--tendons", type=int, metavar="N", help="tendons instead"), required=True),
            option("--length", required=True, metavar="LENGTH", help="of the part that bends, such as '180 mm'"),
            option("--name", default="my robot", help="its name"),
            option("--outer-radius", "LENGTH", "a tenth of the length unless given"),
            *(option(f"--{key.replace('_', '-')}", metavar="LENGTH",
                     help=f"{f'{share:g} times the outer radius' if share else '0'} unless given")
              for key, share in SHARES.items()),
            option("--modulus", "PRESSURE", "Young's modulus, such as '500 kPa'"),
            option("--density", "DENSITY", "such as '1070 kg/m^3'"),
            option("--max-pressure", "PRESSURE", "what its chambers bear"),
            option("--max-tension", "FORCE", f"what its tendons bear, such as '5 N' (1 N is {1 / PULL_AREA:g} Pa)"),
            path_option("--out", "ROBOT.yaml", "where to write it", default=Path("robot.yaml")),
            path_option("--rig", "RIG.yaml", "also write a rig.yaml for hardware"),
            option("--instruments", "KEY[=DRIVER],..", "of that rig, such as pressure=smc_itv,mocap=natnet"),
        ),
        examples=(
            "lab init --chambers 3 --length '180 mm' --outer-radius '15 mm' --max-pressure '80 kPa'",
            "lab init --tendons 4 --length '300 mm' --max-tension '5 N'",
        ),
        page="docs/tutorials/your-rig.md",
    ),
)  # fmt: skip
