"""`lab demo`: the whole lab without hardware. An effect is drawn and sealed first and revealed last."""

from __future__ import annotations

import argparse
import hashlib
import json
import secrets
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from diagnosis.answer.headline import for_people
from diagnosis.answer.result import Diagnosis
from drivers.registry import OWN
from model.warm_up import PARTS
from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import draw_effect, list_effects

from ..console import out, styled
from ..files.config import ConfigError
from ..files.rig_file import found_drivers
from ..options import Result, Verb, option, path_option
from ..priority import BEHIND
from ..processes import processes
from .check import check
from .compare import compare
from .diagnose import VERBS as DIAGNOSE
from .fakes import PATIENT, PATIENT_PAUSES, demand_speed, effects, write_rig
from .fit import VERBS as FIT
from .recorded import replay
from .run import run

WITHHELD = ("area_moment", "spine_shear", "chamber_azimuth", "chamber_twist", "chamber_ballooning")
"""Effects that a demo may hide: at half their scale at least four noise floors remain after a calibration with its tolerances "
"(of a tilted base or a precurved body none would), and the cause can be repaired."""
STIFFNESS = ["steps=6", "min_samples=20", "zero_samples=20"]
SEALED = "sealed.sha256"
"""File that marks a folder as a demo's: the digest of the hidden effect."""
BENDING = [
    "repeats=2", "unload=true", "settle.min_samples=3", "spine_lengths=[0, 0.1, 0.2, 0.3]", *PATIENT_PAUSES
]  # fmt: skip
"""Two repeats: the fewest from which a cause may be named. Every second length of the paper: a demo is short."""


def demo(folder: Path, seed: int | None, speed: float, effect: str | None = None) -> Result:
    """Do what a person would do on the first day, verb by verb; code 0 unless one verb fails.

    `effect` as `ID[=SIZE]` is withheld instead of a drawn one. Raises ConfigError where the instruments' libraries are not
    installed: the fakes are reached by them."""
    if missing := {why for name, why in found_drivers().broken.items() if name in OWN}:  # said before the fakes are started
        raise ConfigError(*sorted(missing))
    demand_speed(speed)
    seed = secrets.randbelow(10**6) if seed is None else seed
    rng = np.random.default_rng(seed)
    name, size = draw_effect(rng, WITHHELD) if effect is None else next(iter(effects([effect]).items()))
    seal = json.dumps({"effect": name, "size": float(size), "salt": rng.bytes(16).hex()})
    digest = hashlib.sha256(seal.encode()).hexdigest()
    began, codes = time.monotonic(), list[int]()
    if folder.is_dir() and any(folder.iterdir()):
        if not (folder / SEALED).is_file():
            raise ConfigError(f"{folder}: is not empty and holds no demo; delete it, or give another folder with --out")
        shutil.rmtree(folder)  # an earlier demo's
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SEALED).write_text(f"{digest}\n")
    out.print(f"One effect is switched on and withheld; sealed as sha256 {digest}")

    def step(title: str, do: Callable[[], Result]) -> Result:
        """Print a title and the elapsed time, do the step, print its result. Raises its error."""
        out.print(styled(f"\n{title}", "bold"), styled(f" {time.monotonic() - began:.0f} s", "dim"))
        result = do()
        result.tell()
        if result.error is not None:
            raise result.error
        codes.append(result.code)
        return result

    rig, files = folder / "rig.yaml", list[Path]()
    with processes(len(PARTS), tuple(PARTS), BEHIND.process) as compiling:  # while the rig mostly waits
        out.print(f"\nFake instruments at {speed:g} times real speed")
        with FakeRig(speed=speed, effects={name: size}, seed=seed) as fakes:
            write_rig(fakes, rig, PATIENT)
            if step("lab check", lambda: check(rig, 2.0)).code == 1:
                return Result(code=1)
            for protocol, settings in (("stiffness", STIFFNESS), ("bending", BENDING)):
                result_data = step(f"lab run {protocol}", partial(run, protocol, rig, settings, folder, None)).data
                assert isinstance(result_data, dict)
                files.append(Path(result_data["file"]))
        if not compiling.ready:
            out.print("\nThe model is still being compiled for this computer; this happens once and takes half a minute.")
        compiling.begun()
    step("lab replay: the same numbers from the files alone", lambda: replay(files))

    def asked(verb: Verb, *options: str) -> Result:
        """Call a verb for the recordings."""
        verb.add_to(parser := argparse.ArgumentParser())
        return verb.call(parser.parse_args([*map(str, files), *options]))

    step("lab fit", lambda: asked(FIT[0]))
    step("lab compare: the paper's parameters", lambda: compare(files, None, None, False, None))
    answers = {"--json": "diagnosis.json", "--report": "report.html", "--protocols": "next"}
    written = [f"{name}={folder / file}" for name, file in answers.items()]
    step("lab diagnose: which effect was withheld?", lambda: asked(DIAGNOSE[0], *written))
    answer = Diagnosis.from_json((folder / "diagnosis.json").read_text(encoding="utf-8"))
    out.print(f"\nThe seal: {seal}")
    withheld = next(e for e in list_effects() if e.id == name)
    amount, unit = for_people(size, withheld.unit)
    out.print(styled(f"Withheld: {name}", "bold"), f"= {amount:.4g} {unit}".rstrip(), f"({withheld.physics})")
    out.print(
        styled("Found:", "bold"), f"{answer.headline} The fakes use a different law than the catalogue, so the sizes may differ."
    )
    out.print("The fakes have ended; to run a proposal, start others: lab fakes --speed 20 --rig rig/rig.yaml", soft_wrap=True)
    out.print(f"Open {folder / 'report.html'}", soft_wrap=True)
    out.print(f"Done in {time.monotonic() - began:.0f} s.")
    return Result(code=1 if 1 in codes else 0)


VERBS = (
    Verb(
        "demo",
        lambda a: demo(a.out, a.seed, a.speed, a.effect),
        options=(
            path_option(
                "--out", "FOLDER", "for recordings and report; an earlier demo in it is replaced", default=Path("demo")
            ),  # fmt: skip
            option("--seed", type=int, help="choose withheld effect and noise"),
            option("--speed", type=float, default=20.0, help="clock speed of the rig, times real time (default 20)"),
            option("--effect", "ID[=SIZE]", "withhold this effect instead of a random one"),
        ),
        examples=("lab demo", "lab demo --out demo --seed 3"),
        page="docs/tutorials/first-day.md",
    ),
)
