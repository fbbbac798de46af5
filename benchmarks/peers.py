"""Every way to solve the paper's rods, at several errors: `python -m benchmarks.peers [--quick] [--json FILE]`.

Nine rods, from hardly bent to 250 kPa without spine; an error is the worst distance (mm) of their tips from those of
`REFERENCE` (SciPy's DOP853, which shares no code with the rod). The rod's own in a batch: the worst of 35,000 further rods, from
the rod solved very finely. The time of a solve is processor time of one process. What is needed once in each process, models
and compiling, stands beside. Simulators that are not installed are named: `make bench PEERS=1` installs them.

PyElastica's rod has a law of its own, so its tips come to rest elsewhere: `own_mm` is the distance from where its
own tips go with more and more elements. SoRoMoX' law is the rod's.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_bvp

from benchmarks.figures import write
from benchmarks.rod_cases import eased, paper_rods
from model.arrays import Array
from model.rods import Fast, Paper, Rods, solve
from tests.model.rods.reference import REFERENCE

Solver = Callable[[], Array]

GRAVITY = 9.81
STABLE = 20
"""Elements of PyElastica up to which its usual time step is short enough; more want a step shorter by as much."""


class Equations:
    """p' = R v, R' = R u^, n' = -f, m' = -p' x n of one rod of two elements, in the mount frame."""

    def __init__(self, rods: Rods, i: int) -> None:
        self.length, self.joint = float(rods.whole_length[i]), float(rods.field("length")[i, 0])
        self.stretch, self.bend = rods.field("stretch_stiffness")[i], rods.field("bend_stiffness")[i]
        self.load, self.force, self.moment = (rods.field("load")[i, 0], rods.field("tip_force")[i], rods.field("tip_moment")[i])
        self.dead = rods.field("dead_force")[i]

    def slopes(self, y: Array, part: int) -> Array:
        """d(p, R, n, m)/ds at many places, y (18, k)."""
        turn, n = y[3:12].reshape(3, 3, -1), y[12:15]
        v = np.einsum("jik,jk->ik", turn, n) / self.stretch[part][:, None] + np.array([[0.0], [0.0], [1.0]])
        u = np.einsum("jik,jk->ik", turn, y[15:18]) / self.bend[part][:, None]
        turned = np.cross(turn, u, axisa=1, axisb=0).transpose(0, 2, 1)
        moved = np.einsum("ijk,jk->ik", turn, v)
        load = np.broadcast_to(-self.load[:, None], n.shape)
        return np.concatenate([moved, turned.reshape(9, -1), load, -np.cross(moved, n, axis=0)])

    def open_tip(self, y: Array) -> Array:
        """What the tip carries minus what it should, [E^F, E^M]."""
        turn = y[3:12].reshape(3, 3)
        return np.concatenate([y[12:15] - turn @ self.force - self.dead, y[15:18] - turn @ self.moment])


def collocation(rods: Rods, tolerance: float) -> Array:
    """Tips (n, 3) m by SciPy's collocation, both elements side by side over 0..1, all places of a mesh at once."""
    tips = np.empty((len(rods), 3))
    for i in range(len(rods)):
        rod = Equations(rods, i)
        ends = (rod.joint, rod.length - rod.joint)
        straight = np.concatenate([np.zeros(3), np.eye(3).ravel(), rod.force + rod.dead + rod.load * rod.length, rod.moment])

        def slope(_: Array, y: Array, rod: Equations = rod, ends: tuple[float, float] = ends) -> Array:
            return np.concatenate([ends[0] * rod.slopes(y[:18], 0), ends[1] * rod.slopes(y[18:], 1)])

        def closed(a: Array, b: Array, rod: Equations = rod) -> Array:
            return np.concatenate(
                [a[:12] - np.concatenate([np.zeros(3), np.eye(3).ravel()]), b[:18] - a[18:], rod.open_tip(b[18:])]
            )

        x = np.linspace(0, 1, 9)
        guess = np.tile(np.concatenate([straight, straight])[:, None], x.size)
        guess[2], guess[20] = ends[0] * x, ends[0] + ends[1] * x
        tips[i] = solve_bvp(slope, closed, x, guess, tol=tolerance).y[18:21, -1]
    return tips


def pyelastica(rods: Rods, elements: int, at_rest: float) -> Solver:
    """Rods of equal elements, damped until no node is faster than `at_rest` m/s."""
    from model.simulators import pyelastica as own

    step = own.TIME_STEP * min(1.0, STABLE / elements)
    density = np.linalg.norm(rods.field("load")[:, 0], axis=1) / GRAVITY / (np.pi * own.RADIUS**2)

    def solve() -> Array:
        return np.array([own.relaxed(rods, i, density[i], elements, step, at_rest) for i in range(len(rods))])

    return solve


def soromox_constant(rods: Rods, segments: int) -> Solver:
    """Strain constant in equal segments: `lab diagnose --simulator soromox`."""
    from model.simulators.soromox import tips_of

    models: dict[bytes, Any] = {}
    return lambda: tips_of(rods, segments, models)


def soromox_polynomial(rods: Rods, order: int, points: int) -> Solver:
    """Strain a polynomial of that order in each element, integrated at this many Gauss points; two segments a rod."""
    import jax.numpy as jnp

    from model.simulators.soromox import AT_REST, ORDER, equilibrium

    axes = list(ORDER)
    models = [_polynomial(rods, i, order, points) for i in range(len(rods))]
    follower = np.hstack([rods.field(name)[:, axes] for name in ("tip_moment", "tip_force")])
    dead, length = rods.field("dead_force"), rods.whole_length

    def solve() -> Array:
        tips = np.full((len(rods), 3), np.nan)
        for i, model in enumerate(models):
            tip, left = equilibrium(model, *(jnp.asarray(each[i]) for each in (follower, dead, length)))
            if float(left) < AT_REST:
                tips[i] = tip
        return tips

    return solve


def _polynomial(rods: Rods, i: int, order: int, points: int) -> Any:
    """Rod `i` with Legendre polynomials of all six strains; a rod without a first element is halved, so that all compile once."""
    import jax.numpy as jnp
    from soromox.systems import GVS, GVSSegment, JointSpec, LinkSpec, StrainBasisSpec

    from model.simulators.soromox import ORDER, RADIUS, UPRIGHT

    axes, lengths, which = list(ORDER), rods.field("length")[i], (0, 1)
    if lengths[0] == 0.0:
        lengths, which = np.full(2, 0.5 * lengths[1]), (1, 1)
    load = rods.field("load")[i, 0]
    weight = float(np.linalg.norm(load))
    norms = 2.0 * np.arange(order + 1) + 1.0
    segments = []
    for length, e in zip(lengths, which, strict=True):
        section = np.hstack([rods.field(name)[i, e][axes] for name in ("bend_stiffness", "stretch_stiffness")])
        link = LinkSpec.circular(
            length=float(length), radius=RADIUS, density=weight / (np.pi * RADIUS**2), reference_strain=[0, 0, 0, 1, 0, 0],
            stiffness=jnp.diag(jnp.asarray((length * section[:, None] / norms).ravel())),
        )  # fmt: skip
        basis = StrainBasisSpec("legendre", [1] * 6, order)
        segments.append(GVSSegment(link, JointSpec(type="fixed"), basis, points))
    return GVS.from_segments(segments, gravity=jnp.asarray(load / weight), base_pose=jnp.asarray(UPRIGHT))


PYELASTICA = "PyElastica"
AT_REST = 1e-3
"""m/s; at a hundredth of it PyElastica takes 1.6 times as long and its tips are within 0.2 mm of the same."""
LEVELS = (1.0, 0.1, 0.01)
"""mm, at which methods are compared."""
STATES, RODS = 231, 1_000
"""Of a campaign, and of a batch: how long a person waits."""


@dataclass(frozen=True)
class PeerRow:
    """One method with one setting."""

    method: str
    setting: str
    solve_s: float = float("nan")
    """Processor time of a solve."""
    once_s: float = 0.0
    """On the clock, before: models and compiling."""
    error_mm: float = float("nan")
    """Worst of the nine tips."""
    own_mm: float | None = None
    """The same from the method's own converged tips, where its law is its own."""
    missed: int = 0
    """Rods that it did not solve."""
    absent: str = ""
    """Why it was not measured."""

    @property
    def off_mm(self) -> float:
        """The error by the method's own law."""
        return self.error_mm if self.own_mm is None else self.own_mm


@dataclass(frozen=True)
class PeerWay:
    """A method with a setting, before it is measured."""

    method: str
    setting: str
    prepare: Callable[[Rods], Solver]


@dataclass
class Measured:
    """Rows, and the tips (n, 3) m of each."""

    rods: Rods
    truth: Array
    rows: list[PeerRow] = field(default_factory=list)
    tips: list[Array] = field(default_factory=list)

    def add(self, way: PeerWay) -> None:
        """Solve twice: what the first takes longer is needed once."""
        clock = time.perf_counter()
        try:
            call = way.prepare(self.rods)
        except ImportError as why:
            self.rows.append(PeerRow(way.method, way.setting, absent=f"not installed ({why.name}): make bench PEERS=1"))
            self.tips.append(np.full_like(self.truth, np.nan))
            return
        call()
        first, again = time.perf_counter() - clock, time.perf_counter()
        tips = call()
        second = time.perf_counter() - again
        solve_s = least(call, 1) / len(self.rods)
        missed = int(np.isnan(tips).any(axis=1).sum())
        once = max(first - second, 0.0)
        self.rows.append(PeerRow(way.method, way.setting, solve_s, once, farthest(tips, self.truth), missed=missed))
        self.tips.append(tips)

    def own_errors(self, method: str, converged: Array) -> None:
        """State the distance from a method's own converged tips."""
        for i, (row, tips) in enumerate(zip(self.rows, self.tips, strict=True)):
            if row.method == method and not row.absent:
                self.rows[i] = replace(row, own_mm=farthest(tips, converged))

    def finest(self, method: str, count: int) -> list[Array]:
        """Tips of the last settings of a method."""
        return [tips for row, tips in zip(self.rows, self.tips, strict=True) if row.method == method][-count:]


def farthest(tips: Array, truth: Array) -> float:
    """Worst distance, mm, of those that were found; NaN where none was."""
    found = ~np.isnan(tips + truth).any(axis=1)
    return float(1e3 * np.linalg.norm(tips - truth, axis=1)[found].max()) if found.any() else float("nan")


def least(call: Callable[[], object], rounds: int) -> float:
    """Least seconds of processor time of a call that was made before, each the mean of as many as take SPAN."""
    taken = []
    for _ in range(rounds):
        start, count = time.process_time(), 0
        while not count or time.process_time() - start < SPAN:
            call()
            count += 1
        taken.append((time.process_time() - start) / count)
    return min(taken)


SPAN = 0.1
"""s of processor time, of which some systems count hundredths."""


def fast_ways(rods: Rods, quick: bool) -> Iterator[PeerRow]:
    """The rod's own, in a batch cold and warm and one by one."""
    many = paper_rods(4_000 if quick else 35_000, seed=1)
    before, fine = eased(many), solve(many, Fast(40.0, 1e-11)).trusted().tip
    truth = solve(rods, REFERENCE).trusted().tip
    for divisions, close in ((2.0, 1e-4), (3.0, 1e-5), (4.0, 2e-6), (8.0, 1e-8), (20.0, 1e-11)):
        name = f"{divisions:g} divisions"
        cold, warm = Fast(divisions, close), Fast(divisions, close, remember=True)
        near = solve(before, warm)
        one = [rods[i : i + 1] for i in range(len(rods))]
        calls: dict[str, tuple[Callable[[], Array], Array]] = {
            "rod, batch": (lambda m=cold: solve(many, m).tip, fine),
            "rod, batch, warm": (lambda m=cold, s=near: solve(many, m, start=s).tip, fine),
            "rod, one by one": (lambda m=cold, o=one: np.concatenate([solve(r, m).tip for r in o]), truth),
        }
        for method, (call, right) in calls.items():
            tips = call()  # the first compiles
            yield PeerRow(method, name, least(call, 5) / len(right), error_mm=farthest(tips, right))


def ways(quick: bool) -> list[PeerWay]:
    """Of all others."""
    found = []
    for steps in (100, 1_000) if quick else (100, 1_000, 10_000, 100_000):
        found.append(PeerWay("paper's way", f"{steps} steps", lambda r, n=steps: lambda: solve(r, Paper(n)).tip))
    for tolerance in (1e-2, 1e-3, 1e-4, 1e-6):
        name = f"tolerance {tolerance:g}"
        found.append(PeerWay("SciPy solve_bvp", name, lambda r, t=tolerance: lambda: collocation(r, t)))
    for elements in (10, 20) if quick else (10, 20, 40, 80):
        found.append(PeerWay(PYELASTICA, f"{elements} elements", lambda r, n=elements: pyelastica(r, n, AT_REST)))
    for segments in (4,) if quick else (4, 10, 20):
        name = f"{segments} segments"
        found.append(PeerWay("SoRoMoX, constant strain", name, lambda r, n=segments: soromox_constant(r, n)))
    for order, points in ((1, 5),) if quick else ((1, 5), (2, 5), (3, 8)):
        name = f"order {order}, 2 segments"
        found.append(PeerWay("SoRoMoX, polynomial strain", name, lambda r, k=order, g=points: soromox_polynomial(r, k, g)))
    return found


def figures(quick: bool) -> list[PeerRow]:
    """All rows."""
    rods = paper_rods(35, seed=4)[:: 16 if quick else 4]
    measured = Measured(rods, solve(rods, REFERENCE).trusted().tip)
    for way in ways(quick):
        measured.add(way)
        print(f"{way.method}, {way.setting}: {measured.rows[-1].absent or shown(measured.rows[-1].solve_s)}", flush=True)
    coarse, fine = measured.finest(PYELASTICA, 2)
    measured.own_errors(PYELASTICA, 2.0 * fine - coarse)  # its error halves with twice the elements
    return [*fast_ways(rods, quick), *measured.rows]


def reached(rows: list[PeerRow], level: float) -> dict[str, PeerRow]:
    """The quickest setting of each method that is within `level` mm by its own law on all rods."""
    found: dict[str, PeerRow] = {}
    for row in rows:
        if row.missed or not row.off_mm <= level:
            continue
        if row.method not in found or row.solve_s < found[row.method].solve_s:
            found[row.method] = row
    return found


def wait(row: PeerRow, solves: int) -> float:
    """Seconds for this many solves one after another in a fresh process, without its imports."""
    return row.once_s + solves * row.solve_s


def shown(seconds: float) -> str:
    """Of a wait: three digits and a unit."""
    for least_s, factor, unit in ((100.0, 60.0, "min"), (1.0, 1.0, "s"), (1e-3, 1e-3, "ms")):
        if seconds >= least_s:
            return f"{seconds / factor:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} us"


def all_rows(rows: list[PeerRow]) -> Table:
    """Every method and setting."""
    table = Table(title="The paper's rods, every way (worst tip)", title_justify="left")
    for column in ("way", "setting", "a solve", "once", "off, mm", "by its own law, mm", "missed"):
        table.add_column(column)
    for row in rows:
        if row.absent:
            table.add_row(row.method, row.setting, row.absent)
            continue
        own = "" if row.own_mm is None else f"{row.own_mm:.3g}"
        once = shown(row.once_s) if row.once_s > 0.1 else ""
        missed = str(row.missed) if row.missed else ""
        table.add_row(row.method, row.setting, shown(row.solve_s), once, f"{row.error_mm:.2g}", own, missed)
    return table


def at_equal_error(rows: list[PeerRow]) -> Table:
    """What a person waits at each level."""
    table = Table(title="At equal error: the quickest setting within this many mm, or the most exact", title_justify="left")
    for column in ("within, mm", "way", "setting", "a solve", "times the rod's batch", f"{STATES} states", f"{RODS} rods"):
        table.add_column(column)
    units = {level: reached(rows, level)["rod, batch"].solve_s for level in LEVELS}
    lines = [(f"{level:g}", row, units[level]) for level in LEVELS for row in reached(rows, level).values()]
    measured = [row for row in rows if not np.isnan(row.off_mm)]
    for method in {row.method: None for row in measured if row.method not in reached(rows, LEVELS[0])}:
        best = min((row for row in measured if row.method == method), key=lambda row: row.off_mm)
        lines.append((f"{best.off_mm:.2g}", best, units[LEVELS[0]]))
    for level, row, unit in lines:
        waits = [shown(wait(row, count)) for count in (STATES, RODS)]
        table.add_row(level, row.method, row.setting, shown(row.solve_s), f"{row.solve_s / unit:,.3g}", *waits)
    return table


def main() -> int:
    """Print the tables, write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three rods, fewer settings")
    parser.add_argument("--json", type=Path, default=Path("out/peers.json"), help="where the numbers go")
    options = parser.parse_args()
    rows = figures(options.quick)
    console = Console(width=150)
    console.print(all_rows(rows), at_equal_error(rows))
    write(options.json, "rows", rows)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
