"""The `lab` command: one verb, one thing. Exit code 0 ok, 1 failed, 2 wrong usage or configuration, 3 done but data was lost."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

OK, FAILED, USAGE, DATA_LOST = 0, 1, 2, 3

Handler = Callable[[argparse.Namespace], int]


def _check(a: argparse.Namespace) -> int:
    from .verbs.check import check

    return check(a.rig, a.seconds, a.json, a.move, a.yes)


def _plan(a: argparse.Namespace) -> int:
    from .verbs.run import plan

    return plan(a.protocol, a.rig, a.set, a.json)


def _run(a: argparse.Namespace) -> int:
    from .verbs.run import run

    return run(a.protocol, a.rig, a.set, a.out, a.json, a.resume)


def _safe(a: argparse.Namespace) -> int:
    from .verbs.safe import safe

    return safe(a.rig, a.json, a.clear)


def _fakes(a: argparse.Namespace) -> int:
    from .verbs.fakes import serve

    return serve(a)


def _info(a: argparse.Namespace) -> int:
    from .verbs.recorded import info

    return info(a.file, a.json)


def _runs(a: argparse.Namespace) -> int:
    from .verbs.shelf import runs

    return runs(a.folder, a.since, a.protocol, a.spine, a.json)


def _verify(a: argparse.Namespace) -> int:
    from .verbs.repair import verify

    return verify(a.file, a.json)


def _recover(a: argparse.Namespace) -> int:
    from .verbs.repair import recover

    return recover(a.file, a.out, a.json)


def _export(a: argparse.Namespace) -> int:
    from .verbs.recorded import export

    return export(a.file, a.out, a.case, a.parquet, a.json)


def _replay(a: argparse.Namespace) -> int:
    from .verbs.recorded import play, replay

    return play(a.file, a.speed) if a.play else replay(a.file, a.json)


def _fit(a: argparse.Namespace) -> int:
    from .verbs.fit import fit

    return fit(a.inputs, a.robot, a.out, a.json)


def _compare(a: argparse.Namespace) -> int:
    from .verbs.compare import compare

    return compare(a.inputs, a.robot, a.out, a.json)


def _diagnose(a: argparse.Namespace) -> int:
    from .verbs.diagnose import Comparisons, Outputs, diagnose

    beside = Comparisons(a.reference, a.holdout, a.effects)
    return diagnose(a.inputs, a.robot, Outputs(a.json, a.report, a.protocols), beside, a.workers, a.scheduler)


def _paper(a: argparse.Namespace) -> int:
    from .verbs.paper import main

    return main(a.out, a.json)


def _blind(a: argparse.Namespace) -> int:
    from .blind.command import main

    return main(a)


def _effects(a: argparse.Namespace) -> int:
    from model.robot import load_robot

    from .verbs.effects import run

    return run(a.out, load_robot(a.robot) if a.robot else None, a.effects, a.json)


def _demo(a: argparse.Namespace) -> int:
    from .verbs.demo import demo

    return demo(a.out, a.seed, a.speed)


def _schema(a: argparse.Namespace) -> int:
    from .verbs.schema import schema

    return schema(a.file)


def _completion(a: argparse.Namespace) -> int:
    from .verbs.completion import completion

    return completion(a.shell, parser())


class Version(argparse.Action):
    """Prints the version; found out only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from .console import out
        from .version import version_text

        out.print(version_text())
        parser.exit()


def parser() -> argparse.ArgumentParser:
    """All verbs and their options."""
    top = argparse.ArgumentParser(
        prog="lab", description="Runs a soft-robotics lab: instruments, experiments, recordings, model."
    )
    top.add_argument("--version", action=Version, nargs=0, help="print the version, of a checkout with its commit")
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")

    def verb(name: str, handler: Handler, text: str, reads: bool = False) -> argparse.ArgumentParser:
        p = verbs.add_parser(name, help=text, description=text)
        p.set_defaults(handler=handler)
        if reads:
            p.add_argument("--json", action="store_true", help="print the result as JSON")
        return p

    def own_effects(p: argparse.ArgumentParser) -> None:
        p.add_argument("--effects", type=Path, metavar="FILE.py", help="effects of your own (a tuple named EFFECTS)")

    p = verb("demo", _demo, "record, fit and diagnose on fake instruments, ending in an HTML report")
    p.add_argument("--out", type=Path, default=Path("demo"), help="folder for recordings and report")
    p.add_argument("--seed", type=int, help="repeat a demo: the seed chooses the withheld effect and the noise")
    p.add_argument("--speed", type=float, default=20.0, help="how much faster than real the rig runs (default 20)")

    p = verb("check", _check, "connect to each instrument: identity, rate, age, limits", reads=True)
    p.add_argument("--rig", type=Path, required=True, help="rig.yaml")
    p.add_argument("--move", action="store_true", help="move each actuator a little and compare with rig.yaml")
    p.add_argument("--yes", action="store_true", help="with --move: do not ask; nobody is within reach")
    p.add_argument(
        "--seconds", type=float, default=2.0, help="host seconds over which stream rates and losses are counted"
    )

    for name, handler, text in (("plan", _plan, "steps, duration and limits of a protocol; nothing moves"),
                                ("run", _run, "run a protocol and record it")):  # fmt: skip
        p = verb(name, handler, text, reads=True)
        p.add_argument(
            "protocol",
            nargs="?" if name == "run" else None,
            help="stiffness, bending, elongation, one of an installed package, or a protocol file (.yaml, .py)",
        )
        p.add_argument("--rig", type=Path, required=True, help="rig.yaml")
        p.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change one parameter")
        if name == "run":
            p.add_argument("--out", type=Path, help="folder for the recording (default: this one)")
            p.add_argument("--resume", type=Path, metavar="RUN", help="continue an interrupted run (.mcap)")

    p = verb("safe", _safe, "vent, stop and release the spine, confirmed by reading back", reads=True)
    p.add_argument("--rig", type=Path, required=True, help="rig.yaml")
    p.add_argument("--clear", action="store_true", help="unlock the rig when everything is confirmed safe")

    p = verb("fakes", _fakes, "start the fake instruments and print the rig.yaml that reaches them")
    p.add_argument("--speed", type=float, default=1.0, help="how much faster than real time they run (default 1)")
    p.add_argument(
        "--effect", action="append", default=[], metavar="ID[=SIZE]", help="switch an effect on (repeatable)"
    )
    p.add_argument("--seed", type=int, default=0, help="seed of all noise")
    p.add_argument("--regulators", metavar="DRIVER", default="alicat", help="alicat, smc_itv, or an installed one")
    p.add_argument("--full-scale", metavar="PRESSURE", help="range of the regulators, such as '900 kPa'")
    p.add_argument("--firmware", default="10v20.0-R24", help="of an Alicat; before 6v00 it does not report its unit")
    p.add_argument("--unit", default="kPa", help="unit that an Alicat reads and accepts, such as psi")
    p.add_argument(
        "--swap", metavar="I,K", help="two channels whose hoses are exchanged, for `lab check --move` to find"
    )
    p.add_argument("--spine", metavar="DRIVER", default="dynamixel", help="dynamixel, tmcl, or an installed one")
    for role, usual, what in (("arm", "ur5", "the arm"), ("force", "ft300s", "the force sensor"),
                              ("valve", "numato", "the jamming valve"), ("gauge", "pfeiffer", "the vacuum gauge"),
                              ("mocap", "natnet", "the motion capture")):  # fmt: skip
        p.add_argument(f"--{role}", metavar="DRIVER", default=usual, help=f"{what}: {usual}, or an installed one")
    p.add_argument(
        "--sensor", action="append", default=[], metavar="NAME=DRIVER", help="a sensor of the lab's own (repeatable)"
    )
    p.add_argument("--channels", choices=("3", "9"), default="3", help="three sets of three chambers, or nine separate")
    p.add_argument("--robot", type=Path, help="robot.yaml of the robot to play; the paper's unless given")
    p.add_argument("--rig", type=Path, help="write rig.yaml and robot.yaml here instead of printing")
    p.add_argument("--list-effects", action="store_true", help="list what can be switched on")

    p = verb("info", _info, "what a recording holds: streams, rates, losses, provenance, outcome", reads=True)
    p.add_argument("file", type=Path)
    p = verb("runs", _runs, "list the recordings of a folder tree, with outcome and losses", reads=True)
    p.add_argument("folder", type=Path)
    p.add_argument("--since", default="", metavar="DATE", help="from this date or time on (UTC)")
    p.add_argument("--protocol", default="", help="only runs of this protocol")
    p.add_argument("--spine", type=float, metavar="M", help="only runs that set this spine length, m")
    p = verb("verify", _verify, "compare every checksum, record and index of a recording", reads=True)
    p.add_argument("file", type=Path)
    p = verb("recover", _recover, "keep all that can be read of a damaged or torn recording", reads=True)
    p.add_argument("file", type=Path)
    p.add_argument("--out", type=Path, help="the new file (default: <name>-recovered.mcap beside the old one)")
    p = verb(
        "replay",
        _replay,
        "conclude the trials again from the recording alone and compare with the live run",
        reads=True,
    )
    p.add_argument("file", type=Path)
    p.add_argument("--play", action="store_true", help="print all messages as JSON lines in the order of time instead")
    p.add_argument("--speed", type=float, default=math.inf, help="with --play: times rig time (default: at once)")
    p = verb("export", _export, "recording to CSV or Parquet files or to a case folder", reads=True)
    p.add_argument("file", type=Path, nargs="+")
    p.add_argument("--out", type=Path, required=True)
    p.add_argument("--case", action="store_true", help="robot.yaml + trials.csv, as other tools take it")
    p.add_argument("--parquet", action="store_true", help="Parquet instead of CSV (needs pyarrow)")

    for name, handler, text in (("fit", _fit, "calibrate the model on recordings or a case folder"),
                                ("compare", _compare, "measured against model: error table and figure")):  # fmt: skip
        p = verb(name, handler, text, reads=True)
        p.add_argument("inputs", type=Path, nargs="+", help="recordings (.mcap) or a case folder")
        p.add_argument("--robot", type=Path, help="robot.yaml (default: the one in the input)")
        p.add_argument("--out", type=Path, help="folder for figures and the calibrated robot.yaml")

    p = verb(
        "diagnose", _diagnose, "the gap: where it lies, which effect causes it, how far it shrinks, what to do next"
    )
    p.add_argument("inputs", type=Path, nargs="+", help="recordings (.mcap) or a case folder")
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the one in the input)")
    p.add_argument("--json", type=Path, metavar="OUT", help="write diagnosis.json here")
    p.add_argument("--report", type=Path, metavar="OUT.html", help="write the page with all figures here")
    p.add_argument("--protocols", type=Path, metavar="FOLDER", help="write the proposed experiments as protocol files")
    p.add_argument("--reference", type=Path, metavar="A", help="an earlier campaign: say what changed since")
    p.add_argument(
        "--holdout",
        type=Path,
        metavar="B",
        help="a campaign the fit never sees (case folder or .mcap): try the answer on it",
    )
    p.add_argument("--workers", type=int, metavar="N", help="processor cores to use (default: all)")
    p.add_argument("--scheduler", help="a Dask scheduler instead, tcp://host:port (extra `cluster`)")
    own_effects(p)

    from .blind.options import add_arguments

    add_arguments(verb("blind", _blind, "sealed cases: make them, diagnose them without the seal, score"))

    p = verb("effects", _effects, "the catalogue of effects and the signature of each, drawn", reads=True)
    p.add_argument("--out", type=Path, default=Path("out/effects"), help="folder for the picture")
    p.add_argument("--robot", type=Path, help="robot.yaml (default: the paper's robot)")
    own_effects(p)

    p = verb("schema", _schema, "the JSON schema of a file that people write, for their editor")
    p.add_argument("file", metavar="rig|robot|PROTOCOL")

    p = verb("completion", _completion, "what a shell needs to complete verbs, options and files")
    p.add_argument("shell", choices=("bash", "zsh"))

    p = verb("paper", _paper, "the paper's tables and model curves, reproduced", reads=True)
    p.add_argument("--out", type=Path, default=Path("out/paper"), help="folder for the figures")
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
    a = parser().parse_args(arguments)
    from .failures import explained

    plain_failures()
    try:
        handler: Handler = a.handler
        return handler(a)
    except KeyboardInterrupt:
        complain("stopped")
        return FAILED
    except Exception as e:
        known = explained(e)
        if known is None:
            raise
        text, code = known
        complain(text)
        return code


if __name__ == "__main__":
    sys.exit(main())
