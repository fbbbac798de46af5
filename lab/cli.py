"""The `lab` command: one verb, one thing. Exit code 0 ok, 1 failed, 2 wrong usage or configuration, 3 done but data was lost."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from .help import GROUPS, METAVARS, Verbs, epilog, unknown

OK, FAILED, USAGE, DATA_LOST = 0, 1, 2, 3

Handler = Callable[[argparse.Namespace], int]


def _check(a: argparse.Namespace) -> int:
    from .verbs.check import check

    return check(a.rig, a.seconds, a.json, a.move, a.yes)


def _plan(a: argparse.Namespace) -> int:
    from .verbs.run import keys, plan

    if a.keys:
        return keys(a.protocol, a.rig, a.json)
    if a.rig is None:
        raise _usage("--rig: give the rig.yaml of the rig, or --keys for what can be set of the protocol")
    return plan(a.protocol, a.rig, a.set, a.all, a.json, a.rehearse)


def _run(a: argparse.Namespace) -> int:
    from .verbs.run import run

    said = [(name, text) for name in ("operator", "specimen") if (text := getattr(a, name)) is not None]
    return run(a.protocol, a.rig, a.set, a.out, a.json, a.resume, a.watch, [*said, *map(_label, a.tag)])


def _campaign(a: argparse.Namespace) -> int:
    from .campaign import command

    said = [(name, text) for name in ("operator", "specimen") if (text := getattr(a, name)) is not None]
    said += map(_label, a.tag)
    if (a.file is None) == (a.resume is None):
        raise _usage("give a campaign's file, or the folder of one with --resume")
    if a.resume is not None:
        if a.plan or a.out is not None:
            raise _usage("--resume goes on with the campaign as it is in its folder: do not give --plan or --out")
        return command.resume(a.resume, a.rig, said, a.json, a.watch)
    return command.plan(a.file, a.rig, a.json) if a.plan else command.run(a.file, a.rig, a.out, said, a.json, a.watch)


def _investigate(a: argparse.Namespace) -> int:
    from diagnosis.investigate import Limits

    from .investigation.command import Wanted, run

    said = [(name, text) for name in ("operator", "specimen") if (text := getattr(a, name)) is not None]
    limits = Limits(a.budget, a.experiments)
    labels = (*said, *map(_label, a.tag))
    menu = not a.no_hands, tuple(a.without), tuple(a.set)
    wanted = Wanted(tuple(a.inputs), a.rig, a.out, limits, a.robot, a.effects, *menu, labels, a.workers, a.watch)
    return run(wanted, a.json)


def _power(a: argparse.Namespace) -> int:
    from .investigation.power import Asked, run

    asked = Asked(a.protocol, tuple(a.set), a.campaign, tuple(a.case), a.rig, a.robot)
    return run(asked, a.worlds, a.seed, not a.no_additions, a.effects, a.json)


def _watch(a: argparse.Namespace) -> int:
    from .verbs.watch import watch

    return watch(a.what, a.speed, a.bind, a.port, not a.no_browser, a.json, a.foxglove)


def _safe(a: argparse.Namespace) -> int:
    from .verbs.safe import safe, safe_all

    return safe_all(a.json) if a.all else safe(a.rig, a.json, a.clear)


def _fakes(a: argparse.Namespace) -> int:
    from .verbs.fakes import serve

    return serve(a)


def _info(a: argparse.Namespace) -> int:
    from .verbs.recorded import info

    return info(a.files, a.json)


def _runs(a: argparse.Namespace) -> int:
    from .verbs.shelf import runs

    return runs(a.folder, a.since, a.protocol, a.spine, a.json, a.where)


def _verify(a: argparse.Namespace) -> int:
    from .verbs.repair import verify

    return verify(a.file, a.json)


def _recover(a: argparse.Namespace) -> int:
    from .verbs.repair import recover

    return recover(a.file, a.out, a.json)


def _export(a: argparse.Namespace) -> int:
    from .verbs.export import Forms, export

    forms = Forms(a.case, a.crate, a.arviz, "mat" if a.mat else "parquet" if a.parquet else "csv", a.license, a.name)
    return export(a.inputs, a.out, forms, a.json)


def _import(a: argparse.Namespace) -> int:
    from .verbs.import_data import guess, import_files

    if a.guess:
        return guess(a.inputs, a.robot, a.out, a.json)
    if a.map is None:
        raise _usage("--map: give the map.yaml that says what the columns are, or --guess to have one proposed")
    return import_files(a.inputs, a.map, a.robot, a.out, a.json)


def _replay(a: argparse.Namespace) -> int:
    from .verbs.recorded import play, replay

    if not a.play:
        return replay(a.files, a.json)
    if len(a.files) > 1:
        raise _usage("--play: give one recording")
    return play(a.files[0], a.speed)


def _fit(a: argparse.Namespace) -> int:
    from .verbs.fit import WithEffects, fit, fit_with

    if a.with_effects is None and not a.residual:
        for option, given in (("--samples", a.samples), ("--effects", a.effects)):
            if given:
                raise _usage(f"{option}: needs --with EFFECT[,EFFECT..]")
        return fit(a.inputs, a.robot, a.out, a.json)
    asked = WithEffects(a.with_effects or (), a.effects, a.samples, a.seed, a.residual)
    return fit_with(a.inputs, a.robot, asked, a.out, a.json)


def _predict(a: argparse.Namespace) -> int:
    from model.robot import Robot

    from .files.config import load
    from .verbs.predict import Outputs, Wanted, invert, predict, protocol_states, table_states

    outputs, robot = Outputs(a.json, a.out, a.figure), load(a.robot, Robot)
    if a.inverse is not None:
        return invert(robot, a.inverse, Wanted(a.spine_length, a.groups, a.max_pressure), outputs, a.effects)
    by_table = a.table is not None
    states = table_states(a.table, robot.actuators.words) if by_table else protocol_states(a.protocol, a.set, robot)
    return predict(robot, states, outputs, a.effects)


def _compare(a: argparse.Namespace) -> int:
    from .verbs.compare import compare

    return compare(a.inputs, a.robot, a.out, a.json)


def _diagnose(a: argparse.Namespace) -> int:
    from .verbs.diagnose import Comparisons, Outputs, diagnose

    beside = Comparisons(a.reference, a.holdout, a.effects, a.baseline, a.simulator)
    return diagnose(a.inputs, a.robot, Outputs(a.json, a.report, a.protocols), beside, a.workers, a.scheduler)


def _paper(a: argparse.Namespace) -> int:
    from .verbs.paper import main

    return main(a.out, a.json)


def _blind(a: argparse.Namespace) -> int:
    from .blind.command import main

    return main(a)


def _effects(a: argparse.Namespace) -> int:
    from model.robot import Robot

    from .files.config import load
    from .verbs.effects import run

    return run(a.out, load(a.robot, Robot) if a.robot else None, a.effects, a.json)


def _demo(a: argparse.Namespace) -> int:
    from .verbs.demo import demo

    return demo(a.out, a.seed, a.speed, a.effect)


def _schema(a: argparse.Namespace) -> int:
    from .verbs.schema import schema

    return schema(a.file)


def _completion(a: argparse.Namespace) -> int:
    from .verbs.completion import completion

    return completion(a.shell, parser())


def _label(text: str) -> tuple[str, str]:
    """Name and text of a tag."""
    from recordings.campaign.labels import split
    from recordings.errors import BadMessage

    try:
        return split(text)
    except BadMessage as e:
        raise _usage(f"--tag {e}") from e


def _minutes(text: str) -> float:
    """A time with its unit, in minutes."""
    from .files.units import UnitError, to_si

    try:
        return to_si(text, "s") / 60
    except UnitError as e:
        raise argparse.ArgumentTypeError(str(e)) from e


def _names(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _groups(text: str) -> tuple[tuple[int, ...], ...]:
    """Chambers between commas, groups between blanks."""
    try:
        return tuple(tuple(int(c) for c in group.split(",")) for group in text.split())
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: write chambers between commas and groups between blanks") from None


def _usage(text: str) -> Exception:
    from .files.config import ConfigError

    return ConfigError(text)


class Version(argparse.Action):
    """Prints the version; found out only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from .console import out
        from .version import version_text

        out.print(version_text())
        parser.exit()


READERS = (
    "watch", "info", "runs", "verify", "recover", "replay", "export", "import", "fit", "compare", "diagnose", "investigate"
)  # fmt: skip
"""Verbs that read recordings, whose limits of size can be lifted."""


def parser() -> argparse.ArgumentParser:
    """All verbs and their options."""
    top = Verbs(prog="lab", description="Runs a soft-robotics lab: instruments, experiments, recordings, model.")
    top.add_argument("--version", action=Version, nargs=0, help="print the version, and the commit of a checkout")
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=argparse.ArgumentParser)

    def verb(name: str, handler: Handler, text: str, reads: bool = False) -> argparse.ArgumentParser:
        """`reads`: the result can be had as JSON."""
        plain = text.replace("%", "%%")  # argparse formats what it is given
        p = verbs.add_parser(
            name,
            help=plain,
            description=text,
            epilog=epilog(name),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        p.set_defaults(handler=handler)
        if reads:
            p.add_argument("--json", action="store_true", help="print the result as JSON")
        if name in READERS:
            p.add_argument(
                "--any-size",
                action="store_true",
                help="read files that claim to unpack to more than their size allows; only if you trust them",
            )
        return p

    def own_effects(p: argparse.ArgumentParser) -> None:
        p.add_argument(
            "--effects", type=Path, metavar="FILE.py", help="Python file with your own effects (a tuple named EFFECTS)"
        )

    def own_labels(p: argparse.ArgumentParser) -> None:
        p.add_argument("--operator", metavar="NAME", help="who runs it; recorded, as the two below")
        p.add_argument("--specimen", metavar="NAME", help="which piece is mounted")
        p.add_argument(
            "--tag", action="append", default=[], metavar="KEY=VALUE", help="a label of your own (repeatable)"
        )

    p = verb("demo", _demo, "record, fit and diagnose on fake instruments, ending in an HTML report")
    p.add_argument("--out", type=Path, default=Path("demo"), help="folder for recordings and report")
    p.add_argument("--seed", type=int, help="choose withheld effect and noise")
    p.add_argument("--speed", type=float, default=20.0, help="how much faster than real the rig runs (default 20)")
    p.add_argument("--effect", metavar="ID=SIZE", help="withhold this effect instead of a drawn one")

    p = verb("check", _check, "connect to each instrument: identity, rate, age, limits", reads=True)
    p.add_argument("--rig", type=Path, required=True, help="rig.yaml")
    p.add_argument("--move", action="store_true", help="move each actuator a little and compare with rig.yaml")
    p.add_argument(
        "--yes", action="store_true", help="with --move: do not ask for confirmation; nobody is within reach"
    )
    p.add_argument("--seconds", type=float, default=2.0, help="host seconds over which rates and losses are counted")

    for name, handler, text in (("plan", _plan, "steps, duration and limits of a protocol; nothing moves"),
                                ("run", _run, "run a protocol and record it")):  # fmt: skip
        p = verb(name, handler, text, reads=True)
        p.add_argument(
            "protocol",
            nargs="?" if name == "run" else None,
            help="stiffness, bending, elongation, cycles, one of a package, or a file (.yaml, .py)",
        )
        p.add_argument("--rig", type=Path, required=name == "run", help="rig.yaml")
        if name == "plan":
            p.add_argument("--keys", action="store_true", help="list what --set can change: unit, default, limits")
            p.add_argument("--all", action="store_true", help="list the steps of every repeat")
            p.add_argument(
                "--rehearse", action="store_true", help="execute its run as well, with instruments that move nothing"
            )
        p.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="change one parameter; `lab plan PROTOCOL --keys` lists them",
        )
        if name == "run":
            p.add_argument("--out", type=Path, help="folder for the recording (default: this one)")
            p.add_argument("--resume", type=Path, metavar="RUN", help="continue an interrupted run (.mcap)")
            p.add_argument("--watch", action="store_true", help="show the run on a page in the browser")
            own_labels(p)

    p = verb("campaign", _campaign, "runs of protocols in a designed order, planned and resumed as a whole", reads=True)
    p.add_argument("file", nargs="?", type=Path, help="campaign.yaml")
    p.add_argument("--rig", type=Path, required=True, help="rig.yaml")
    p.add_argument("--plan", action="store_true", help="what it will do, how long it takes, its limits; nothing moves")
    p.add_argument("--out", type=Path, help="folder for all its recordings (default: the campaign's name)")
    p.add_argument("--resume", type=Path, metavar="FOLDER", help="go on with the campaign of this folder")
    p.add_argument("--watch", action="store_true", help="show run after run on a page in the browser")
    own_labels(p)

    p = verb("watch", _watch, "a run on a page in the browser while it goes on, or a recording played", reads=True)
    p.add_argument("what", type=Path, metavar="FILE|RIG", help="a recording (.mcap), or the rig.yaml of the run")
    p.add_argument("--speed", type=float, help="of a recording: how much faster than rig time (default 1)")
    p.add_argument(
        "--bind",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="listen there, for other computers (default: this one only)",
    )
    p.add_argument("--port", type=int, default=0, help="listen at this port (default: any that is free)")
    p.add_argument("--no-browser", action="store_true", help="print the address only")
    p.add_argument(
        "--foxglove",
        nargs="?",
        type=int,
        const=8765,
        metavar="PORT",
        help="the same streams to Foxglove and Lichtblick, on this computer (default port 8765)",
    )

    p = verb("safe", _safe, "vent, stop and release the spine, confirmed by reading back", reads=True)
    which = p.add_mutually_exclusive_group(required=True)
    which.add_argument("--rig", type=Path, help="rig.yaml")
    which.add_argument(
        "--all", action="store_true", help="every rig of this computer that is in use or was not left safe"
    )
    p.add_argument("--clear", action="store_true", help="unlock the rig when everything is confirmed safe")

    p = verb("fakes", _fakes, "start the fake instruments and print the rig.yaml that reaches them")
    p.add_argument("--speed", type=float, default=1.0, help="how much faster than real time they run (default 1)")
    p.add_argument(
        "--effect", action="append", default=[], metavar="ID[=SIZE]", help="switch an effect on (repeatable)"
    )
    p.add_argument("--seed", type=int, default=0, help="seed of all noise")
    p.add_argument("--regulators", metavar="DRIVER", default="alicat", help="alicat, smc_itv, or a package's fake")
    p.add_argument("--full-scale", metavar="PRESSURE", help="range of the regulators, such as '900 kPa'")
    p.add_argument("--firmware", default="10v20.0-R24", help="firmware of an Alicat; before 6v00 it reports no unit")
    p.add_argument("--unit", default="kPa", help="unit that an Alicat reads and accepts, such as psi")
    p.add_argument("--swap", metavar="I,K", help="swap the hoses of two channels")
    p.add_argument("--spine", metavar="DRIVER", default="dynamixel", help="dynamixel, tmcl, or a package's fake")
    for role, usual, what in (("arm", "ur5", "the arm"), ("force", "ft300s", "the force sensor"),
                              ("valve", "numato", "the jamming valve"), ("gauge", "pfeiffer", "the vacuum gauge"),
                              ("mocap", "natnet", "the motion capture")):  # fmt: skip
        p.add_argument(f"--{role}", metavar="DRIVER", default=usual, help=f"{what}: {usual}, or a package's fake")
    p.add_argument(
        "--sensor", action="append", default=[], metavar="NAME=DRIVER", help="an additional sensor (repeatable)"
    )
    p.add_argument(
        "--channels", choices=("3", "9"), default="3", help="three groups of three chambers, or nine separate chambers"
    )
    p.add_argument("--robot", type=Path, help="robot.yaml of the robot to simulate (default: the paper's robot)")
    p.add_argument("--rig", type=Path, help="write rig.yaml and robot.yaml here instead of printing")
    p.add_argument("--list-effects", action="store_true", help="list what can be switched on")

    p = verb("info", _info, "what recordings hold: streams, rates, losses, provenance, outcome", reads=True)
    p.add_argument("files", nargs="+", type=Path, metavar="FILE")
    p = verb("runs", _runs, "list the recordings of a folder tree, with outcome and losses", reads=True)
    p.add_argument("folder", type=Path)
    p.add_argument("--since", default="", metavar="DATE", help="from this date or time on (UTC)")
    p.add_argument("--protocol", default="", help="only runs of this protocol")
    p.add_argument("--spine", type=float, metavar="M", help="only runs that set this spine length, m")
    p.add_argument(
        "--where",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="only runs with this label: operator, specimen, or a tag (repeatable)",
    )
    p = verb("verify", _verify, "compare every checksum, record and index of a recording", reads=True)
    p.add_argument("file", type=Path)
    p = verb("recover", _recover, "save all that can be read of a damaged or truncated recording", reads=True)
    p.add_argument("file", type=Path)
    p.add_argument(
        "--out", type=Path, metavar="FILE", help="the new file (default: <name>-recovered.mcap beside the old one)"
    )
    p = verb(
        "replay",
        _replay,
        "compute the trials again from the recording alone and compare with the live run",
        reads=True,
    )
    p.add_argument("files", nargs="+", type=Path, metavar="FILE")
    p.add_argument("--play", action="store_true", help="print all messages as JSON lines in order of time instead")
    p.add_argument(
        "--speed",
        type=float,
        default=math.inf,
        help="with --play: how much faster than rig time (default: without waiting)",
    )
    p = verb(
        "export",
        _export,
        "recordings and cases for other programs: CSV, Parquet, MATLAB, a case, an RO-Crate, ArviZ",
        reads=True,
    )
    p.add_argument(
        "inputs", type=Path, nargs="+", help="recordings (.mcap); with --mat, --crate and --arviz also a case folder"
    )
    p.add_argument("--out", type=Path, required=True, help="folder to write")
    form = p.add_mutually_exclusive_group()
    form.add_argument("--case", action="store_true", help="robot.yaml + trials.csv, as other tools take it")
    form.add_argument("--parquet", action="store_true", help="Parquet instead of CSV (needs pyarrow)")
    form.add_argument("--mat", action="store_true", help="one MATLAB file for each recording or case instead of CSV")
    form.add_argument("--crate", action="store_true", help="one described folder, as a paper's supplement")
    form.add_argument("--arviz", action="store_true", help="each case's diagnosis.json as NetCDF for ArviZ")
    p.add_argument("--license", metavar="URL", help="of the crate")
    p.add_argument("--name", help="of the crate (default: the folder's name)")

    p = verb(
        "import",
        _import,
        "measurements of other programs as a case, by a map of their columns",
        reads=True,
    )
    p.add_argument(
        "inputs", type=Path, nargs="+", help="files (CSV, MATLAB, NumPy, C3D, Parquet, MCAP) or a folder of them"
    )
    p.add_argument("--map", type=Path, help="map.yaml: columns, units, frame, what a state is")
    p.add_argument(
        "--guess", action="store_true", help="propose a map with its reasons and a picture, for you to check"
    )
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the one that the map names)")
    p.add_argument("--out", type=Path, required=True, help="case folder to write; with --guess: where the map goes")

    for name, handler, text in (("fit", _fit, "calibrate the model on recordings or a case folder"),
                                ("compare", _compare, "measured against model: error table and figure")):  # fmt: skip
        p = verb(name, handler, text, reads=True)
        p.add_argument("inputs", type=Path, nargs="+", help="recordings (.mcap) or a case folder")
        p.add_argument("--robot", type=Path, help="robot.yaml (default: the one in the input)")
        p.add_argument("--out", type=Path, help="folder for figures and the calibrated robot.yaml")
        if name == "fit":
            p.add_argument(
                "--with",
                dest="with_effects",
                type=_names,
                metavar="EFFECT[,EFFECT..]",
                help="fit these effects too, and write them into robot.yaml",
            )
            p.add_argument(
                "--residual",
                action="store_true",
                help="learn what the model still misses, for predictions",
            )
            p.add_argument(
                "--samples",
                type=int,
                default=0,
                metavar="N",
                help="with --with: write N robots drawn from the posterior",
            )
            p.add_argument("--seed", type=int, default=0, help="seed of --samples (default 0)")
            own_effects(p)

    p = verb(
        "predict", _predict, "where the tip will be, with 95 % intervals; or pressures for wanted tips", reads=True
    )
    p.add_argument("--robot", type=Path, required=True, help="robot.yaml, with its effects (lab fit --with)")
    given = p.add_mutually_exclusive_group(required=True)
    given.add_argument("--protocol", help="the states of a protocol: its name, or a protocol file (.yaml, .py)")
    given.add_argument(
        "--table",
        type=Path,
        metavar="STATES.csv",
        help="the states of a table: p1 .. in Pa ('p1 [kPa]', of tendons 'p1 [N]'), spine_length in m; or a trials.csv",
    )
    given.add_argument(
        "--inverse",
        type=Path,
        metavar="TARGETS.csv",
        help="pressures for wanted tips: x, y, z in m; an empty cell is free",
    )
    p.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="with --protocol: change one parameter"
    )
    p.add_argument("--spine-length", type=float, metavar="M", help="with --inverse: keep the spine at this length, m")
    p.add_argument(
        "--groups",
        type=_groups,
        metavar="'9,1,2 3,4,5'",
        help="with --inverse: chambers that share a regulator (others stay vented)",
    )
    p.add_argument("--max-pressure", type=float, metavar="PA", help="with --inverse: less than robot.yaml allows, Pa")
    p.add_argument("--out", type=Path, metavar="FILE.csv", help="write all rows here")
    p.add_argument("--figure", type=Path, metavar="FILE.svg", help="draw them here (.svg, .png or .pdf)")
    own_effects(p)

    p = verb(
        "diagnose", _diagnose, "the gap: where it lies, which effect causes it, how far it shrinks, what to do next"
    )
    p.add_argument("inputs", type=Path, nargs="+", help="recordings (.mcap) or a case folder")
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the one in the input)")
    p.add_argument("--json", type=Path, metavar="OUT", help="write diagnosis.json here")
    p.add_argument("--report", type=Path, metavar="OUT.html", help="write the page with all figures here")
    p.add_argument(
        "--protocols",
        type=Path,
        metavar="FOLDER",
        help="write the proposed experiments as protocol files; no earlier answer is kept, so later the whole diagnosis is "
        "repeated for them",
    )
    p.add_argument("--reference", type=Path, metavar="CASE", help="an earlier campaign: report what has changed since")
    p.add_argument(
        "--holdout",
        type=Path,
        metavar="CASE",
        help="a campaign (case folder or .mcap) to test the answer on",
    )
    p.add_argument(
        "--baseline",
        type=Path,
        metavar="PREDICTED.csv",
        help="predictions of another simulator: diagnose its gap",
    )
    p.add_argument("--simulator", metavar="NAME|FILE.py", help="the same, asking the simulator itself")
    p.add_argument("--workers", type=int, metavar="N", help="processor cores to use (default: all)")
    p.add_argument("--scheduler", help="a Dask scheduler instead, tcp://host:port (extra `cluster`)")
    own_effects(p)

    p = verb("power", _power, "before measuring: which causes a plan can tell apart, and what to add to it", reads=True)
    p.add_argument("--protocol", metavar="PROTOCOL", help="a protocol or its file")
    p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change one of its parameters")
    p.add_argument("--campaign", type=Path, metavar="FILE.yaml", help="a campaign instead")
    p.add_argument("--case", type=Path, nargs="+", default=[], metavar="CASE", help="states that were measured instead")
    p.add_argument("--rig", type=Path, help="rig.yaml")
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the rig's, or the case's)")
    p.add_argument("--worlds", type=int, default=30, metavar="N", help="robots drawn of each cause (default 30)")
    p.add_argument("--seed", type=int, default=1, help="of what is drawn")
    p.add_argument("--no-additions", action="store_true", help="do not try what further experiments would bring")
    own_effects(p)

    p = verb(
        "investigate",
        _investigate,
        "diagnose, run the experiment that tells most, diagnose again, until it is clear",
        True,
    )
    p.add_argument("inputs", type=Path, nargs="+", help="recordings (.mcap) or a case folder of the robot on the rig")
    p.add_argument("--rig", type=Path, required=True, help="rig.yaml")
    p.add_argument(
        "--budget", type=_minutes, default=60.0, metavar="60min", help="time for experiments (default 60min)"
    )
    p.add_argument("--experiments", type=int, default=3, metavar="N", help="at most this many (default 3)")
    p.add_argument("--without", action="append", default=[], metavar="ID", help="leave out an experiment (repeatable)")
    p.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a parameter of every experiment (repeatable)",
    )
    p.add_argument("--no-hands", action="store_true", help="nothing to mount, turn or hang on")
    p.add_argument("--out", type=Path, default=Path("investigation"), help="folder for recordings, answer and page")
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the one in the input)")
    p.add_argument("--workers", type=int, metavar="N", help="processor cores to use (default: all)")
    p.add_argument("--watch", action="store_true", help="show the experiments on a page in the browser")
    own_labels(p)
    own_effects(p)

    from .blind.options import add_arguments

    add_arguments(verb("blind", _blind, "sealed test cases: make them, diagnose them blind, score the answers"))

    p = verb("effects", _effects, "the catalogue of effects, with a figure of the signature of each", reads=True)
    p.add_argument("--out", type=Path, default=Path("out/effects"), help="folder for the picture")
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the paper's robot)")
    own_effects(p)

    p = verb(
        "schema",
        _schema,
        "JSON schema of rig.yaml, robot.yaml, map.yaml, campaign.yaml or a protocol file, for your editor",
    )
    p.add_argument("file", metavar="rig|robot|map|campaign|PROTOCOL")

    p = verb("completion", _completion, "print the shell's completion script for verbs, options and files")
    p.add_argument("shell", choices=("bash", "zsh"))

    p = verb("paper", _paper, "the paper's tables and model curves, reproduced", reads=True)
    p.add_argument("--out", type=Path, default=Path("out/paper"), help="folder for the figures")
    for p in verbs.choices.values():
        for action in p._actions:  # noqa: SLF001 - argparse offers no list of them
            if action.metavar is None:
                action.metavar = METAVARS.get(action.dest)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; errors become one clear message and an exit code."""
    # The matrices of fits and diagnoses are small: threads of the linear algebra would only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from .console import complain, plain_failures
    from .neighbours import strangers

    if wrong := strangers():
        complain(wrong)
        return USAGE
    words = list(sys.argv[1:] if arguments is None else arguments)
    top = parser()
    if not words or words == ["help"]:
        top.print_help()
        return OK if words else USAGE
    if words[0] == "help":
        words = [*words[1:], "--help"]
    if not words[0].startswith("-") and not any(words[0] in verbs for verbs in GROUPS.values()):
        complain(unknown(words[0]))
        return USAGE
    a = top.parse_args(words)
    plain_failures()
    if getattr(a, "any_size", False):
        from recordings.file.budget import lift

        lift()
    try:
        handler: Handler = a.handler
        return handler(a)
    except KeyboardInterrupt:
        complain("stopped")
        return FAILED
    except Exception as e:
        from .failures import explained  # knows the errors of every room, of which most verbs need few

        known = explained(e)
        if known is None:
            raise
        text, code = known
        complain(text)
        return code


if __name__ == "__main__":
    sys.exit(main())
