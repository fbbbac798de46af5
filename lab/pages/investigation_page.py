"""The page of an investigation: how certain it became, what was done, and how each prediction came out."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from diagnosis.answer.sentences import hypothesis_name
from diagnosis.inference.posterior import UNKNOWN
from diagnosis.investigate import Investigation, Judged, Round

from .diagnosis_report import hypothesis, names
from .figures import GREY, STYLE, colours, save
from .report import Report, Section


def write(found: Investigation, path: Path, source: str, answer: str) -> Path:
    """Write one offline page; `answer` is the name of the page of the last diagnosis beside it."""
    report = Report(
        "An investigation", f"{time.strftime('%Y-%m-%d %H:%M')}, {source}", _lead(found), ids=names(found.answer).keys()
    )
    with tempfile.TemporaryDirectory() as place:
        section = report.section("How certain it became")
        if len(found.rounds) > 1:
            section.figure(
                _drawn(found, Path(place) / "rounds.svg"),
                "Probability of each hypothesis after each diagnosis, over the minutes spent on experiments",
            )
        section.table(("after", "minutes", "most probable", "p", "bits gained"), _rounds(found))
        for number, r in enumerate(found.rounds, 1):
            if r.foretold is not None:
                _experiment(report.section(f"Experiment {number}: {r.foretold.proposal.do}"), r)
        if found.rounds[-1].refused:
            section = report.section("What was not done")
            section.table(("experiment", "why"), [[id, why] for id, why in found.rounds[-1].refused.items()])
        report.section("The answer in full").text(
            f"{found.answer.statement} All of it, with figures: {answer}, in the same folder."
        )
        return report.write(path)


def _lead(found: Investigation) -> str:
    experiments = sum(r.foretold is not None for r in found.rounds)
    number = {0: "no experiment", 1: "one experiment"}.get(experiments, f"{experiments} experiments")
    before, after = found.rounds[0].diagnosis.attribute, found.answer.attribute
    was = _plain(before.ranking[0].effects, found) if before.ranking else "nothing"
    said = f"After {number} and {found.rounds[-1].minutes:g} min"
    if after.verdict == "unknown":
        head = f"{said} the cause lies outside the catalogue with probability {after.probability:.2f}."
    else:
        head = f"{said}: {_plain(after.effects, found)} with probability {after.probability:.2f}"
        outside = next((r.probability for r in after.ranking if r.effects == UNKNOWN), 0.0)
        head += f"; outside the catalogue with {outside:.2f}." if outside > after.probability else "."
    first = f" Before: {was}, {before.ranking[0].probability:.2f}." if experiments and before.ranking else ""
    return f"{head}{first} It ended because {_reason(found.ended)}."


def _reason(ended: str) -> str:
    return "the answer is settled" if ended == "settled" else ended


def _plain(effects: Sequence[str], found: Investigation) -> str:
    return hypothesis_name(effects, names(found.answer), ids=False)


def _rounds(found: Investigation) -> list[list[str]]:
    out, after, gained = [], "the campaign", ""
    for r in found.rounds:
        a = r.diagnosis.attribute
        first = a.ranking[0]
        out.append([after, f"{r.minutes:g}", hypothesis(first.effects, found.answer), f"{first.probability:.2f}", gained])
        if r.foretold is not None:
            after, gained = r.foretold.proposal.do, f"{r.bits:.2f}"
    return out


def _experiment(section: Section, r: Round) -> None:
    assert r.foretold is not None
    p = r.foretold.proposal
    section.text(
        f"{p.expected_bits:.2f} bits were expected from it and {r.bits:.2f} gained, for about {p.cost_min:g} min. "
        "The predictions were written down before it ran."
    )
    if not r.judged:
        return
    if r.unforeseen:
        section.text(
            "None of the hypotheses foretold what was read: something is at work here that none of them has, "
            "or the robot is not what it was."
        )
    section.table(("hypothesis", "probability before", "missed by, mm rms", "p of so far off", "bits against the best"),
                  [_judged(j, r) for j in r.judged])  # fmt: skip


def _judged(j: Judged, r: Round) -> list[str]:
    before = next((x.probability for x in r.diagnosis.attribute.ranking if x.effects == j.effects), 0.0)
    chance = f"{j.p_value:.2g}{' (failed)' if j.failed else ''}"
    return [hypothesis(j.effects, r.diagnosis), f"{before:.2f}", f"{j.rms_mm:.2f}", chance, f"{j.bits + 0.0:.1f}"]


def _drawn(found: Investigation, path: Path) -> Path:
    """Lines of probability over minutes; the experiments stand above."""
    probability = [{x.effects: x.probability for x in r.diagnosis.attribute.ranking} for r in found.rounds]
    highest = {h: max(p.get(h, 0.0) for p in probability) for h in {h for p in probability for h in p}}
    shown = sorted((h for h in highest if highest[h] > 0.01), key=lambda h: -highest[h])[:6]
    minutes = [r.minutes for r in found.rounds]
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(5.2, 3.4 + 0.2 * len(shown)), layout="constrained")
        for h, colour, mark in zip(shown, colours(len(shown)), "os^Dv*", strict=False):
            y = [p.get(h, 0.0) for p in probability]
            axis.plot(minutes, y, marker=mark, color=colour, label=_plain(h, found))
        for r, there in zip(found.rounds, minutes[1:], strict=False):
            if r.foretold is not None:
                middle = (r.minutes + there) / 2
                axis.annotate(r.foretold.proposal.id, (middle, 1.03), ha="center", fontsize=8, annotation_clip=False)
                axis.axvspan(r.minutes, there, color=GREY, alpha=0.12, lw=0)
        axis.axhline(0.95, color="0.4", lw=0.8, ls="--")
        axis.set_ylim(0, 1)
        axis.set_yticks(np.linspace(0, 1, 6))
        axis.set_xlabel("minutes of experiments")
        axis.set_ylabel("probability")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=8)
        return save(figure, path)
