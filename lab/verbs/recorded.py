"""`lab info`, `replay`, `verify`, `recover` and `runs`: what can be done with recordings alone."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.table import Table as Sheet

from model.errors import unit_text
from recordings.campaign.info import Info
from recordings.campaign.info import info as summary
from recordings.campaign.labels import split
from recordings.campaign.replay import ReplayComparison, replay_states
from recordings.campaign.replay import compare as hold_against
from recordings.campaign.shelf import RecordedRun
from recordings.campaign.shelf import runs as recorded
from recordings.errors import BadMessage
from recordings.events import Request
from recordings.file.reader import Recording
from recordings.file.recover import RECOVERED, Recovery
from recordings.file.recover import recover as recovered
from recordings.file.verify import verify as inspect
from recordings.file.writer import LIBRARY
from recordings.messages import is_stream
from recordings.trials import counted

from ..console import clock, note, out
from ..files.config import ConfigError, parse_yaml
from ..files.inputs import attached, without_torn
from ..files.units import UnitError, to_si
from ..options import READS, Result, Verb, option, path_option, repeatable
from ..plain import typed

SHOWN = 20
"""Problems printed; all are in the JSON."""


def info(files: Sequence[Path]) -> Result:
    """What recordings hold; 3 when the end of one is missing, parts make no sense, or samples were lost."""
    infos = [(file, summary(file)) for file in files]

    def show() -> None:
        for file, s in infos:
            _show(file, s)

    return Result(_by_file([(file, s.to_dict()) for file, s in infos]), show, 0 if all(s.complete for _, s in infos) else 3)


def _by_file(found: Sequence[tuple[Path, dict[str, Any]]]) -> object:
    """Of one file what it holds, of several a list that names them."""
    return [{"file": str(file), **values} for file, values in found] if len(found) > 1 else found[0][1]


def _show(file: Path, s: Info) -> None:
    """Print what a recording holds: streams and their rates, how it ended, attachments, damage, requests, sensors, clocks."""
    speed, nominal = _rig_of(file)
    t = Sheet(title=str(file), title_justify="left", box=None, padding=(0, 1, 0, 0))
    t.add_column("topic", no_wrap=True)
    for column in ("count", "Hz", "nominal", "jitter, ms p50/p99/max", "gaps", "longest, s", "dropped", "lost"):
        t.add_column(column, justify="right", overflow="fold")
    for topic, stream in s.streams.items():
        pace = stream.timing
        losses = ["?" if n is None else str(n) for n in (stream.dropped, stream.lost)]
        if not (pace.count or stream.dropped or stream.lost):
            continue
        if not is_stream(topic):
            t.add_row(topic, str(pace.count), *[""] * 5, *losses)
            continue
        jitter = "/".join(f"{1e3 * x:.1f}" for x in (pace.jitter_p50, pace.jitter_p99, pace.jitter_max))
        usual = f"{nominal[topic]:.1f}" if topic in nominal else ""
        t.add_row(topic, str(pace.count), f"{pace.rate:.1f}", usual, jitter, str(pace.gaps), f"{pace.longest:.3f}", *losses)
    out.print(t)
    if speed != 1:
        out.print(
            f"Rates are per second of rig time; its clock ran at {speed:g} times real speed, so {speed:g} Hz at an instrument "
            "are 1 Hz here.",
            soft_wrap=True,
        )
    torn = f"ended abruptly; {s.readable} of {s.size} bytes can be read; `{typed('lab', 'recover', file)}` keeps them"
    ended = (s.outcome or "finished; its outcome was not recorded") if s.finished else torn
    out.print(f"{ended}{f': {s.detail}' if s.detail else ''}; {s.start}, {s.duration:.1f} s; {_states(s)} states read")
    out.print(f"attached: {', '.join(s.attachments) or 'nothing'}")
    for text in s.damage[:SHOWN]:
        out.print(f"damaged: {text}")
    if s.damage:
        more = f"and {len(s.damage) - SHOWN} more, --json prints all; " if len(s.damage) > SHOWN else ""
        out.print(f"{more}damaged parts are not counted; `{typed('lab', 'recover', file)}` saves everything readable")
    note(s.notes)
    for request in s.requests:
        place = f", trial {request.trial} state {request.step}" if request.trial else ""
        out.print(f"{request.t:.1f} s{place}: {said(request)}")
    for topic, quantities in s.sensors.items():
        for name, q in quantities.items():
            out.print(f"{topic} {name}: {q.least:.6g} .. {q.greatest:.6g}, mean {q.mean:.6g}{unit_text(q.unit)}")
    for topic, stream in s.streams.items():
        if stream.channels > 1:
            out.print(f"{topic}: {stream.channels} channels carry this topic, counted together")
        if stream.restarts:
            times = "once" if stream.restarts == 1 else f"{stream.restarts} times"
            out.print(f"{topic} restarted {times}: its sample numbers jumped back, so losses at that moment are unknown")
    for topic, line in s.clocks.items():
        out.print(
            f"clock of {topic}: offset {line.offset:.6f} s, drift {line.drift * 1e6:.1f} ppm, delay above the minimum "
            f"{line.residual * 1e3:.2f} ms (p99 {line.residual_p99 * 1e3:.2f} ms)"
        )


POLLED = ("/pressure", "/spine", "/vacuum", "/valve")
"""Topics of instruments that are read at `poll` of rig.yaml."""


def _rig_of(file: Path) -> tuple[float, dict[str, float]]:
    """Speed of the rig's clock, and rates (Hz of rig time) by topic, from the attached rig.yaml; 1 and none without one."""
    try:
        rig = parse_yaml(attached(Recording.open(file, truncated=True), "rig.yaml"), "rig.yaml").data
        speed = _number(rig, "clock", "speed", unit="1") or 1.0
    except ConfigError:
        return 1.0, {}
    rates = {topic: _number(rig, "poll", unit="Hz") for topic in POLLED}
    rates |= dict.fromkeys(("/tip", "/tip/pose"), _number(rig, "instruments", "mocap", "rate", unit="Hz"))
    return speed, {topic: rate / speed for topic, rate in rates.items() if rate is not None}


def _number(data: object, *keys: str, unit: str) -> float | None:
    """A positive number within tables, in `unit`; None where there is none."""
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    try:
        value = to_si(str(data), unit)
    except UnitError:
        return None
    return value if 0 < value < math.inf else None


def said(request: Request) -> str:
    """A request as a person reads it."""
    if request.kind == "note":
        return f"note ({request.by}): {request.text}"
    return f"{request.kind} {'done, ' if request.done else ''}asked for by {request.by}"


def replayed(file: Path) -> tuple[ReplayComparison, str]:
    """Conclude every state of a recording again; the comparison with the live rows, and a digest of the rows."""
    recording = Recording.open(file)
    states = replay_states(recording)
    rows = [r.row.to_json() for r in states if r.row is not None]
    return hold_against(recording, states), hashlib.sha256("\n".join(rows).encode()).hexdigest()


def replay(files: Sequence[Path]) -> Result:
    """Whether the rows concluded from the samples equal those of the live run to the last bit; 1 when not."""
    comparisons = [(file, *replayed(file)) for file in without_torn(files)]

    def show() -> None:
        for file, result, digest in comparisons:
            name = f"{file}: " if len(comparisons) > 1 else ""
            for line in result.differences[:20]:
                out.print(f"{name}{line}")
            word = "bit-identical to the live run's" if result.equal else f"{len(result.differences)} differ from the live run's"
            out.print(f"{name}{result.replayed} rows recomputed, {word}; sha256 {digest}", soft_wrap=True)

    data = _by_file([
        (file, {"live": r.live, "replayed": r.replayed, "equal": r.equal, "sha256": digest, "differences": r.differences})
        for file, r, digest in comparisons
    ])  # fmt: skip
    return Result(data, show, 0 if all(result.equal for _, result, _ in comparisons) else 1)


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
            out.print(f"{file} is DAMAGED ({compared}); `{typed('lab', 'recover', file)}` saves everything readable")
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
    """Print what was kept of a recording and what was lost."""
    out.print(f"{r.target}: {sum(r.messages.values())} messages, {r.seconds_kept:.3f} s")
    if r.complete:
        out.print("nothing was lost")
        return
    out.print(f"lost: {r.seconds_lost:.3f} s; {r.holes} places, {r.bytes_skipped} bytes could not be read")
    for topic, n in r.lost.items():
        out.print(f"  {topic}: {n} messages are missing")
    if r.nameless:
        out.print(f"  {r.nameless} messages of topics without a description")
    for topic in r.schemaless:
        out.print(f"  {topic}: its schema is missing; its messages are kept without it")
    if r.oversized:
        out.print(f"left out: {r.oversized}")
    if not r.finished:
        ours = "up to 0.2 s of data" if r.library == LIBRARY else "the recorder's buffer"
        out.print(f"The recording ended abruptly: {ours} in memory was never written.")


FILES = option("files", nargs="+", type=Path, metavar="FILE")


def _states(run: RecordedRun | Info) -> str:
    """How many states were read, of those planned or, where that is not known, asked for."""
    return f"{run.rows} of {run.planned} planned" if run.planned else f"{run.rows} of {run.states}" if run.states else "no"


def continued(listed: Sequence[RecordedRun]) -> list[tuple[RecordedRun, RecordedRun]]:
    """Return each run that resumed another one, behind that one; `listed` is in the order of time."""
    last: dict[str, RecordedRun] = {}
    pairs: list[tuple[RecordedRun, RecordedRun]] = []
    for run in (run for run in listed if run.campaign):
        if run.campaign in last and not run.path.endswith(RECOVERED):
            pairs.append((last[run.campaign], run))
        last[run.campaign] = run
    return pairs


def runs(folder: Path, where: Sequence[str] = ()) -> Result:
    """List them, oldest first; `where`: KEY=VALUE of labels."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: is not a folder")
    try:
        said = [split(text) for text in where]
    except BadMessage as e:
        raise ConfigError(f"--where {e}") from e
    found = recorded(folder, said)
    return Result([run.to_dict() for run in found], partial(_show_runs, found))


def _show_runs(listed: Sequence[RecordedRun]) -> None:
    """Print runs, with those that continue others or are not whole."""
    for run in listed:
        spine = f", spine {', '.join(f'{100 * length:g}' for length in run.spines)} cm" if any(run.spines) else ""
        noted = f", {counted(run.notes, 'note')}" if run.notes else ""
        read = f"{run.protocol or 'no protocol'}{spine}, {_states(run)} states, {run.outcome}, {run.lost} lost{noted}"
        out.print(run.path, soft_wrap=True, style="bold")
        out.print(f"  {run.start[:19].replace('T', ' ')} UTC, {clock(run.duration)}, {read}", soft_wrap=True)
        if run.labels:
            out.print(f"  {', '.join(f'{k}={v}' for k, v in run.labels.items())}", soft_wrap=True)
    for before, after in continued(listed):
        out.print(f"{before.path}: continued in {after.path}", soft_wrap=True)
    for run in listed:
        if run.outcome == "unreadable":
            out.print(f"{run.path}: {run.detail}")
        elif run.outcome == "abrupt" and not run.detail:
            out.print(f"{run.path}: the recording was not finished; `lab recover` writes a complete file from its readable part")


VERBS = (
    Verb(
        "info",
        lambda a: info(a.files),
        options=(*READS, FILES),
        examples=("lab info runs/sweep.mcap", "lab info runs/*.mcap --json"),
        page="docs/explanations/recordings.md",
    ),
    Verb(
        "replay",
        lambda a: replay(a.files),
        options=(*READS, FILES),
        examples=("lab replay runs/sweep.mcap", "lab replay runs/*.mcap --json"),
        page="docs/explanations/recordings.md",
    ),
    Verb(
        "verify",
        lambda a: verify(a.file),
        options=(*READS, option("file", type=Path)),
        examples=("lab verify runs/sweep.mcap", "lab verify runs/sweep.mcap --json"),
        page="docs/explanations/recordings.md",
    ),
    Verb(
        "recover",
        lambda a: recover(a.file, a.out),
        options=(
            *READS,
            option("file", type=Path),
            path_option("--out", "FILE", "the new file (default: <name>-recovered.mcap beside the old one)"),
        ),
        examples=("lab recover runs/sweep.mcap", "lab recover runs/sweep.mcap --out saved.mcap"),
        page="docs/howto/resume.md",
    ),
    Verb(
        "runs",
        lambda a: runs(a.folder, a.where),
        options=(
            *READS,
            option("folder", type=Path),
            repeatable("--where", "KEY=VALUE", "only runs with this label: operator, specimen, or a tag (repeatable)"),
        ),
        examples=("lab runs runs", "lab runs runs --where operator=Ada"),
        page="docs/howto/campaign.md",
    ),
)
