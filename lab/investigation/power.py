"""`lab power`: which causes a planned experiment can distinguish, which pairs it cannot, and what to add."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from rich.table import Column

from diagnosis.data.case import Case, states
from diagnosis.power import OTHER_LAWS, Addition, Planned, Power, additions, foreseen, power
from model.effects.shows import possible
from model.robot import Robot
from protocols.planned import planned_rows
from recordings.trials import counted

from ..campaign.design import campaign_of, planned_table
from ..console import Screen, note, out, titled
from ..files.config import ConfigError, load
from ..files.inputs import read_case
from ..files.own_effects import catalogue
from ..files.rig_file import load_rig
from ..options import OWN_EFFECTS, READS, Result, Verb, option, path_option, repeatable, rig
from ..verbs.run import planned_columns, protocol_plan, robot_facts, source_of

READ = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""What motion capture tells of the tip."""
CLUTTERS = {"clean": (0.0,), "cluttered": (0.05, 0.1, 0.2)}


def run(a: argparse.Namespace) -> Result:
    """Return how often each cause would be named in robots drawn with it, and what experiments would add. Raises ConfigError."""
    if not 2 <= a.worlds <= 10_000:
        raise ConfigError(f"--worlds {a.worlds}: must be 2 to 10000 of each cause")
    more = not a.no_additions
    robot, case_of = _planned(a)
    weighed, left_out = catalogue(robot, a.effects)
    weighed = {id: spec for id, spec in weighed.items() if possible(robot, spec)}
    note(f"not considered: {why}" for why in left_out)
    with Screen("drawing worlds") as screen:
        case = case_of(a.seed)
        parts = 3 if more else 2
        design = Planned(case, weighed)
        powers: dict[str, Power] = {}
        for k, (name, clutter) in enumerate(CLUTTERS.items()):
            screen.say(f"{name}: {a.worlds} worlds of each of {len(weighed)} causes, part {k + 1} of {parts}")
            powers[name] = power(design, tuple(weighed), a.worlds, a.seed, clutter)
            screen.progress((k + 1) / parts, 1.0)
        added: tuple[Addition, ...] = ()
        if more and not states(case)[0].pushed.all():
            screen.say(f"further experiments, part {parts} of {parts}")
            added = additions(case, weighed, seed=a.seed, progress=lambda s: screen.progress((2 + s) / parts, 1.0))
    robot, table, words = case.robot, case.table, case.robot.actuators.words
    highest = float(np.nanmax(table.pressures, initial=0.0))
    open_end = "" if robot.max_pressure is not None else f", and robot.yaml states no max_{words.pressure}"
    in_all, trials = counted(len(table), "state"), counted(len(np.unique(table.trial)), "trial")
    plan = f"plan: {in_all} in {trials}, {words.kind} up to {words.number(highest)} {words.unit}{open_end}"
    answer = {
        "schema": "power/1",
        "noise_floor_mm": max(part.floor for part in design.where) * 1e3,
        **{name: {**p.to_dict(), "right_other_laws": p.right * OTHER_LAWS[name]} for name, p in powers.items()},
        "additions": [
            {key: getattr(a.experiment, key) for key in ("id", "do", "cost_min")} | {"right": a.right, "gained": a.gained}
            for a in added
        ],
    }
    return Result(answer, partial(_show, plan, powers, added))


def _planned(a: argparse.Namespace) -> tuple[Robot, Callable[[int], Case]]:
    """Return the robot, and a function seed -> case: the measured one, or one that the plan could give."""
    chosen = [n for n, v in (("protocol", a.protocol), ("campaign", a.campaign), ("case", a.case or None)) if v is not None]
    if len(chosen) != 1:
        raise ConfigError("give one of --protocol, --campaign and --case")
    if a.case:
        case = read_case(a.case, a.robot)
        return case.robot, lambda seed: Case(case.robot, case.table)
    if a.campaign is not None:
        if a.rig is None:
            raise ConfigError("--campaign: give the rig too, --rig RIG")
        c = campaign_of(a.campaign, a.rig, 1)
        return c.robot, partial(foreseen, c.robot, planned_table(c, READ))
    assert a.protocol is not None
    rig = None if a.rig is None else load_rig(a.rig)
    if a.robot is not None:
        robot = load(a.robot, Robot)
    elif rig is not None:
        robot = rig.body
    else:
        raise ConfigError("--protocol: give the rig, --rig RIG, or the robot alone, --robot ROBOT")
    facts = robot_facts(robot, rig)
    _, parameters, plan = protocol_plan(source_of(a.protocol, a.set), facts)
    return robot, partial(foreseen, robot, planned_columns(planned_rows(plan, parameters, facts.chambers), robot, READ))


def _show(plan: str, powers: dict[str, Power], brings: tuple[Addition, ...]) -> None:
    """Print for each cause how often it is named by its size, what it is mistaken for, and experiments worth adding."""
    out.print(plan, soft_wrap=True)
    clean, cluttered = powers["clean"], powers["cluttered"]
    title = "How often the cause would be named, by its size (thirds of 0.5 to 1.5 plausible scales)"
    numbers = ("tip moved / noise floor", "small", "medium", "large", "among others")
    sheet = titled(title, (Column("cause", no_wrap=True),), numbers=numbers)
    mistaken: list[str] = []
    among_others = {e.effect: e for e in cluttered.effects}
    for e in clean.effects:
        in_clutter = among_others[e.effect]
        shares = [share for share in in_clutter.right.values() if share is not None]
        if in_clutter.taken_for:
            mistaken_for = ", ".join(f"{name} ({share:.2f})" for name, share in in_clutter.taken_for[:2])
            mistaken.append(f"  {e.effect}: {mistaken_for}")
        sizes = ["" if share is None else f"{share:.2f}" for share in e.right.values()]
        sheet.add_row(e.effect, f"{e.carries:.1f}", *sizes, f"{np.mean(shares):.2f}")
    out.print(sheet)
    if mistaken:
        out.print("mistaken for, with other effects present (share of its worlds):")
    for line in mistaken:
        out.print(line, soft_wrap=True)
    for name, p in powers.items():
        low, high = p.right95
        out.print(
            f"{name}: {p.right:.2f} of {p.worlds} worlds named right (95 %: {low:.2f} to {high:.2f}); for robots "
            f"whose laws differ from the catalogue's, about {p.right * OTHER_LAWS[name]:.2f}",
            soft_wrap=True,
        )
    if pairs := cluttered.pairs[:8]:
        out.print("not distinguished: " + "; ".join(f"{a} from {b} ({share:.2f})" for a, b, share in pairs), soft_wrap=True)
    if clean.unseen:
        out.print(f"not weighed, as these states cannot show them or rule them out: {', '.join(clean.unseen)}", soft_wrap=True)
    for a in brings[:3]:
        gain = f"{a.gained:+.2f} of worlds named right, for {a.experiment.cost_min:g} min"
        out.print(f"to add: {a.experiment.do}: {gain}", soft_wrap=True)
    out.print("linearised about robot.yaml; no pairs of causes and none outside the catalogue are drawn")


VERBS = (
    Verb(
        "power",
        run,
        options=(
            *READS,
            option("--protocol", "PROTOCOL", "a protocol or its file"),
            repeatable("--set", "KEY=VALUE", "change one of its parameters"),
            path_option("--campaign", "FILE.yaml", "a campaign instead"),
            option("--case", type=Path, nargs="+", default=[], metavar="CASE", help="a measured case instead"),
            rig(required=False),
            path_option("--robot", "ROBOT.yaml", "robot.yaml (default: the rig's, or the case's)"),
            option("--worlds", type=int, default=30, metavar="N", help="robots drawn of each cause (default 30)"),
            option("--seed", type=int, default=1, help="seed of the drawn robots"),
            option("--no-additions", action="store_true", help="do not look for experiments to add"),
            OWN_EFFECTS,
        ),
        examples=(
            "lab power --protocol bending --rig rig/rig.yaml",
            "lab power --protocol bending --robot robot.yaml --worlds 10 --no-additions",
        ),
        page="docs/howto/investigate.md",
    ),
)
