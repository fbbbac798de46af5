"""`lab demo`: the whole lab without hardware. An effect is drawn and sealed first, and named last."""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from model.compare import ErrorTable
from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import draw_effect, list_effects

from .check import check
from .compare import Comparison, comparison
from .compare import sheet as error_sheet
from .console import Screen, clock, out
from .fakes import write_rig
from .figures import force_curves, moduli, tip_curves
from .fit import Calibration, calibrate
from .fit import sheet as fit_sheet
from .inputs import Case, read_case
from .recorded import replayed
from .report import Report
from .rig import Rig
from .rig_file import load_rig
from .run import Outcome, connect, execute, job

T = TypeVar("T")
WITHHELD = (
    "spine_slip", "area_moment", "spine_shear", "spine_length_offset", "hyperelastic", "viscoelastic", "chamber_ballooning",
    "pressure_offset", "self_weight", "base_tilt", "tether_load", "frame_misalignment", "marker_offset",
)  # fmt: skip
"""Effects that a demo may hide."""
STIFFNESS = ["steps=6", "min_samples=30"]
BENDING = ["repeats=1", "unload=true"]


@dataclass(frozen=True)
class Seal:
    """An effect and its size, and the digest that was shown before anything was measured."""

    effect: str
    size: float
    unit: str
    physics: str
    salt: str

    @property
    def text(self) -> str:
        """What the digest is of."""
        return json.dumps({"effect": self.effect, "size": self.size, "salt": self.salt})

    @property
    def digest(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def draw(seed: int) -> Seal:
    """One effect of a plausible size."""
    rng = np.random.default_rng(seed)
    name, size = draw_effect(rng, WITHHELD)
    info = next(e for e in list_effects() if e.id == name)
    return Seal(name, float(size), info.unit, info.physics, rng.bytes(16).hex())


class Story:
    """Tells the steps of the demo with their times."""

    def __init__(self) -> None:
        self.began = time.monotonic()

    def step(self, title: str, do: Callable[[], T]) -> T:
        """Say what comes, do it."""
        out.print(f"\n[bold]{title}[/bold]  [dim]{clock(time.monotonic() - self.began)}[/dim]")
        return do()


def demo(folder: Path, seed: int | None, speed: float) -> int:
    """Run the story; 0 when every step succeeded and every replayed number equals the live one."""
    seed = secrets.randbelow(10**6) if seed is None else seed
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    story, seal = Story(), draw(seed)
    out.print(f"An effect is withheld; sealed as sha256 {seal.digest}")
    fakes = story.step(f"Fake instruments at {speed:g} times real speed", lambda: _fakes(folder, seed, speed, seal))
    with fakes:
        rig_path = folder / "rig.yaml"
        if story.step("lab check", lambda: check(rig_path, 2.0, False)) == 1:
            return 1
        with Rig(load_rig(rig_path)) as rig:
            connect(rig, quiet=True)
            jobs = [("stiffness", STIFFNESS), ("bending", BENDING)]
            runs = [
                story.step(
                    f"lab run {name}", lambda name=name, settings=settings: _run(rig, rig_path, folder, name, settings)
                )
                for name, settings in jobs
            ]
    files = [r.file for r in runs]
    equal = story.step("lab replay: the same numbers from the files alone", lambda: _replay(files))
    case = read_case(files)
    fit = story.step("lab fit", lambda: _shown(calibrate(case), fit_sheet))
    before = story.step("lab compare: the paper's parameters", lambda: comparison(case))
    after = story.step("lab compare: calibrated", lambda: comparison(Case(fit.robot, case.table)))
    out.print(error_sheet(before.table))
    page = story.step("Report", lambda: _report(folder, case, runs, fit, before, after, equal, seal))
    out.print(f"{page}")
    out.print(f"\nThe seal: {seal.text}")
    out.print(f"[bold]The effect that was on: {seal.effect}[/bold] = {seal.size:.4g} {seal.unit} ({seal.physics})")
    out.print(f"Done in {clock(time.monotonic() - story.began)}.")
    return 0 if equal and all(r.error is None and r.safe for r in runs) else 1


def _fakes(folder: Path, seed: int, speed: float, seal: Seal) -> FakeRig:
    rig = FakeRig(speed=speed, effects={seal.effect: seal.size}, seed=seed)
    write_rig(rig, folder / "rig.yaml")
    return rig


def _run(rig: Rig, rig_path: Path, folder: Path, name: str, settings: list[str]) -> Outcome:
    j = job(name, rig_path, settings)
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
        out.print(
            f"  {file.name}: {result.replayed} of {result.live} rows concluded again, {word}; sha256 {digest[:16]}"
        )
    return equal


def _shown(result: T, sheet: Callable[[T], object]) -> T:
    out.print(sheet(result))
    return result


def _report(
    folder: Path,
    case: Case,
    runs: list[Outcome],
    fit: Calibration,
    before: Comparison,
    after: Comparison,
    equal: bool,
    seal: Seal,
) -> Path:
    """The page with everything that was seen."""
    states = sum(len(r.table) for r in runs)
    report = Report(
        "A day in the lab, without hardware",
        f"{time.strftime('%Y-%m-%d %H:%M')}, {states} states, recorded in {' and '.join(r.file.name for r in runs)}",
        f"The model with the paper's parameters misses the tip by {before.table.rmse * 1e3:.1f} mm rms; calibrated per spine length "
        f"by {after.table.rmse * 1e3:.1f} mm. Replayed from the files alone, {'every number is the same' if equal else 'numbers DIFFER'}.",
    )
    stiff = report.section("Stiffness of the spine")
    stiff.figure(
        force_curves(case.of("stiffness"), folder / "force.png"), "Force on the spine's tip over its deflection."
    )
    paper = case.robot.spine.modulus if case.robot.spine else {}
    stiff.figure(
        moduli(fit.spine_modulus, paper, folder / "moduli.png"), "Young's modulus by eq. 9, with 95 % intervals."
    )
    bend = report.section("Bending: measured against the model with the paper's parameters")
    bend.figure(tip_curves(before, folder / "paper.png"), "Marks: measured tip, loading and unloading. Lines: model.")
    bend.table(*_errors(before.table))
    fitted = report.section("After calibration")
    fitted.figure(
        tip_curves(after, folder / "calibrated.png"),
        "The same marks; the model with one chamber area per spine length.",
    )
    fitted.table(*_errors(after.table))
    fitted.table(
        ["spine", "A_eff / A", "standard error", "left over, mm rms"],
        [
            [f"{k * 100:.0f} cm", f"{a.factor.value:.3f}", f"{a.factor.standard_error:.3f}", f"{a.rmse * 1e3:.2f}"]
            for k, a in fit.area_factor_by_length.items()
        ],
    )
    end = report.section("What was withheld")
    end.text(f"{seal.effect} = {seal.size:.4g} {seal.unit}: {seal.physics}.")
    end.text(f"Sealed before the first measurement as sha256 {seal.digest} of {seal.text}")
    return report.write(folder / "report.html")


def _errors(table: ErrorTable) -> tuple[list[str], list[list[str]]]:
    head = ["spine", "n", "x (paper: X), mm", "z (paper: Y), mm", "y, mm", "rms, mm", "worst, mm"]
    rows = [
        [f"{r.spine_length * 100:.0f} cm", str(r.n)]
        + [f"{v * 1e3:.2f}" for v in (r.mean_abs_x, r.mean_abs_z, r.mean_abs_y, r.rmse, r.worst)]
        for r in table.rows
    ]
    return head, rows
