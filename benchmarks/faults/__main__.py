"""`python -m benchmarks.faults`: run the matrix and print the table; 0 when every cell passed."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

from sim_fakes.faults import FAULTS

from .cells import PHASES, SUBJECTS, FaultCell, Verdict, cells
from .trial import FaultBench


def run(todo: list[FaultCell], report: Path | None) -> list[Verdict]:
    """All cells on this process's own fakes, one after another."""
    verdicts: list[Verdict] = []
    bench: FaultBench | None = None
    try:
        for cell in todo:
            if bench is None or bench.second_rig != cell.second_rig:
                if bench is not None:
                    bench.close()
                bench = FaultBench(cell.second_rig)
            began = time.monotonic()
            verdict = bench.verdict(cell)
            verdicts.append(verdict)
            if report is not None:
                with report.open("a") as file:
                    file.write(json.dumps(asdict(verdict)) + "\n")
            words = f"{verdict.mark} {cell.subject} {cell.fault} {cell.phase} {time.monotonic() - began:.1f} s"
            print(f"{words} {verdict.error[:150]} {('| ' + verdict.why[:250]) if verdict.why else ''}", flush=True)
    finally:
        if bench is not None:
            bench.close()
    return verdicts


def shared(arguments: argparse.Namespace, report: Path) -> list[Verdict]:
    """The cells dealt out to several processes."""
    report.parent.mkdir(parents=True, exist_ok=True)
    if not arguments.resume:
        report.write_text("")
    base = [sys.executable, "-m", "benchmarks.faults", "--report", str(report)]
    for name in ("subject", "fault", "phase"):
        for value in getattr(arguments, name):
            base += [f"--{name}", value]
    running = [subprocess.Popen([*base, "--share", f"{i}/{arguments.jobs}"]) for i in range(arguments.jobs)]
    for process in running:
        process.wait()
    return list(read(report).values())


def read(report: Path) -> dict[FaultCell, Verdict]:
    """The last verdict on each cell of a report."""
    found: dict[FaultCell, Verdict] = {}
    for line in report.read_text().splitlines() if report.exists() else []:
        entry = json.loads(line)
        verdict = Verdict(**{**entry, "cell": FaultCell(**entry["cell"]), "unsafe": tuple(entry["unsafe"])})
        found[verdict.cell] = verdict
    return found


def table(verdicts: list[Verdict]) -> str:
    """Marks by instrument and fault, five phases each."""
    marks = {(v.cell.subject, v.cell.fault, v.cell.phase): v.mark for v in verdicts}
    lines = [f"{'':17s}" + " ".join(f"{f[:8]:>8s}" for f in FAULTS)]
    for subject in SUBJECTS:
        row = ["".join(marks.get((subject, f, p), " ") for p in PHASES) for f in FAULTS]
        if any(r.strip() for r in row):
            lines.append(f"{subject:17s}" + " ".join(f"{r:>8s}" for r in row))
    passed = sum(v.mark != "X" for v in verdicts)
    lines.append(f"phases: {', '.join(PHASES)}")
    lines.append(
        ". completed, safe   e ended with its typed error, safe   l the faulty instrument not confirmed, rig locked   X failed"
    )
    again = sum(v.tries > 1 for v in verdicts)
    if again:
        lines.append(f"{again} tried again, as the rig had stopped, safe, before their fault was given")
    lines.append(
        f"{passed} of {len(verdicts)} passed; longest from fault to end {max((v.seconds for v in verdicts), default=0):.1f} s"
    )
    return "\n".join(lines)


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults", description=__doc__)
    parser.add_argument("--subject", action="append", default=[], choices=SUBJECTS)
    parser.add_argument("--fault", action="append", default=[], choices=FAULTS)
    parser.add_argument("--phase", action="append", default=[], choices=PHASES)
    parser.add_argument("--jobs", type=int, default=2, help="processes, each with fakes of its own")
    parser.add_argument("--report", type=Path, default=Path("out/faults.jsonl"))
    parser.add_argument("--resume", action="store_true", help="keep what the report holds; try what is missing or failed")
    parser.add_argument("--share", help="I/N: every N-th cell from the I-th on, in this process")
    a = parser.parse_args()
    if a.share:
        index, count = map(int, a.share.split("/"))
        todo = cells(tuple(a.subject) or SUBJECTS, tuple(a.fault) or FAULTS, tuple(a.phase) or PHASES)
        passed = {c for c, v in read(a.report).items() if v.mark != "X"}
        todo = [c for i, c in enumerate(todo) if i % count == index and c not in passed]
        return 0 if all(v.mark != "X" for v in run(todo, a.report)) else 1
    verdicts = shared(a, a.report)
    print(table(verdicts))
    wanted = len(cells(tuple(a.subject) or SUBJECTS, tuple(a.fault) or FAULTS, tuple(a.phase) or PHASES))
    return 0 if len(verdicts) == wanted and all(v.mark != "X" for v in verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
