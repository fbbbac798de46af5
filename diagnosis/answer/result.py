"""The answer, as frozen data and as diagnosis.json ("diagnosis/1"). Lengths are mm where the name says so, otherwise SI."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, TypeAdapter

from model.actuators import Chambers, Tendons, Words
from model.shown import Shown
from recordings.json_text import read_json

from ..criticism.stage_errors import StageError
from ..errors import BadCase
from ..findings import Finding, Severity
from ..judgement import SIZE_CERTAIN_SD
from .decision import SCHEMA, Decision

FACTORS = ("spine_length", "pressure", "axis", "branch", "time", "arc_length")
"""What the gap is split by; with stiffness trials also by "stiffness": specimen and spine length."""
STAGES = ("actuation", "material", "structure", "load", "boundary", "measurement")

Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""A number; null in diagnosis.json where it is not finite."""
Role = Literal["named", "present", "unseen"]
Conclusion = Literal["cause", "one of several", "stage", "outside", "none", "noise", "too little data"]
"""The verdict as deep as the data carry it; see `verdict`."""


@dataclass(frozen=True)
class Data:
    """What was diagnosed."""

    rows: int
    trials: int
    channels: tuple[str, ...]
    noise_mm: Number
    """White noise of a tip coordinate, or of stiffness trials alone of a deflection, mm."""
    noise_from: str
    quoted_pressure: Number = math.nan
    """Pa, at which sizes that grow with pressure are stated."""


@dataclass(frozen=True)
class Cell:
    """The gap in one part of the data."""

    value: float | str
    """Spine length m, pressure Pa, axis, branch, time s, arc length m, or specimen."""
    rmse_mm: float
    bias_mm: float
    """Mean of measured minus model: along x for all factors but axis."""
    n: int
    low95_mm: Number
    high95_mm: Number
    significant: bool
    """Above the noise floor, with the share of false alarms over all cells held to 5 %."""


@dataclass(frozen=True)
class Concentrated:
    """The part of the states in which most of what calibration leaves lies."""

    factor: str
    """p1, p2 .. Pa, trial, branch (-1 unload, 1 load), spine_length m, or tip_mass kg."""
    above: bool
    """The states above the limit, or the others."""
    limit: Number
    """Highest value of the factor in the lower part."""
    n: int
    rmse_mm: Number
    others_mm: Number
    """Root mean square in the other states."""


@dataclass(frozen=True)
class Locate:
    """Where the gap lies."""

    gap_rmse_mm: Number
    noise_floor_mm: Number
    significant: bool
    by: Mapping[str, tuple[Cell, ...]]
    stage: Mapping[str, float]
    of: Literal["tip", "deflection"] = "tip"
    """The gap's quantity: the tip's position, or, of stiffness trials alone, the deflection: a missed force over the specimen's
    stiffness. Next to tips, stiffness trials stand in `by` under stiffness, in mm of deflection."""
    concentrated: Concentrated | None = None


@dataclass(frozen=True)
class Origin:
    """A number that the area factor may stand for."""

    name: str
    """Key of robot.yaml, or `pressures`."""
    factor: float
    """By which it would have to be another to make all of it."""
    probability: float
    """That it makes most of it, as uncertain as the numbers are."""


@dataclass(frozen=True)
class Alike:
    """An effect that alone, the area factor as given, would do what the calibrated one does."""

    parameter: str
    """EFFECT.PARAMETER."""
    value: float
    unit: str
    left_mm: float
    """rms of the tip that it leaves, in-sample, with the tolerances fitted."""


@dataclass(frozen=True)
class SetUp:
    """A number that the calibrated model moves within a tolerance of robot.yaml."""

    name: str
    """Of a vector, one component: frame_turn.z."""
    value: float
    sd: float
    """In robot.yaml, as `value` in `unit`."""
    unit: str
    mm: float
    """rms by which it moves what the gap is of."""


@dataclass(frozen=True)
class Calibration:
    """The area factor that the calibrated model has, mean over the states."""

    area_factor: float
    given: float
    """That of robot.yaml; of a simulator that takes the rod's place, the one with which the rod comes nearest to it."""
    modulus: float = 1.0
    """The modulus that goes with it, as a ratio to that of robot.yaml: not 1 where it was calibrated first."""
    origins: tuple[Origin, ...] = ()
    """Most probable first."""
    at_bound: bool = False
    """Whether the fit reached the limit of the area factor, and would go beyond."""
    alike: tuple[Alike, ...] = ()
    """The one that leaves least first."""
    determined: bool = False
    """Whether the data tell area factor and modulus apart; else only their ratio."""
    body_mm: float = 0.0
    """rms by which both move what the gap is of."""
    set_up: tuple[SetUp, ...] = ()
    """Those that move it by `OUTSTANDING_FLOORS` noise floors or more, most first."""

    @property
    def stiffness(self) -> float:
        """Stiffness of the body, as a ratio to that of robot.yaml; with which the given area factor bends it as far, where the
        data do not tell the two apart."""
        return self.modulus if self.determined else self.modulus * self.given / self.area_factor


@dataclass(frozen=True)
class Simulator:
    """The simulator that takes the rod's place as a baseline, beside the rod of robot.yaml; rms of the tip."""

    name: str
    area_factor: float
    """With which the rod comes nearest to it."""
    differs_mm: float
    """From that rod."""
    beyond_calibration_mm: float
    """What an area factor leaves of that."""
    share: float
    """Of the difference, 0 to 1, that the measurements do not show: fitted beside the leading hypothesis."""
    not_measured_mm: float
    """That share of it, beyond calibration."""
    of_robot: Number = math.nan
    """Area factor of robot.yaml."""


@dataclass(frozen=True)
class Value:
    """A parameter with its standard deviation."""

    value: float
    sd: float
    unit: str
    determined: bool = True
    """Whether the data say more of it than was assumed before."""
    bound: str = ""
    """The end of its range, low or high, at which it stands, and from which its interval extends to one side; else empty."""

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, one-sided at a bound."""
        away = SIZE_CERTAIN_SD * self.sd
        return self.value - away * (self.bound != "low"), self.value + away * (self.bound != "high")

    @property
    def note(self) -> str:
        """What a table states next to the number; empty if the data determine it."""
        return ", ".join(["not determined"] * (not self.determined) + ["at its bound"] * bool(self.bound))


@dataclass(frozen=True)
class FittedRobot:
    """The robot with what is named and nothing else, as `lab fit --with` writes it: fitted to all states, tolerances included."""

    effects: tuple[str, ...]
    parameters: Mapping[str, Value]
    """area_factor, EFFECT.PARAMETER, the tolerances."""
    left_mm: float
    """rms of the tip, in-sample."""
    calibrated_mm: float
    """The same of the calibrated robot without what is named."""


@dataclass(frozen=True)
class Ranked:
    """One hypothesis."""

    effects: tuple[str, ...]
    """Empty for none, `("unknown",)` for a cause outside the catalogue."""
    probability: float
    log_evidence: Number  # NaN of a cause outside the catalogue, and of what was not fitted by itself or not to its end
    heldout_rmse_mm: float | None
    """Not computed for hypotheses of little weight."""
    parameters: Mapping[str, Value]
    limited: bool = False
    """As `Decision.limited`."""
    in_words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Effect -> what it makes of each actuator, with its standard deviation and without, where its parameters do not say it."""


@dataclass(frozen=True)
class Attribute(Decision):
    """Which effect."""

    credible_set: tuple[tuple[str, ...], ...] = ()
    ranking: tuple[Ranked, ...] = ()
    cannot_tell_apart: tuple[tuple[str, ...], ...] = ()
    stage_errors: tuple[StageError, ...] = ()
    """Largest first: where the readings ask for an error that no effect of the catalogue makes."""
    conclusion: Conclusion | None = None
    """None in answers of earlier versions."""
    rivals: tuple[str, ...] = ()
    """Effects of the 95 % set beside what is named."""
    doubts: tuple[str, ...] = ()
    """Why what is named with a high probability is not certain."""
    missing: tuple[str, ...] = ()
    """What the table lacks to name a cause."""
    at_places: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    """Of those `relatives` that were fitted with a size at each place: place, such as chambers 3 and 4 -> size there."""

    @property
    def p_too_small(self) -> str:
        """Probability of `too_small` in brackets; empty where it is not ranked."""
        return next((f" (p = {r.probability:.2f})" for r in self.ranking if r.effects == self.too_small), "")


@dataclass(frozen=True)
class Carries:
    """What one effect carries of the gap once the robot is calibrated anew."""

    effect: str
    role: Role
    """present: too little to be a cause; unseen: these data could not show it at its plausible size."""
    mm: float
    """rms over the states, of what the gap is of; median."""
    low95_mm: Number
    high95_mm: Number


@dataclass(frozen=True)
class LengthShrink:
    """The gap at one spine length, on data the fit did not see."""

    value: float
    before_mm: float
    after_mm: float
    n: int


@dataclass(frozen=True)
class Shrink:
    """How far the gap shrinks, on data the fit did not see."""

    how: str
    before_mm: float
    after_mm: float
    floor_mm: float
    share_closed: float | None
    """1 - (after^2 - floor^2) / (before^2 - floor^2); negative where it gets worse, None where nothing can be closed."""
    ci95: tuple[float, float] | None
    by_spine_length: tuple[LengthShrink, ...]


@dataclass(frozen=True, kw_only=True)
class Holdout(Shrink):
    """The same on a campaign that the fit never sees."""

    states: int
    trials: int
    unsolved: int
    """States left out because one of the models has no equilibrium there."""
    hypothesis: tuple[str, ...]
    """The effects that `after_mm` has; none where no effect leads."""
    named: bool
    """Whether the diagnosis names them as the cause; else they are only what comes nearest."""
    verdict: Literal["confirmed", "contradicted", "open"]
    """confirmed: at least half of the gap is closed, surely; contradicted: it surely grows; open: neither."""


StepName = Literal["calibration", "simulator", "cause", "tolerances", "regular", "irregular", "noise"]


@dataclass(frozen=True)
class Step:
    """What one step takes of the gap."""

    step: StepName
    effect: str | None
    """The cause; None of other steps."""
    mm: float
    """Decrease of the rms; all steps add up to the gap as given."""
    low95_mm: Number
    high95_mm: Number
    left_mm: float
    """rms after it."""


@dataclass(frozen=True)
class Waterfall:
    """The whole gap, step by step."""

    how: str
    """What each state was predicted without."""
    n: int
    """Number of states that every step predicts."""
    given_mm: float
    steps: tuple[Step, ...]
    lost: int = 0
    """Number of the others: some fit without them finds no equilibrium there."""


@dataclass(frozen=True)
class Proposal:
    """An experiment that would tell candidates apart."""

    id: str
    do: str
    separates: tuple[tuple[str, ...], ...]
    expected_bits: float
    cost_min: float
    protocol: Mapping[str, Any] = field(default_factory=dict)
    """Protocol parameters as `lab run` takes them."""
    hands_min: float = 0.0
    """Of the time, minutes of a person's work before it can run."""
    channels: tuple[str, ...] = ()
    """Channels that are measured in addition to those of the campaign."""


@dataclass(frozen=True)
class Change:
    """What changed since an earlier campaign, most probable first."""

    statement: str
    ranking: tuple[tuple[tuple[str, ...], float], ...]
    """Effects and their probability; () that nothing changed."""
    sizes: Mapping[str, float]
    """Fitted change of the parameters of the leading hypothesis, in their units."""
    effects: tuple[str, ...] = ()
    """The reported change; () if it is too probable that nothing changed."""


@dataclass(frozen=True)
class Diagnosis(Shown):
    """The whole answer."""

    statement: str
    data: Data
    locate: Locate
    attribute: Attribute
    shrink: Shrink | None
    next_experiment: tuple[Proposal, ...]
    findings: tuple[Finding, ...] = ()
    """What could not be concluded and why, what was done, and what speaks against the answer."""
    detail: Mapping[str, Any] = field(default_factory=dict)
    """What the figures of the report need beyond the contract."""
    budget: tuple[Carries, ...] = ()
    """Largest first within named, present and unseen."""
    waterfall: Waterfall | None = None
    """On unseen states; None where nothing can be left out, or it was not asked for."""
    holdout: Holdout | None = None
    """On a campaign that is not fitted, where one was given."""
    change: Change | None = None
    """Since a reference campaign, where one was given."""
    calibration: Calibration | None = None
    """The calibration; None in answers of earlier versions."""
    simulator: Simulator | None = None
    """What takes the rod's place; None: nothing does."""
    fitted: FittedRobot | None = None
    """The robot with what is named; None where nothing is, or another simulator takes the rod's place."""
    headline: str = ""
    """The conclusion in at most 20 plain words; empty in answers of earlier versions."""

    def texts(self, *severities: Severity) -> list[str]:
        """Texts of the findings of these severities, but for one that the statement begins with."""
        return [f.text for f in self.findings if f.severity in severities and not self.statement.startswith(f.text)]

    @property
    def lines(self) -> list[str]:
        """What the command prints before its tables, and `print` in Python: what to settle first, headline, statement, notes."""
        first = [f"settle first: {text}" for text in self.texts("critical")]
        notes = [f"  note: {text}" for text in self.texts("warning", "note")]
        change = "" if self.change is None else self.change.statement
        return [*filter(None, [*first, self.headline, self.statement, *notes, change])]

    @property
    def concerns(self) -> list[str]:
        """Texts of all findings, which stand in diagnosis.json too."""
        return self.texts(*get_args(Severity))

    @property
    def names(self) -> Mapping[str, str]:
        """Effect -> plain name."""
        return dict(self.detail["names"])

    @property
    def words(self) -> Words:
        """How people speak of the robot's actuators; of chambers in answers of earlier versions."""
        return (Tendons if self.detail.get("actuators") == Tendons.words.kind else Chambers).words

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.headline or self.statement}>"

    def __str__(self) -> str:
        return "\n".join([*self.lines, *(f"Next: {x.do} ({x.cost_min:.0f} min)." for x in self.next_experiment[:1])])

    def _columns(self) -> dict[str, Any]:
        ranking = self.attribute.ranking
        return {
            "hypothesis": [" + ".join(r.effects) or "none" for r in ranking],
            "probability": [r.probability for r in ranking],
            "tip error on unseen states, rms [mm]": [r.heldout_rmse_mm for r in ranking],
        }

    def to_json(self) -> str:
        """The text of diagnosis.json."""
        plain = json.loads(_adapter().dump_json(self, fallback=lambda array: array.tolist()))
        return json.dumps({"schema": SCHEMA, **plain, "concerns": self.concerns}, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Diagnosis:
        """Read diagnosis.json; raises `BadCase` when it is not one.

        >>> Diagnosis.from_json("{}")
        Traceback (most recent call last):
        ...
        diagnosis.errors.BadCase: not a diagnosis/1 file: KeyError 'schema'
        """
        try:
            data = read_json(text)
            if data["schema"] == SCHEMA:
                return _adapter().validate_python(data)
        except (KeyError, TypeError, ValueError) as error:
            raise BadCase(f"not a {SCHEMA} file: {type(error).__name__} {' '.join(str(error).split())[:200]}") from error
        raise BadCase(f"schema {repr(data['schema'])[:80]}, this version reads {SCHEMA!r}")


@cache
def _adapter() -> TypeAdapter[Diagnosis]:
    return TypeAdapter(Diagnosis)
