"""`lab verify` and `lab recover`: is a recording whole, and what can be had of one that is not."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from recordings.file.recover import Recovery
from recordings.file.recover import recover as recovered
from recordings.file.verify import verify as inspect
from recordings.file.writer import LIBRARY

from ..console import out
from ..options import ANY_SIZE, JSON, Result, Verb, option

SHOWN = 20
"""Problems printed; all are in the JSON."""


def verify(file: Path) -> Result:
    """Check every byte; 3 when something is wrong. Parts that no checksum covers are named."""
    v = inspect(file)

    def show() -> None:
        for problem in v.problems[:SHOWN]:
            out.print(f"byte {problem.at}: {problem.text}")
        if len(v.problems) > SHOWN:
            out.print(f"and {len(v.problems) - SHOWN} more; --json prints all")
        compared = f"{v.chunks} chunks, {v.messages} messages, {v.checksums} checksums compared"
        if not v.ok:
            out.print(f"{file} is DAMAGED ({compared}); `lab recover {file}` keeps all that can be read")
            return
        out.print(f"{file} is {v.verdict}: {compared}")
        if v.uncovered:
            out.print(f"no checksum covers: {'; '.join(v.uncovered)}")

    return Result(v.to_dict(), show, 0 if v.ok else 3)


def recover(file: Path, target: Path | None) -> Result:
    """Write what can be read to a new file; 3 when anything was lost."""
    r = recovered(file, target)
    return Result(r.to_dict(), partial(_show_recovered, r), 0 if r.complete else 3)


def _show_recovered(r: Recovery) -> None:
    out.print(f"{r.target}: {sum(r.messages.values())} messages, {r.seconds_kept:.3f} s")
    if r.complete:
        out.print("nothing was lost")
        return
    out.print(f"lost: {r.seconds_lost:.3f} s; {r.holes} places, {r.bytes_skipped} bytes could not be read")
    for topic, n in r.lost.items():
        out.print(f"  {topic}: {n} messages are missing")
    if r.nameless:
        out.print(f"  {r.nameless} messages of topics whose description is lost")
    for topic in r.schemaless:
        out.print(f"  {topic}: its schema is missing; its messages are kept without one")
    if r.oversized:
        out.print(f"left out: {r.oversized}")
    if not r.finished:
        ours = "up to 0.2 s of data" if r.library == LIBRARY else "what its recorder still held"
        out.print(f"The recording ended abruptly: {ours} in memory was never written.")


VERBS = (
    Verb(
        "verify",
        lambda a: verify(a.file),
        options=(JSON, ANY_SIZE, option("file", type=Path)),
        examples=("lab verify runs/sweep.mcap", "lab verify runs/sweep.mcap --json"),
        page="docs/explanations/recordings.md",
    ),
    Verb(
        "recover",
        lambda a: recover(a.file, a.out),
        options=(
            JSON,
            ANY_SIZE,
            option("file", type=Path),
            option(
                "--out",
                type=Path,
                metavar="FILE",
                help="the new file (default: <name>-recovered.mcap beside the old one)",
            ),
        ),
        examples=("lab recover runs/sweep.mcap", "lab recover runs/sweep.mcap --out saved.mcap"),
        page="docs/howto/resume.md",
    ),
)
