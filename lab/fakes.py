"""`lab fakes`: start the fake instruments and print the rig.yaml that reaches them."""

from __future__ import annotations

import argparse
import shutil
import signal
import threading
from pathlib import Path

from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import list_effects

from .config import ConfigError
from .console import out
from .example import paper_robot


def serve(a: argparse.Namespace) -> int:
    """Run until Ctrl-C."""
    if a.list_effects:
        for e in list_effects():
            out.print(f"{e.id:24s} {e.scale:10.4g} {e.unit:12s} {e.physics}")
        return 0
    rig = FakeRig(
        speed=a.speed,
        effects=effects(a.effect),
        seed=a.seed,
        regulators=a.regulators,
        spine=a.spine,
        channels=int(a.channels),
    )
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    with rig:
        if a.rig is not None:
            write_rig(rig, a.rig)
            out.print(f"{a.rig} reaches the fakes; Ctrl-C ends them")
        else:
            out.print(rig.rig_yaml(str(paper_robot())), soft_wrap=True)
        ended.wait()
    return 0


def write_rig(rig: FakeRig, path: Path) -> None:
    """Write rig.yaml and, beside it, the paper's robot.yaml."""
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(paper_robot(), path.parent / "robot.yaml")
    path.write_text(rig.rig_yaml("robot.yaml"))


def effects(settings: list[str]) -> dict[str, float]:
    """ID[=SIZE] -> {id: size}; without a size the effect's plausible one. Raises ConfigError."""
    known = {e.id: e for e in list_effects()}
    chosen: dict[str, float] = {}
    for setting in settings:
        name, _, size = setting.partition("=")
        if name not in known:
            raise ConfigError(f"--effect {name}: unknown; one of {', '.join(known)}")
        try:
            chosen[name] = float(size) if size else known[name].scale
        except ValueError as e:
            raise ConfigError(f"--effect {setting}: {size!r} is not a number in {known[name].unit}") from e
    return chosen
