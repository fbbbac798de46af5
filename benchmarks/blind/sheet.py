"""A score for people: a table on the screen."""

from __future__ import annotations

from rich.table import Table

from lab.console import styled

from .metrics import Interval
from .score import Score


def sheet(result: Score) -> Table:
    """The figures beside their targets."""
    table = Table(title=heading(result), title_justify="left")
    for column in ("figure", "found", "95 % interval", "cases", "target", ""):
        table.add_column(column, justify="left" if column in ("figure", "") else "right")
    for label, *cells, met in rows(result):
        mark = styled(met, {"met": "green", "missed": "red"}.get(met, ""))
        table.add_row(label, *cells, mark)
    return table


def heading(result: Score) -> str:
    """One line that says which set this is."""
    about = result.about
    world = f"cluttered at {float(about['clutter']):.0%}" if about.get("clutter") else "clean"
    chosen = f", after at most {result.after} experiments of its own choice" if result.after else ""
    data = f"data: {about.get('design')}{chosen}"
    return f"{result.name}: {len(result.cases)} cases, {world}, {data}"


def rows(result: Score) -> list[tuple[str, str, str, str, str, str]]:
    """Label, found, interval, cases, target, met or missed."""
    out = []
    for m in result.figures:
        if not m.found.n:
            continue
        aim = result.aims.get(m.key)
        met = "" if aim is None else ("met" if aim.met(m.found.value) else "missed")
        out.append((m.label, _number(m.found.value), _range(m.found), str(m.found.n), "" if aim is None else str(aim), met))
    return out


def _number(x: float) -> str:
    return f"{x:.2f}" if abs(x) < 100 else f"{x:.0f}"


def _range(i: Interval) -> str:
    return f"{_number(i.low)}..{_number(i.high)}"
