"""Judge times: period and gaps, clocks that were set, counters that overflow, rows without a time.

No time is made up. If a clock was set while rows continued at their period, later times are shifted by the step, with a question;
at a step of unknown length averages end, also with a question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from model.arrays import Array, Ints, Mask

EPOCH = (6e8, 4.2e9)
"""s since 1970, from 1989 to 2103."""
DAYS = ((36_526.0, 73_050.0, 25_569.0), (730_486.0, 767_010.0, 719_529.0))
"""Days as spreadsheets and as MATLAB count them: those of 2000 and of 2100, and that of 1970."""
DAY_STEP = 5e-4
"""Days from row to row below which such numbers are days: no clock in s that has run so long steps by as little."""
EPOCH_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
"""s of the units in which computers count time."""
LONG_STEP, MANY = 5.0, 200
"""Step and number of rows from which times without a unit are not in s."""
STEPS = {"ms": 5e3, "us": 5e6}
"""Step below which such times are in this unit."""
BETWEEN_RUNS = 60.0
"""s from the end of one run or file to the start of the next, where only each one's own time is known."""
FAR, LEAST_GAP = 10.0, 2.0
"""Periods, and s, beyond which a step is a gap: in less a robot does not go to another pressure, stay there and come back."""
RARE = (3, 0.02)
"""Number and share of steps up to which far ones are gaps; more of them are the period of rows that come in bursts."""
HALF_HOUR, LARGEST_CHANGE = 1800.0, 48
"""s by whole numbers of which clocks are set to another time zone or to summer time, and the largest such number: a day."""
AT_ONCE = 1.0
"""s that a clock may be off besides, and within which rows that are earlier than the one before came late."""
BITS = (16, 24, 31, 32)
"""Of counters, after whose largest number comes 0."""
TICKS = (1e-3, 1e-6)
"""s by which clocks of microcontrollers count, besides the unit of the column."""
MOST_FALLING = 0.5
"""Share of steps back beyond which rows stand in the reverse order of time."""
BATCH = 5
"""Rows beyond which earlier ones that follow each other are no late messages, but those of a clock that was set back."""


@dataclass
class Timeline:
    """The rows of a file that have a time, in the order of time."""

    t: Array
    """(n,) s, never falling."""
    rows: Ints
    """(n,) from 0, in the file."""
    run: Ints
    """(n,) of runs whose times begin again, from 0."""
    notes: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    """Questions for a person."""


def period(t: Array) -> float:
    """s from row to row, or from burst to burst where rows come in bursts; 0 of times that are all equal."""
    return _usual(np.diff(t[np.isfinite(t)]))


def _usual(steps: Array) -> float:
    steps = steps[steps > 0]
    if not len(steps):
        return 0.0
    usual = float(np.median(steps))
    far = steps[steps > FAR * usual]
    return _usual(far) if len(far) > max(RARE[0], RARE[1] * len(steps)) else usual


def unit_of_steps(times: Array) -> str:
    """The unit of times of which nothing says it, where their steps are too long for s; else empty."""
    times = times[np.isfinite(times)]
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if step < LONG_STEP or len(times) <= MANY or times[0] >= EPOCH[0]:
        return ""
    return next((unit for unit, most in STEPS.items() if step < most), "ns")


def seconds(values: Array, unit: str, factor: float) -> Array:
    """Times in s. Numbers without a unit, or too large for theirs, are dates where some unit of `EPOCH_UNITS`, or days, makes one
    of them: then s since 1970; else they count in `factor` s."""
    typical = float(np.nanmedian(np.abs(values)))
    if not unit or typical * factor >= EPOCH[1]:
        unit_s = next((s for s in EPOCH_UNITS if EPOCH[0] <= typical * s < EPOCH[1]), None)
        day_of_1970 = 0.0
        steps = np.diff(values[np.isfinite(values)])
        if not unit and len(steps) and float(np.median(np.abs(steps))) < DAY_STEP:
            day_of_1970 = next((day for first, last, day in DAYS if first <= typical < last), 0.0)
            unit_s = 86_400.0 if day_of_1970 else unit_s
        if unit_s is not None:
            start = float(values[np.isfinite(values)][0])  # subtracted first, or counts of ns lose their last digits
            return (values - start) * unit_s + (start - day_of_1970) * unit_s
    return values * factor


def gaps(t: Array) -> Mask:
    """(n,) rows that follow the row before by far more than the period."""
    return np.asarray(np.diff(t, prepend=t[:1]) > max(FAR * period(t), LEAST_GAP))


def timeline(t: Array, tick: float, place: Callable[[int], str], goes_on: Mask | None = None) -> Timeline:
    """Put the times (n,) s of a file in order, and note or ask about what is wrong with them: rows without a time, late rows,
    clocks that were set or overflow, gaps. `tick` (s) is the unit of the column, `place` names a row (from 0); `goes_on`, where
    states are means of several rows, so that gaps matter: (n,) rows in which no column begins another trial."""
    rows = np.flatnonzero(np.isfinite(t))
    line = Timeline(t[rows], rows, np.zeros(len(rows), np.int64))
    if absent := len(t) - len(rows):
        first = place(int(np.argmax(~np.isfinite(t))))
        line.notes.append(f"{absent} of {len(t)} rows have no time (first: {first}); they were skipped")
    if len(rows) > 1 and (np.diff(line.t) < 0).mean() > MOST_FALLING:
        line.notes.append("times decrease from row to row: the file is read backwards")
        line.t, line.rows = line.t[::-1], line.rows[::-1]
    _continue(line, tick, place)
    late = line.t < np.maximum.accumulate(line.t)
    if late.any():
        first = place(int(line.rows[np.argmax(late)]))
        line.notes.append(f"{int(late.sum())} rows are earlier than the row before (first: {first}); they were sorted by time")
        order = np.argsort(line.t, kind="stable")
        line.t, line.rows, line.run = line.t[order], line.rows[order], line.run[order]
    if goes_on is not None:
        line.questions += _far(line, place, goes_on[line.rows])
    return line


def _continue(line: Timeline, tick: float, place: Callable[[int], str]) -> None:
    """Shift times behind a step (overflow, clock set, another run) so that they go on; a run begins where they begin again."""
    steps, usual = np.diff(line.t), period(line.t)
    small = np.abs(steps[np.abs(steps) < max(FAR * usual, LEAST_GAP)])
    regular = bool(len(small)) and float(np.percentile(small, 95)) <= 2 * usual
    tolerance = max(AT_ONCE, min(0.5 * usual, 5 * AT_ONCE))
    shift, run_rows, run_start = np.zeros(len(line.t)), [], float(line.t[0]) if len(line.t) else 0.0
    for i in np.flatnonzero((steps < 0) | (steps > max(FAR * usual, LEAST_GAP))).tolist():
        before, after, excess = float(line.t[i]), float(line.t[i + 1]), float(steps[i]) - usual
        where, set_by = place(int(line.rows[i + 1])), HALF_HOUR * round(excess / HALF_HOUR)
        of_clock = regular and set_by and abs(excess - set_by) <= tolerance and abs(set_by) <= LARGEST_CHANGE * HALF_HOUR
        # forward, only on the hour (else that time may have passed); back, not to where the run began (else a run begins)
        on_the_hour = abs((before + usual + tolerance) % (2 * HALF_HOUR)) <= 2 * tolerance
        # s after which a counter that fell by `excess`, its period aside, begins again
        sizes = [2.0**bits * unit for bits in BITS for unit in (tick, *TICKS)]
        if modulus := next((s for s in sizes if abs(excess + s) <= 3 * usual < 0.1 * s and np.ptp(line.t) <= s), 0.0):
            shift[i + 1 :] += modulus
            line.notes.append(f"{where}: the count of time overflows ({before:.6g} s to {after:.6g} s) and is continued")
        elif of_clock and (on_the_hour if excess > 0 else abs(after - run_start) > tolerance):
            shift[i + 1 :] -= set_by
            line.questions.append(
                f"{where}: the clock goes {'forward' if excess > 0 else 'back'} by {abs(set_by) / 3600:g} h between two rows, "
                f"which follow each other every {usual:.3g} s: taken for a clock that was set (summer time, time zone), and "
                "later rows are read as going on; if that time did pass, write them to a file of their own"
            )
        elif steps[i] < -max(AT_ONCE, 3 * usual):
            run_rows.append(i + 1)
            shift[i + 1 :] += BETWEEN_RUNS - steps[i]
            if abs(after - run_start) > tolerance:
                line.questions.append(
                    f"{where}: times jump back by {-steps[i]:.4g} s, but not to their beginning: was the clock set? A new trial "
                    "begins there. If a new run begins there, put its rows into a separate file"
                )
            run_start = after
        elif steps[i] < 0 and regular and _set_back(line.t, i, usual):
            shift[i + 1 :] += usual - steps[i]
            line.questions.append(
                f"{where}: the clock goes back by {usual - steps[i]:.3g} s while rows go on every {usual:.3g} s: taken for a "
                "clock that was set; later rows are continued"
            )
    if run_rows:
        i = run_rows[0]
        times = "once" if len(run_rows) == 1 else f"{len(run_rows)} times"
        line.notes.append(
            f"times begin again {times}, first in {place(int(line.rows[i]))} ({line.t[i - 1]:.6g} s to {line.t[i]:.6g} s): each "
            f"time another trial begins, {BETWEEN_RUNS:g} s later"
        )
    line.t, line.run = line.t + shift, np.searchsorted(np.array(run_rows), np.arange(len(line.t)), side="right")


def _set_back(t: Array, i: int, usual: float) -> bool:
    """Whether rows go on from behind row i, whose next is earlier, without a leap back to where they were."""
    ahead = np.flatnonzero(t[i + 1 :] >= t[i])
    end = i + 1 + int(ahead[0]) if len(ahead) else len(t)
    return end - i - 1 > BATCH and float(np.diff(t[i + 1 : end + 1]).max(initial=0.0)) <= 3 * usual


def _far(line: Timeline, place: Callable[[int], str], goes_on: Mask) -> Iterator[str]:
    """Ask about the first gap within a trial, and about times that are too coarse to tell how long anything was held."""
    usual, steps = period(line.t), np.diff(line.t)
    gap_rows = np.flatnonzero((gaps(line.t) & goes_on)[1:] & (np.diff(line.run) == 0)) + 1
    if len(gap_rows):
        first, more = int(gap_rows[0]), f" ({len(gap_rows)} such steps)" if len(gap_rows) > 1 else ""
        half_hours = steps[first - 1] / HALF_HOUR
        whole = abs(half_hours - round(half_hours)) * HALF_HOUR <= 2 * max(usual, AT_ONCE)
        yield (
            f"{place(int(line.rows[first]))}: a gap of {steps[first - 1]:.5g} s"
            f"{' (whole hours or half hours)' if whole else ''} in rows that follow each other every {usual:.3g} s{more}: states "
            "end there. Was the logger stopped, or its clock set?"
        )
    if len(steps) and (steps == 0).mean() > 0.5 and usual >= LEAST_GAP:
        yield (
            f"{int((steps == 0).sum())} of {len(line.t)} rows have the time of the row before, and times step by {usual:.3g} s: "
            "durations are only that accurate. Is there a finer time column?"
        )
