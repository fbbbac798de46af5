"""Files of an answer of `lab.diagnose_model`: diagnosis.json and the page, in the words of the model's own causes."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.answer.headline import hypothesis_name, percent, stated, with_id
from diagnosis.any_model.answer import Answer, Experiment, Left
from recordings.own_files import replaced

from ..version import version_text
from .report import CALIBRATED, GIVEN, WITH_CAUSE, PageSection, Report

NAMES = {"as given": GIVEN, "calibrated": CALIBRATED, "with the cause": WITH_CAUSE}
"""Steps of an answer -> names of the models on every page."""
SMALL = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "s": (1e3, "ms"), "kg": (1e3, "g")}
"""Unit -> factor and unit in which a person reads a residual."""
LEAST_SHARE = 0.02
"""Share of the noise floor below which a tolerated cause does nothing."""
NONE_NEXT = "No candidates were given. Give inputs that could be measured next to see the most informative ones here."


def save(answer: Answer, folder: str | Path) -> Path:
    """Write diagnosis.json and diagnosis.html of an answer of `diagnose_model`; returns the page."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    write_json(answer, place / "diagnosis.json")
    return write(answer, place / "diagnosis.html", "The gap between model and data", "")


def write_json(answer: Answer, path: Path) -> None:
    """Write the answer as diagnosis.json has it."""
    replaced(path, json.dumps(answer.as_dict(), indent=1, allow_nan=False) + "\n")


def write(answer: Answer, path: Path, title: str, source: str) -> Path:
    """Write one offline page: the answer, how far the gap shrinks and what to measure next; the evidence; details folded."""
    from . import diagnosis_figures as draw  # takes as long to import as the rest of the page

    identifiers = f"Identifier: {' + '.join(answer.effects)}. " if answer.effects else ""
    first = answer.next_experiment[0] if answer.next_experiment else None
    next_step = "" if first is None else f"measure {f'{first.at}:' if isinstance(first.at, str) else 'at'} {inputs_of(first)}."
    report = Report(
        title, source, answer.headline, answer.doubts,
        f"{identifiers}Noise: {answer.noise_from}.", numbers(answer), (next_step, ""),
        f"{version_text()}. {answer.rows} rows.", answer.names.keys(),
    )  # fmt: skip
    report.section("The answer in full", folded=True).text(answer.statement)
    with tempfile.TemporaryDirectory() as place:
        _steps(report.section("The gap, step by step"), answer, Path(place))
        next_ = report.section("What to measure next")
        if first is None:
            next_.text(NONE_NEXT)
        next_.table(*proposals(answer))
        section = report.section("Evidence: which cause")
        section.figure(
            draw.posterior(answer.ranking, answer.cannot_tell_apart, answer.names, Path(place) / "posterior.svg"),
            "Probability of each hypothesis" + ("; *: see what cannot be told apart" if answer.cannot_tell_apart else ""),
        )
        section.table(*shares(answer))
        for group in answer.cannot_tell_apart:
            section.text(f"These data cannot distinguish: {', '.join(with_id(effect, answer.names) for effect in group)}.")
        if answer.goes_with:
            section.text(f"The error that no listed cause explains varies with {answer.goes_with}.")
        rows = [
            [size.key, f"{size.value:.4g} {size.unit}".rstrip(), f"{size.sd:.2g}", f"{size.nominal:.4g}",
             "" if size.certain else "could be nominal" if size.determined else "not determined by these data"]
            for size in answer.sizes if size.role == "size"
        ]  # fmt: skip
        report.section("How large the cause is").table(("parameter", "value", "standard error", "nominal", ""), rows)
        if answer.notes:
            report.section("What speaks against the answer").text(*answer.notes)
        rows = [[key, f"{value:.5g} {unit}".rstrip()] for key, (value, unit) in answer.calibration.items()]
        report.section("What calibration found", folded=True).table(("parameter", "value"), rows)
        return report.write(path)


def rms(by_output: Mapping[str, float], outputs: Mapping[str, str]) -> str:
    """Root mean square of outputs for a person; those of one unit are the components of one vector."""
    sizes = {unit: np.linalg.norm([by_output[name] for name, u in outputs.items() if u == unit]) for unit in outputs.values()}
    parts = [(size, *SMALL.get(unit, (1.0, unit))) for unit, size in sizes.items()]
    return ", ".join(f"{value * factor:.3g} {unit}".rstrip() for value, factor, unit in parts)


def numbers(answer: Answer) -> list[tuple[str, str, str]]:
    """Name, size and note of the numbers at the page's top."""
    return [
        (NAMES.get(s.step, s.step), rms((s.unseen or s.seen).by_output, answer.outputs),
         "one reading" if s.step not in NAMES else "rms, unseen rows" if s.unseen else "rms")
        for s in answer.steps
    ]  # fmt: skip


def steps(answer: Answer) -> tuple[tuple[str, ...], list[list[str]]]:
    """Head and rows of the table of each model's error."""

    def cell(left: Left | None) -> str:
        return "" if left is None else rms(left.by_output, answer.outputs)

    rows = [[NAMES.get(s.step, s.step), cell(s.seen), cell(s.unseen)] for s in answer.steps]
    return ("model", "in-sample, rms", "unseen rows, rms"), rows


def shares(answer: Answer) -> tuple[tuple[str, ...], list[list[str]]]:
    """Head and rows of a table of the causes: probability, how far each moves the outputs, and its role."""
    rows = []
    for effect, share in answer.budget.items():
        probability = sum(r.probability for r in answer.ranking if effect in r.effects)
        floor = answer.steps[-1].seen.by_output
        moves = rms(share, answer.outputs) if any(share[name] > LEAST_SHARE * floor[name] for name in floor) else ""
        role = "named" if effect in answer.effects else "tolerated" if moves else ""
        rows.append(
            [with_id(effect, answer.names), stated(probability, answer.limited and effect in answer.effects), moves, role]
        )
    rest = [(r.effects, r.probability) for r in answer.ranking if not r.effects or r.effects[0] not in answer.names]
    rows += [[hypothesis_name(effects, answer.names), stated(p), "", ""] for effects, p in rest]
    return ("cause", "probability", "moves the outputs beyond calibration by, rms", "role"), rows


def inputs_of(proposal: Experiment) -> str:
    """Settings, for a person."""
    return ", ".join(f"{k} = {v:.4g}" if isinstance(v, float) else f"{k} = {v}" for k, v in proposal.inputs.items())


def proposals(answer: Answer) -> tuple[tuple[str, ...], list[list[str]]]:
    """Head and rows of the table of what to measure next, most informative first."""
    rows = [
        [str(p.at), inputs_of(p), f"{p.squared_difference:.3g}", " from ".join(p.separates[:2])] for p in answer.next_experiment
    ]
    return ("candidate", "inputs", "squared difference of predictions, noise floors", "separates"), rows


def _steps(s: PageSection, answer: Answer, folder: Path) -> None:
    """Write each model's error, as a table and as residuals of every row."""
    from .figures import apart

    s.table(*steps(answer))
    closed = "" if answer.share_closed is None else f"; {percent(answer.share_closed)} % of the reducible gap is closed"
    s.text(f"Unseen: {answer.how}{closed}.")
    panels = [partial(_residuals, answer=answer, unit=unit) for unit in dict.fromkeys(answer.outputs.values())]
    s.figure(apart(panels, folder / "residuals.svg"), "Residual of each row by fits that did not see it; grey: noise floor")


def _residuals(axis: Any, answer: Answer, unit: str) -> None:
    """Draw the length of the residual of the outputs of one unit over the rows, before and after."""
    from .diagnosis_figures import BLUE, GREY
    from .figures import legend_below

    own = [i for i, u in enumerate(answer.outputs.values()) if u == unit]
    factor, shown = SMALL.get(unit, (1.0, unit))
    floor = [answer.steps[-1].seen.by_output[name] for name, u in answer.outputs.items() if u == unit]
    axis.axhspan(0, factor * np.linalg.norm(floor), color="0.9")
    for (step, residual), colour, mark in zip(answer.residuals.items(), (GREY, BLUE), "os", strict=False):
        length = np.linalg.norm(residual[:, own], axis=1) * factor
        axis.plot(np.arange(1, len(length) + 1), length, mark, ms=3, color=colour, label=NAMES[step])
    drawn = ", ".join(list(answer.outputs)[i] for i in own)
    axis.set(xlabel="row", ylabel=f"residual of {drawn}, {shown}".rstrip(", "), ylim=(0, None))
    legend_below(axis)
