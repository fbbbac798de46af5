"""The answer about any model, as frozen data and as plain data for JSON ("diagnosis/1" where its keys apply)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from model.shown import Shown

from ..answer.decision import SCHEMA, Decision
from ..arrays import Array
from ..judgement import CAUSE_PROBABILITY


@dataclass(frozen=True)
class Size:
    """One parameter of a cause."""

    key: str
    effect: str
    value: float
    sd: float
    unit: str
    nominal: float
    determined: bool
    """Whether the data say more of it than was assumed before."""
    certain: bool
    """Whether it differs from nominal by more than its error."""
    role: str = "size"

    def __str__(self) -> str:
        return f"{self.key} = {self.value:.4g} ± {self.sd:.2g} {self.unit}".rstrip().removesuffix(" 1")


@dataclass(frozen=True)
class Ranked:
    """One hypothesis."""

    effects: tuple[str, ...]
    """Empty for none, `("unknown",)` for a cause outside of the list."""
    probability: float
    parameters: tuple[Size, ...]


@dataclass(frozen=True)
class Left:
    """Root mean square residuals."""

    floors: float
    """Over all outputs, in noise floors: standard deviations of the noise."""
    by_output: Mapping[str, float]
    """Of each output, in its unit."""


@dataclass(frozen=True)
class Step:
    """What one model leaves."""

    step: str
    """as given, calibrated, with the cause, noise floor."""
    seen: Left
    """On the rows it was fitted to."""
    unseen: Left | None
    """On rows that its fits did not see."""


@dataclass(frozen=True)
class Experiment:
    """What to measure next."""

    at: int | str
    """Row of the candidates, counted from 0, or group where the model integrates over groups."""
    squared_difference: float
    """Expected squared difference between the predictions of the hypotheses at the sizes that they may have, in noise floors
    squared."""
    separates: tuple[str, ...]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    """Of that row; the first of a group."""


@dataclass(frozen=True, kw_only=True)
class Answer(Decision, Shown):
    """Which cause explains the gap between a model and its data."""

    ranking: tuple[Ranked, ...]
    """Most probable first."""
    calibration: Mapping[str, tuple[float, str]]
    """Calibrated values with what is named, and units."""
    cannot_tell_apart: tuple[tuple[str, ...], ...]
    steps: tuple[Step, ...]
    how: str
    """How rows were left out for `Step.unseen`."""
    share_closed: float | None
    """Of the calibrated gap above the noise, on unseen rows; None where nothing is named or there is nothing to close."""
    goes_with: str
    """What an error outside of the list varies with."""
    next_experiment: tuple[Experiment, ...]
    noise_from: str
    doubts: tuple[str, ...]
    """Why the verdict is not certain; its probability is then at most `judgement.DOUBTED_PROBABILITY`."""
    notes: tuple[str, ...]
    rows: int
    outputs: Mapping[str, str]
    """Name -> unit."""
    names: Mapping[str, str]
    """Every cause as a sentence."""
    budget: Mapping[str, Mapping[str, float]]
    """Cause, named or tolerated -> rms by which it moves each output beyond what calibration does; largest first."""
    corrected: Callable[[], Mapping[str, float]] = field(repr=False, compare=False)
    """Returns `values`, which take a fit of their own."""
    residuals: Mapping[str, Array] = field(compare=False)
    """Step -> (rows, outputs) measured minus predicted, of fits that did not see the row; NaN where not measured."""

    @cached_property
    def values(self) -> Mapping[str, float]:
        """Every parameter, with all causes as large as the data and their plausible sizes make them: what corrects most."""
        return self.corrected()

    @property
    def certain(self) -> bool:
        """Whether the cause is certain: probable, and nothing is doubted."""
        return self.verdict == "effect" and self.probability >= CAUSE_PROBABILITY and not self.doubts

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Parameters of what is named."""
        return next((r.parameters for r in self.ranking if r.effects == self.effects), ())

    @property
    def headline(self) -> str:
        """The conclusion in one short sentence."""
        p = f"({self.p})"
        if self.verdict == "effect":
            return f"{'Cause: ' if self.certain else 'Most like: '}{' and '.join(self.names[e] for e in self.effects)} {p}"
        return f"No cause: nothing stands out of the noise {p}" if self.verdict == "none" else f"A cause outside of the list {p}"

    @property
    def statement(self) -> str:
        """The conclusion, its sizes and how far the gap closes."""
        parts = [self.headline + "."]
        if self.verdict == "effect" and self.sizes:
            parts.append(f"{', '.join(map(str, self.sizes))}.")
        if self.verdict == "unknown" and self.goes_with:
            parts.append(f"What no listed cause explains varies with {self.goes_with}.")
        if self.verdict == "unknown" and self.relatives:
            parts.append(f"Most like: {', '.join(self.relatives)}.")
        path = [f"{s.step} {(s.unseen or s.seen).floors:.3g}" for s in self.steps]
        parts.append(f"Root mean square residual in noise floors: {', '.join(path)} ({self.how}).")
        parts += [f"Not certain: {why}." for why in self.doubts]
        parts += [f"These data cannot tell apart: {', '.join(group)}." for group in self.cannot_tell_apart]
        return " ".join(parts)

    def __repr__(self) -> str:
        return f"<Answer: {self.headline}>"

    def _columns(self) -> dict[str, Any]:
        sizes = ["; ".join(map(str, r.parameters)) for r in self.ranking]
        names = [" + ".join(r.effects) or "none" for r in self.ranking]
        return {"hypothesis": names, "probability": [r.probability for r in self.ranking], "parameters": sizes}

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON: the keys of diagnosis.json where they apply, residuals in each output's unit."""
        plain = asdict(self)
        of_attribute = ("verdict", "effects", "probability", "ranking", "cannot_tell_apart", "doubts", "outside", "relatives")
        attribute = {k: plain[k] for k in of_attribute}
        rest = {k: plain[k] for k in ("steps", "how", "share_closed", "budget", "next_experiment", "calibration", "notes")}
        data = {"rows": self.rows, "outputs": plain["outputs"], "noise_from": self.noise_from}
        words = {"schema": SCHEMA, "headline": self.headline, "statement": self.statement}
        return {**words, "data": data, "attribute": attribute, "values": dict(self.values), **rest}
