"""The page of a diagnosis: the verdict in a sentence first, then pictures, and every figure's numbers behind it."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.answer import sentences
from diagnosis.answer.experiments import to_apply
from diagnosis.answer.headline import for_people, hypothesis_name, percent, plain_name, stated, with_id
from diagnosis.answer.result import Diagnosis, Holdout
from diagnosis.criticism.stage_errors import in_words
from diagnosis.judgement import RIVAL_WORTH_SEPARATING
from model.actuators import Words
from recordings.campaign.labels import RECORD
from recordings.file.reader import Recording

from ..files.inputs import Case
from ..next_step import FIRST, command, nothing_next
from ..version import version_text
from . import diagnosis_figures as draw
from .figures import apart, quantities
from .figures import numbers as sensor_numbers
from .figures import sensors as draw_sensors
from .report import CALIBRATED, GIVEN, NEAREST, WITH_CAUSE, CommandCell, PageSection, Report

MISFIT_LABELS = {
    "excess_scatter": "excess scatter of repeats, factor",
    "outlier_trial": "trial that the others predict worst",
    "law_error_gain": "log evidence gained by large model-form errors",
}
"""Keys of `detail.misfit` in diagnosis.json -> labels on the page."""


def write(d: Diagnosis, case: Case, inputs: Sequence[Path], path: Path, protocols: Path | None = None) -> Path:
    """Write one offline page: the answer, where it shows and what to do first; evidence next; details folded.

    `inputs` are what `case` was read from, `protocols` the folder with the proposed experiments."""
    report = Report(
        "The gap between model and robot", ", ".join(map(str, inputs)), d.headline, [f"{x}." for x in d.texts("critical")],
        small(d), gap_numbers(d), _first_step(d, protocols), origin(case.robot.name, inputs), d.names.keys(),
    )  # fmt: skip
    length, table, spine = case.robot.length, case.table, case.robot.spine is not None
    report.section("The answer in full", folded=True).text(d.statement)
    tips = d.locate.of == "tip"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        _steps(report.section("The gap, step by step"), d, length, folder)
        if tips:
            _where(report.section("Where it is"), d, folder)
        _next(report.section("What to do next"), d, protocols)
        _which(report.section("Evidence: which cause"), d, folder)
        if d.holdout is not None:
            _held_out(report.section("Evidence: a campaign that was not fitted"), d.holdout, sentences.held_out(d), spine)
        if (change := d.change) is not None:
            rows = [[hypothesis_name(effects, d.names) if effects else "nothing", stated(p)] for effects, p in change.ranking[:6]]
            report.section("What changed since the reference").text(change.statement).table(("changed", "probability"), rows)
        if against := d.texts("warning", "note"):
            report.section("What speaks against the answer").text(*(line[:1].upper() + line[1:] for line in against))
        if d.detail["sizes"]:
            _sizes(report.section("How large the cause is", folded=True), d)
        factors = f"{'spine length, ' if spine else ''}{d.words.pressure}, branch and time"
        _by_factor(report.section(f"The gap by {factors}", folded=True), d, spine)
        if "stiffness" in d.detail:
            _pushed(report.section("Stiffness trials", folded=tips), d, folder)
        if tips:
            alike(report.section("Which effects these data can distinguish", folded=True), d)
        _misfit(report.section("Stages and misfit diagnostics", folded=True), d)
        if quantities(table):
            own = report.section("What the lab's own sensors measured", folded=True)
            how = "Each state's mean; bars: one standard deviation of the samples averaged. The model does not use them."
            own.figure(apart(draw_sensors(table, d.words), folder / "sensors.svg"), how)
            own.table(*sensor_numbers(table))
        return report.write(path)


def origin(robot: str, inputs: Sequence[Path]) -> str:
    """Where an answer comes from: software, robot, and each file with its SHA-256 and who recorded it."""
    files = [path / name for path in inputs if path.is_dir() for name in ("robot.yaml", "trials.csv")]
    files += [path for path in inputs if not path.is_dir()]
    parts = []
    for file in filter(Path.is_file, files):
        with file.open("rb") as content:
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        labels = Recording.open(file).metadata.get(RECORD, {}) if file.suffix == ".mcap" else {}
        said = "".join(f", {name} {labels[name]}" for name in ("operator", "specimen") if name in labels)
        parts.append(f"{file.name} sha256 {digest[:16]}{said}")
    return f"{version_text()}. Robot: {robot}. Read: {'; '.join(parts)}."


def gap_numbers(d: Diagnosis) -> list[tuple[str, str, str]]:
    """Name, size and note of the numbers at the page's top: the gap by each model (mm rms, unseen or in-sample), noise floor."""
    digits, basis = 2 if d.locate.of == "tip" else 3, "in-sample" if d.waterfall is None else "unseen states"
    if d.waterfall is None:
        rows = [(CALIBRATED, d.locate.gap_rmse_mm)]
    else:
        rows = [(GIVEN, d.waterfall.given_mm), (CALIBRATED, d.waterfall.steps[0].left_mm)]
        if d.shrink is not None and d.attribute.verdict == "effect":
            rows.append((WITH_CAUSE, d.shrink.after_mm))
    robot = [] if d.fitted is None else [("the robot of lab fit --with", f"{d.fitted.left_mm:.{digits}f} mm", "rms, in-sample")]
    floor = ("noise floor", f"{d.locate.noise_floor_mm:.{digits}f} mm", "repeats of a state")
    alone = sentences.closed_alone(d.waterfall, d.shrink)
    notes = {} if alone is None else {WITH_CAUSE: f", and tolerances of other effects; the cause alone closes {percent(alone)} %"}
    return [*((name, f"{mm:.{digits}f} mm", f"rms, {basis}{notes.get(name, '')}") for name, mm in rows), *robot, floor]


def explained(d: Diagnosis) -> str:
    """Name of the model with the leading hypothesis in every figure and table."""
    return WITH_CAUSE if d.attribute.verdict == "effect" else NEAREST


def small(d: Diagnosis) -> str:
    """Identifiers of what is named, to type into commands, and what the probability rests on."""
    named = f"Identifier: {' + '.join(d.attribute.effects)}. " if d.attribute.effects else ""
    present = sentences.also_present(d, lambda effect: plain_name(effect, d.names), 2)
    sure = sentences.limited(d) or f"Probability p: {d.detail['calibrated_on']}"
    return f"{present and present + ' '}{named}{sure}. Gap: error of the {d.locate.of}."


def _first_step(d: Diagnosis, protocols: Path | None) -> tuple[str, str]:
    if not d.next_experiment:
        text = nothing_next(d)
        return text[0].lower() + text[1:], ""
    first = d.next_experiment[0]
    text = f"{first.do} ({first.cost_min:.0f} min)"
    if not d.words.by_rig:
        return f"{text}: {to_apply(first.protocol, d.words)}; import the table that you measure.", ""
    return f"{text}.", command(first, protocols)


STEPS = {
    "calibration": "calibration: one {area_factor}, set-up fitted",
    "simulator": "the simulator replaced by the rod",
    "tolerances": "tolerances of every other effect",
    "regular": "systematic residual",
    "irregular": "unsystematic residual above the noise floor",
    "noise": "noise floor (repeatability)",
}
"""Steps of the waterfall -> labels; a cause has its own name."""


def _steps(s: PageSection, d: Diagnosis, length: float, folder: Path) -> None:
    """Write the waterfall as figure and table, and the share closed; `length`: m, the robot's."""
    w = d.waterfall
    if w is None:
        s.text("A single trial: none can be left out of the fit, so the gap on unseen data is unknown.")
        return
    with_numbers = {"calibration": f"{STEPS['calibration']} and the numbers calibrated first"}
    labels = {**STEPS, **(with_numbers if "first_calibration" in d.detail else {})}
    steps = {step: d.words.fill(label) for step, label in labels.items()}
    s.figure(
        draw.waterfall(w, [plain_name(x.effect, d.names) if x.effect else steps[x.step] for x in w.steps], length, folder),
        f"Error of the {d.locate.of}, mm rms over {w.n} of {w.n + w.lost} states, each predicted by fits that did not see it "
        f"({w.how}). Each bar is the error that the step removes; whiskers: 95 % interval, by bootstrap over trials, causes "
        "added in every order.",
    )
    model = "model" if d.simulator is None else d.simulator.name
    rows = [[f"{model}, {GIVEN}", "", "", f"{w.given_mm:.2f}"]]
    for x in w.steps:
        name = with_id(x.effect, d.names) if x.effect else steps[x.step]
        rows.append([name, f"{x.mm:z.2f}", f"{x.low95_mm:z.2f} .. {x.high95_mm:z.2f}", f"{x.left_mm:z.2f}"])
    s.table(("step", "removes, mm rms", "95 %", "remaining, mm rms"), rows)
    if origins := sentences.stands_for(d.calibration, d.words):
        s.text(f"{origins}.")
    if d.shrink is not None:
        closed = "no gap above the noise floor" if d.shrink.share_closed is None else f"{percent(d.shrink.share_closed)} %"
        ends = d.shrink.ci95
        interval = "" if ends is None else f" (95 %: {percent(ends[0])} .. {percent(ends[1])} %)"
        best = d.detail["best_hypothesis"]
        explanation = hypothesis_name(best, d.names) if best else "tolerances alone"
        itself = sentences.by_itself(sentences.closed_alone(w, d.shrink) if d.attribute.verdict == "effect" else None)
        share = "Share of the reducible gap left by calibration (as mean squares above the noise floor) closed on unseen states"
        s.text(f"{share} with {explanation}: {closed}{interval}{itself}.")


def _held_out(s: PageSection, h: Holdout, statement: str, spine: bool) -> None:
    """Write how both models do on a campaign that was not fitted; `spine`: by spine length, too."""
    s.text(statement)
    s.text(
        "Both models were fitted to the diagnosed campaign alone; differences between trials, such as re-growing and re-jamming, "
        f"are set to their expected value. The interval is a bootstrap over the trials of this "
        f"campaign{', within each spine length' if spine else ''}."
    )
    rows = [
        [f"{100 * x.value:.0f} cm", str(x.n), f"{x.before_mm:.2f}", f"{x.after_mm:.2f}"]
        for x in (h.by_spine_length if spine else ())
    ]
    rows.append(["all", str(h.states), f"{h.before_mm:.2f}", f"{h.after_mm:.2f}"])
    s.table(("spine", "states", f"{CALIBRATED}, mm", f"{WITH_CAUSE}, mm"), rows)


def _where(s: PageSection, d: Diagnosis, folder: Path) -> None:
    """Write where the gap is: shapes of the worst states, the map of all states, and loops over pressure."""
    _shapes(s, d, folder)
    s.figure(
        draw.gap_map(d, explained(d), folder),
        f"Gap of all states by {d.words.actuators} {d.words.inflated}{_lengths(d)} and {d.words.pressure}, in-sample, on one "
        "colour scale. Models are those of an average trial; the numbers at the top of the page also fit differences between "
        "trials",
    )
    s.figure(
        draw.loops(d, explained(d), folder),
        f"Gap along and across the direction in which these {d.words.actuators} bend the robot, up and down, in-sample; grey: "
        "noise floor",
    )


def _lengths(d: Diagnosis, joint: str = ", ") -> str:
    return f"{joint}spine length" if len(d.locate.by.get("spine_length", ())) > 1 else ""


def _by_factor(s: PageSection, d: Diagnosis, spine: bool) -> None:
    """Write the calibrated gap by each level of each factor, with those above the noise floor marked."""
    rows = []
    for name, c in ((name, c) for name, cells in d.locate.by.items() for c in cells if spine or name != "spine_length"):
        level = f"{d.words.fill(in_words(name))} {_at(name, c.value, d.words)}"
        ends = f"{c.low95_mm:.2f} .. {c.high95_mm:.2f}"
        rows.append([level, str(c.n), f"{c.rmse_mm:.2f}", ends, "*" if c.significant else ""])
    s.table(("where", "states", f"{CALIBRATED}, in-sample, mm rms", "95 %", ""), rows)
    s.text("*: above the noise floor, with false alarms held to 5 % of all rows.")


def _pushed(s: PageSection, d: Diagnosis, folder: Path) -> None:
    """Write how far the models miss the force of stiffness trials, as a deflection."""
    stiffness = d.detail["stiffness"]
    floor = "noise floor" if stiffness["floor_from_repeats"] else "noise floor as assumed: nothing was repeated"
    s.figure(
        draw.pushes(stiffness, explained(d), folder / "pushes.svg"),
        f"Force error over the specimen's stiffness, as a deflection, in-sample; grey: {floor}",
    )
    mm = stiffness["waterfall_mm"]
    rows = [
        [name, f"{mm[key]:.3f}", f"{mm[f'unseen: {key}']:.3f}" if f"unseen: {key}" in mm else ""]
        for key, name in (("as given", GIVEN), ("calibrated", CALIBRATED), ("explained", explained(d)))
    ]
    s.table(
        ("model", "deflection error in-sample, mm rms", "unseen, mm rms"), [*rows, [floor, f"{stiffness['floor_mm']:.3f}", ""]]
    )


def _at(factor: str, value: float | str, words: Words) -> str:
    """A level of a factor as a person reads it."""
    unit, scale, digits = {
        "spine_length": ("cm", 100.0, 0), "pressure": (words.unit, 1 / words.pascal, words.digits), "time": ("s", 1.0, 0),
        "arc_length": ("cm", 100.0, 0),
    }.get(factor, ("", 1.0, 0))  # fmt: skip
    return value if isinstance(value, str) else f"{scale * value:.{digits}f} {unit}"


def _which(s: PageSection, d: Diagnosis, folder: Path) -> None:
    """Write the evidence for the cause: unseen states, probability of each hypothesis, and what each effect moves."""
    if "given" in d.detail["states"]:
        s.figure(
            draw.unseen_tips(d, explained(d), folder),
            "Measured tip and three models on the way up, along the bending direction, on unseen states: each is predicted by "
            f"fits that did not see it. Below: tip error of the models {CALIBRATED} and {explained(d)}, in any direction; grey: "
            "noise floor",
        )
    s.figure(
        draw.posterior(d.attribute.ranking, d.attribute.cannot_tell_apart, d.names, folder / "posterior.svg"),
        f"Probability of each hypothesis ({d.detail['calibrated_on']})"
        + ("; *: these data cannot distinguish it from another" if d.attribute.cannot_tell_apart else ""),
    )
    if d.budget:
        words = {"named": "named", "present": "also present", "unseen": "invisible in these data"}
        rows = [
            [with_id(c.effect, d.names), f"{c.mm:.2f}", f"{c.low95_mm:.2f} .. {c.high95_mm:.2f}", words[c.role]] for c in d.budget
        ]
        s.table(("effect", d.words.fill("moves the tip beyond {an_area_factor} by, mm rms"), "95 %", ""), rows)
    rows = [
        [hypothesis_name(r.effects, d.names), stated(r.probability, r.limited), f"{r.log_evidence:.1f}".replace("nan", ""),
         "" if r.heldout_rmse_mm is None else f"{r.heldout_rmse_mm:.2f}"]
        for r in d.attribute.ranking
    ]  # fmt: skip
    s.table(("hypothesis", "probability, by all fits", "log evidence of one fit, in-sample", "unseen states, mm"), rows)


def _misfit(s: PageSection, d: Diagnosis) -> None:
    """Write the probability of a cause by stage, errors of free form that gain evidence, and numbers of the misfit."""
    stages = sorted(d.locate.stage.items(), key=lambda x: -x[1])
    s.table(("stage of the chain", "probability of a cause there"), [[name, f"{p:.2f}"] for name, p in stages])
    if d.attribute.stage_errors:
        s.table(
            ("stage with an error of free form", "varies with", "log evidence gained"),
            [[e.stage, d.words.fill(in_words(e.dependence)), f"{e.gain:.1f}"] for e in d.attribute.stage_errors],
        )
    found = d.detail["misfit"]
    rows = [[MISFIT_LABELS[key], "none" if found[key] is None else f"{found[key]:.3g}"] for key in MISFIT_LABELS if key in found]
    s.table(("misfit diagnostic", "value"), rows)


def _sizes(s: PageSection, d: Diagnosis) -> None:
    """Write the size of what is named as numbers, and the push of each actuator against the mean."""
    s.table(("size", "median", "90 %", "bounds"), [_size(x, d) for x in d.detail["sizes"]])
    for each in d.detail["by_actuator"]:
        mean = float(np.mean(each["factor"]))
        rows = [[str(k), f"{100 * (f / mean - 1):+.0f} %"] for k, f in enumerate(each["factor"], 1)]
        s.table((d.words.actuator, f"{d.words.pushes}, against the mean"), rows)


def _size(x: Mapping[str, Any], d: Diagnosis) -> list[str]:
    """A row of the table of sizes, in a person's units; the logarithm of a factor as the factor."""

    def number(value: float) -> tuple[str, str]:
        size, unit = for_people(value, x["unit"], d.words)
        return f"{size:.3g}", unit

    ends = ["unbounded" if x[end] is None else number(x[end])[0] for end in ("low90", "high90", "low", "high")]
    median = " ".join(number(x["median"])).rstrip() if x["determined"] else "not determined by these data"
    return [with_id(x["name"], d.names), median, f"{ends[0]} .. {ends[1]}", f"{ends[2]} .. {ends[3]}"]


def _shapes(s: PageSection, d: Diagnosis, folder: Path) -> None:
    """Write the shapes of the states with the largest error, or why there are none."""
    states = d.detail["shapes"]
    if not states:
        why = "Another simulator takes the rod's place" if d.simulator is not None else "The model has no equilibrium"
        s.text(f"{why} in the measured states, so there is no shape to show.")
        return
    s.figure(
        draw.shapes(states, explained(d), folder, d.words),
        f"States with the largest error by either model, one for each group of {d.words.actuators}{_lengths(d, ' and ')}, "
        "in-sample; mm, base frame",
    )
    names = [draw.state_name(x, d.words).replace("\n", ", ") for x in states]
    missed = [[_point(x["measured_tip"]), _miss(x, "calibrated"), _miss(x, "explained")] for x in states]
    rows = [[name, *cells] for name, cells in zip(names, missed, strict=True)]
    s.table(("state", "measured tip, mm", f"{CALIBRATED}, off by, mm", f"{explained(d)}, off by, mm"), rows)


def _point(metres: Sequence[float]) -> str:
    return "(" + ", ".join(f"{1e3 * x:z.1f}" for x in metres) + ")"


def _miss(state: Mapping[str, Any], model: str) -> str:
    missed = np.subtract(state["measured_tip"], state[model]["tip"])
    return f"{1e3 * float(np.linalg.norm(missed)):.2f} {_point(missed)}"


def alike(s: PageSection, d: Diagnosis) -> None:
    """Write which effects these data would confuse or cannot show; separation[i][j]: T of taking effect j for i, i for none."""
    detail = d.detail["distinguishability"]
    effects, tied, separation = detail["effects"], detail["tied_below"], detail["separation"]
    seen = [i for i in range(len(effects)) if separation[i][i] >= tied]
    pairs = sorted(
        (separation[a][b], effects[a], effects[b])
        for k, i in enumerate(seen)
        for j in seen[k + 1 :]
        for a, b in [min((i, j), (j, i), key=lambda way: separation[way[0]][way[1]])]
        if separation[a][b] < tied
    )
    s.text(
        f"T is the chi-square lost if the second effect is fitted where the first acts, at its fitted size if it is probable, "
        f"else at its usual one. Below {tied:g} these data mistake the first for the second, though not always the second for "
        f"the first. An effect with T below {tied:g} against no effect is invisible in these data."
    )
    s.table(("effect", "taken for", "T"), [[*(with_id(e, d.names) for e in pair), f"{t:.1f}"] for t, *pair in pairs])
    hidden = [with_id(effects[i], d.names) for i in range(len(effects)) if i not in seen]
    s.text(f"Invisible effects: {', '.join(hidden)}." if hidden else "Every effect is visible.")


def _next(s: PageSection, d: Diagnosis, protocols: Path | None) -> None:
    """Write the proposed experiments with the command for each, or why there are none."""
    if not d.next_experiment:
        s.text(nothing_next(d))
        return
    shown = d.next_experiment[:FIRST]
    if not any(p.separates for p in shown):
        s.text(f"{_rivals(d)} Each experiment tests the answer in new states.")
    by_rig, named = d.words.by_rig, lambda one: hypothesis_name([] if one == "none" else one.split(" + "), d.names)
    if protocols is None:
        s.text(f"With the option --protocols next, lab diagnose writes these {'protocols' if by_rig else 'states'} to files.")
    rows = [
        [p.do, "; ".join([f"{p.expected_bits:.2f}", *(f"separates {' from '.join(map(named, x))}" for x in p.separates[:3])]),
         f"{p.cost_min:.0f}", CommandCell(command(p, protocols)) if by_rig else to_apply(p.protocol, d.words)]
        for p in shown
    ]  # fmt: skip
    s.table(("experiment", "bits", "minutes", "command" if by_rig else "states to apply"), rows)


def _rivals(d: Diagnosis) -> str:
    """Which hypotheses remain that no experiment separates by itself."""
    named = ("unknown",) if d.attribute.verdict == "unknown" else d.attribute.effects
    others = [r for r in d.attribute.ranking if r.effects != named and r.probability > RIVAL_WORTH_SEPARATING]
    if not others:
        return "No other hypothesis is probable."
    rivals = ", ".join(f"{hypothesis_name(r.effects, d.names)} (p = {r.probability:.2f})" for r in others[:3])
    return f"Also possible: {rivals}. None of these experiments is expected to decide between them by itself."
