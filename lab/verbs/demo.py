"""`lab demo`: the whole lab without hardware. An effect is drawn and sealed first, and named last."""

from __future__ import annotations

import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from diagnosis.answer.result import Diagnosis
from drivers.registry import OWN
from model.warm_up import PARTS
from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import draw_effect, list_effects

from ..calibration import calibrate
from ..comparison import comparison
from ..console import Screen, out, styled
from ..files.all_drivers import found_drivers
from ..files.config import ConfigError
from ..files.inputs import Case, read_case
from ..files.rig_file import load_rig
from ..options import Verb, option
from ..pages.demo_report import SIZES, Seal, write
from ..priority import BEHIND
from ..processes import processes
from ..rig.assembly import Rig
from .check import check
from .compare import sheet as error_sheet
from .diagnose import Outputs, diagnose
from .fakes import PATIENT, PATIENT_PAUSES, effects, write_rig
from .fit import sheet as fit_sheet
from .recorded import replayed
from .run import Outcome, connect, execute, job

T = TypeVar("T")
WITHHELD = ("area_moment", "spine_shear", "chamber_azimuth", "chamber_twist", "chamber_ballooning")
"""Effects that a demo may hide: at half their scale a calibration, its tolerances included, leaves four noise floors of them
and more (of a tilted base or a curved body at rest it leaves none), and whoever knows the cause mends it at its place."""
STIFFNESS = ["steps=6", "min_samples=20"]
SEALED = "sealed.sha256"
"""File that shows a folder to be a demo's: the digest of what is withheld."""
BENDING = [
    "repeats=2", "unload=true", "settle.min_samples=3", "spine_lengths=[0, 0.1, 0.2, 0.3]", *PATIENT_PAUSES
]  # fmt: skip
"""Two repeats: the fewest from which a cause may be named. Every second length of the paper: a demo is short."""


def draw(seed: int, chosen: str | None = None) -> Seal:
    """One effect of a plausible size, or the chosen `ID[=SIZE]`; raises ConfigError when that is none."""
    rng = np.random.default_rng(seed)
    name, size = draw_effect(rng, WITHHELD) if chosen is None else next(iter(effects([chosen]).items()))
    info = next(e for e in list_effects() if e.id == name)
    return Seal(name, float(size), info.unit, info.physics, rng.bytes(16).hex())


class Story:
    """Tells the steps of the demo with their times."""

    def __init__(self) -> None:
        self.began = time.monotonic()

    def step(self, title: str, do: Callable[[], T]) -> T:
        """Say what comes, do it."""
        out.print(styled(f"\n{title}", "bold"), styled(f" {time.monotonic() - self.began:.0f} s", "dim"))
        return do()


def demo(folder: Path, seed: int | None, speed: float, effect: str | None = None) -> int:
    """Run the story; 0 when every step succeeded and every replayed number equals the live one.

    `effect` as `ID[=SIZE]` is withheld instead of a drawn one.

    Raises ConfigError where the instruments' libraries are not installed: the fakes are reached by them.
    """
    if missing := {why for name, why in found_drivers().broken.items() if name in OWN}:  # said before the fakes are started
        raise ConfigError("\n".join(sorted(missing)))
    seed = secrets.randbelow(10**6) if seed is None else seed
    story, seal = Story(), draw(seed, effect)
    _clear(folder)
    (folder / SEALED).write_text(f"{seal.digest}\n")
    out.print(f"One effect is switched on and withheld; sealed as sha256 {seal.digest}")
    with _model_warming_up() as ready:
        runs = _on_the_rig(story, folder, seed, speed, seal)
        if runs is not None:
            ready()
    return 1 if runs is None else _conclude(story, folder, runs, seal)


def _clear(folder: Path) -> None:
    """Make an empty folder in the place of an earlier demo's; raises ConfigError for one that holds anything else."""
    if folder.is_dir() and any(folder.iterdir()):
        if not (folder / SEALED).is_file():
            raise ConfigError(f"{folder}: is not empty, and no demo made it; delete it, or give another folder with --out")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)


def _on_the_rig(story: Story, folder: Path, seed: int, speed: float, seal: Seal) -> list[Outcome] | None:
    """What the fakes are needed for; None when an instrument is missing."""
    fakes = story.step(f"Fake instruments at {speed:g} times real speed", lambda: _fakes(folder, seed, speed, seal))
    with fakes:
        rig_path = folder / "rig.yaml"
        if story.step("lab check", lambda: check(rig_path, 2.0, False)) == 1:
            return None
        with Rig(load_rig(rig_path)) as rig:
            connect(rig, rig.names, quiet=True)
            jobs = [("stiffness", STIFFNESS), ("bending", BENDING)]
            return [story.step(f"lab run {name}", partial(_run, rig, rig_path, folder, name, how)) for name, how in jobs]


def _conclude(story: Story, folder: Path, runs: list[Outcome], seal: Seal) -> int:
    """What the files alone are needed for."""
    files = [r.file for r in runs]
    equal = story.step("lab replay: the same numbers from the files alone", lambda: _replay(files))
    case = read_case(files)
    fit = story.step("lab fit", lambda: _shown(calibrate(case), fit_sheet))
    before = story.step("lab compare: the paper's parameters", lambda: comparison(case))
    after = story.step("lab compare: an area factor for each spine length", lambda: comparison(Case(fit.robot, case.table)))
    out.print(error_sheet(before.table, case.robot))
    answers = Outputs(json=folder / "diagnosis.json", protocols=folder / "next")
    story.step("lab diagnose: which effect was withheld?", lambda: diagnose(files, None, answers))
    answer = Diagnosis.from_json((folder / "diagnosis.json").read_text(encoding="utf-8"))
    page = story.step("Report", lambda: write(folder, case, files, fit, (before, after), equal, seal, answer))
    out.print(f"\nThe seal: {seal.text}")
    withheld = styled(f"Withheld: {seal.effect}", "bold")
    out.print(withheld, f"= {seal.amount} ({seal.physics})")
    out.print(styled("Found:", "bold"), f"{answer.headline} {SIZES}")
    out.print("The fakes have ended; to run a proposal, start others: lab fakes --speed 20 --rig rig/rig.yaml", soft_wrap=True)
    out.print(f"Open {page}", soft_wrap=True)
    out.print(f"Done in {time.monotonic() - story.began:.0f} s.")
    return 0 if equal and all(r.error is None and r.safe for r in runs) else 1


@contextmanager
def _model_warming_up() -> Iterator[Callable[[], None]]:
    """Have the model compiled in processes beside, while the rig mostly waits; what it yields waits for the rest."""
    with processes(len(PARTS), tuple(PARTS), BEHIND.process) as beside:

        def ready() -> None:
            if not beside.ready:
                out.print("\nThe model is still being compiled for this computer; this happens once and takes half a minute.")
            beside.begun()

        yield ready


def _fakes(folder: Path, seed: int, speed: float, seal: Seal) -> FakeRig:
    rig = FakeRig(speed=speed, effects={seal.effect: seal.size}, seed=seed)
    write_rig(rig, folder / "rig.yaml", PATIENT)
    return rig


def _run(rig: Rig, rig_path: Path, folder: Path, name: str, settings: list[str]) -> Outcome:
    j = job(name, rig_path, settings, rig=rig.read)
    result = execute(rig, j, folder, Screen(name, j.rig.clock.speed))
    if result.error is not None:
        raise result.error
    lost = ", ".join(f"{n} on {topic}" for topic, n in result.lost.items()) or "none"
    out.print(f"  {len(result.table)} states in {result.file}; samples lost: {lost}")
    return result


def _replay(files: list[Path]) -> bool:
    equal = True
    for file in files:
        result, digest = replayed(file)
        equal = equal and result.equal
        word = "all equal" if result.equal else "DIFFERENT"
        out.print(f"  {file.name}: {result.replayed} of {result.live} rows recomputed, {word}; sha256 {digest[:16]}")
    return equal


def _shown(result: T, sheet: Callable[[T], object]) -> T:
    out.print(sheet(result))
    return result


VERBS = (
    Verb(
        "demo",
        lambda a: demo(a.out, a.seed, a.speed, a.effect),
        options=(
            option(
                "--out",
                type=Path,
                default=Path("demo"),
                metavar="FOLDER",
                help="folder for recordings and report; that of an earlier demo is replaced",
            ),
            option("--seed", type=int, help="choose withheld effect and noise"),
            option("--speed", type=float, default=20.0, help="how much faster than real the rig runs (default 20)"),
            option("--effect", metavar="ID[=SIZE]", help="withhold this effect instead of a drawn one"),
        ),
        examples=("lab demo", "lab demo --out demo --seed 3"),
        page="docs/tutorials/first-day.md",
    ),
)
