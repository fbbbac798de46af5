"""The whole path on a small campaign whose tips come from the forward model itself plus noise.

That is an inverse crime: it shows that the path is whole and the numbers are consistent, not how good the diagnosis is.
"""

import itertools
import json
import re
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import truncnorm
from threadpoolctl import threadpool_info

from diagnosis.answer.locate import _parts
from diagnosis.answer.result import FACTORS, STAGES, Attribute, Diagnosis
from diagnosis.answer.sentences import SCATTERS, ramps_assumed
from diagnosis.answer.size import cut_quantile
from diagnosis.data.noise_components import PRESSURE
from diagnosis.diagnose import Options, diagnose
from diagnosis.errors import BadCase
from diagnosis.fit_effects import fit_effects
from diagnosis.inference.executor import Executor
from diagnosis.inference.prepare import prepare, table_columns
from diagnosis.judgement import LEAST_BITS
from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.effects.tolerance import BY_TRIAL, REPEATS
from model.robot import Uncertainty
from recordings.trials import ORIENTATION, Table
from tests.diagnosis.small_campaigns import FEW, RIVALS, SOME, Catalogue, answer, campaign, few_and_all, measured, quick
from tests.diagnosis.test_case import ROBOT, Measured, case, row, states
from tests.diagnosis.test_edits import FINGER, columns, read
from tests.diagnosis.test_edits import campaign as marked
from tests.model.effects.test_similarity import similar


@few_and_all
def test_an_effect_is_named_with_its_size_and_the_gap_closes_on_unseen_data(catalogue: Catalogue) -> None:
    d = answer(catalogue)
    assert d.attribute.verdict == "effect" and d.attribute.effects == ("chamber_azimuth",)
    size = d.attribute.ranking[0].parameters["chamber_azimuth.angle"]
    assert size.value == pytest.approx(np.radians(8), abs=4 * size.sd)
    assert d.shrink is not None and d.shrink.share_closed is not None and d.shrink.share_closed > 0.9
    assert d.locate.significant
    x, y, z = d.locate.by["axis"]
    assert y.significant and y.rmse_mm > 10 * max(x.bias_mm, z.rmse_mm)


@few_and_all
def test_the_json_holds_the_contract_and_reads_back(catalogue: Catalogue) -> None:
    text = answer(catalogue).to_json()
    d = json.loads(text)
    assert d["schema"] == "diagnosis/1"
    assert set(d["data"]) == {"rows", "trials", "channels", "noise_mm", "noise_from", "quoted_pressure"}
    assert set(d["locate"]["by"]) == set(FACTORS) and set(d["locate"]["stage"]) == set(STAGES)
    assert {"gap_rmse_mm", "noise_floor_mm", "significant"} <= set(d["locate"])
    assert set(d["attribute"]) == {f.name for f in fields(Attribute)}
    ranked = d["attribute"]["ranking"][0]
    assert {"effects", "probability", "log_evidence", "heldout_rmse_mm", "parameters", "limited", "in_words"} == set(ranked)
    assert all(set(v) == {"value", "sd", "unit", "determined", "bound"} for v in ranked["parameters"].values())
    assert {"how", "before_mm", "after_mm", "floor_mm", "share_closed", "ci95", "by_spine_length"} == set(d["shrink"])
    assert all({"do", "separates", "expected_bits", "cost_min"} <= set(p) for p in d["next_experiment"])
    assert sum(r["probability"] for r in d["attribute"]["ranking"]) <= 1 + 1e-9
    again = Diagnosis.from_json(text)
    assert again.to_json() == text and again.budget == answer(catalogue).budget
    assert again.budget[0].effect == "chamber_azimuth" and again.budget[0].role == "named"
    assert {c.role for c in again.budget} <= {"named", "present", "unseen"}
    with pytest.raises(BadCase, match="diagnosis/1"):
        Diagnosis.from_json(text.replace("diagnosis/1", "diagnosis/9"))


@few_and_all
def test_the_same_campaign_gives_the_same_text_and_linear_algebra_has_one_thread_meanwhile(catalogue: Catalogue) -> None:
    threads = set[int]()

    def progress(_step: str, _share: float) -> None:
        threads.update(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

    watched = diagnose(campaign(), Options(executor=Executor(progress=progress), catalogue=catalogue))
    assert threads == {1}
    assert answer(catalogue).to_json() == watched.to_json()


@few_and_all
def test_nothing_is_named_where_nothing_was_repeated(catalogue: Catalogue) -> None:
    d = diagnose(measured(1, 3, FEW, chamber_azimuth__angle=np.radians(8)), quick(catalogue))
    assert d.attribute.verdict == "unknown" and d.attribute.effects == ()
    assert "no state was repeated" in d.data.noise_from
    assert any("no cause is named" in c for c in d.concerns) and d.attribute.conclusion == "too little data"


def test_a_law_of_geometry_is_not_taxed_for_an_error_that_it_cannot_have() -> None:
    turned = measured(3, 5, frame_misalignment__x=0.009, frame_misalignment__z=0.006)
    turned = replace(turned, robot=turned.robot.model_copy(update={"uncertainty": Uncertainty(frame_shift=0.5e-3)}))
    spec, rivals = CATALOGUE["frame_misalignment"], SOME | {e: CATALOGUE[e] for e in ("body_modulus", "area_moment")}
    verdicts = [
        diagnose(turned, quick({**rivals, spec.id: replace(spec, exact=exact)})).attribute.effects for exact in (True, False)
    ]
    # Else the tolerance of the cameras, which has no law error, takes the turn up at six of its standard deviations.
    assert verdicts == [(spec.id,), ()]


def test_a_stated_uncertainty_of_the_chambers_azimuths_explains_what_lies_within_it() -> None:
    uncertain = Uncertainty(azimuths=np.radians(8))
    drawn_roughly = replace(campaign(), robot=campaign().robot.model_copy(update={"uncertainty": uncertain}))
    assert "chamber_azimuth" not in diagnose(drawn_roughly, quick()).attribute.effects


def test_stated_uncertainties_of_pressure_readings_explain_their_gains_and_zeros() -> None:
    true = measured(2, 5, FEW)
    gains = dict(zip((f"p{k}" for k in range(1, 10)), np.linspace(0.95, 1.05, 9), strict=True))
    read = replace(true, table=true.table.replaced({p: true.table[p] / gain - 1e3 for p, gain in gains.items()}))
    gauged = replace(read, robot=read.robot.replace(uncertainty=Uncertainty(pressure_gain=0.03, pressure_zero=1e3)))
    exact, unstated, stated = (fit_effects(case, []) for case in (true, read, gauged))
    assert unstated.left_mm > 1.3 * exact.left_mm and stated.left_mm < 1.1 * exact.left_mm


def test_experiments_are_proposed_within_limits_with_a_catalogue_that_knows_no_wrong_pressures() -> None:
    one, case = {"chamber_azimuth": CATALOGUE["chamber_azimuth"]}, measured(2, 1, FEW, chamber_azimuth__angle=np.radians(8))
    limit = 0.998 * float(case.table.pressures.max())
    found = diagnose(replace(case, robot=case.robot.replace(max_pressure=limit)), Options(quantify=False, catalogue=one))
    assert found.attribute.effects == ("chamber_azimuth",) and min(x.expected_bits for x in found.next_experiment) >= LEAST_BITS
    every = [x for e in found.next_experiment for x in e.protocol["pressures"]]
    assert max(every) == limit and all(x in (limit, float(f"{x:.3g}")) for x in every)


WARM = """
import gc
from numba.core.dispatcher import Dispatcher
from diagnosis.diagnose import Options, diagnose
from model.effects import CATALOGUE
from model.warm_up import warm_up
from tests.diagnosis.small_campaigns import FEW, measured

if __name__ == "__main__":
    campaign = measured(2, 2, FEW)
    warm_up()

    def known():
        ours = (d for d in gc.get_objects() if isinstance(d, Dispatcher) and d.__module__.startswith("model."))
        return {d.__name__: d.signatures for d in ours if d.signatures}

    before = known()
    some = {id: CATALOGUE[id] for id in ("rest_shape", "viscoelastic", "spine_slip", "chamber_azimuth")}
    diagnose(campaign, Options(catalogue=some, experiments=False))
    assert before and known() == before, (before, known())
"""


def test_after_warming_up_a_whole_diagnosis_asks_for_no_kernel_that_is_not_ready() -> None:
    subprocess.run([sys.executable, "-c", WARM], check=True, cwd=Path(__file__).parents[2])


def test_one_weak_chamber_of_nine_is_named_by_number() -> None:
    rng, rows = np.random.default_rng(4), []
    for trial, (repeat, chamber) in enumerate(itertools.product((1, 2), range(9)), 1):
        plan = [(0.0, "load"), (100e3, "load"), (200e3, "load"), (100e3, "unload")]
        made = [row(trial, step, 0.0, p, branch, repeat) for step, (p, branch) in enumerate(plan, 1)]
        rows += [replace(r, pressures=tuple(max(r.pressures) * (c == chamber) for c in range(9))) for r in made]
    table = table_columns(states(case(rows))[0])
    weak = {**table, "p2": 0.85 * table["p2"]}
    forward = ForwardModel(ROBOT, design_from_columns(ROBOT, weak), "one", {})
    tips = forward.predict(np.zeros(len(forward.parameters))).reshape(-1, 3) + 0.3e-3 * rng.normal(size=(len(rows), 3))
    told = case([replace(r, tip=tuple(tip)) for r, tip in zip(rows, tips.tolist(), strict=True)])
    some = {e: CATALOGUE[e] for e in ("chamber_gain", "chamber_azimuth", "base_tilt", "precurvature", "pressure_offset")}
    found = diagnose(told, quick(some))
    assert found.attribute.effects == ("chamber_gain",)
    assert "a gauge or regulator of one chamber" in "; ".join(found.texts("note"))
    assert re.search(r"hamber 2 pushes 1[3-7] ± . % less than the others", found.headline), found.headline


def test_regulators_that_lag_are_told_from_a_body_that_creeps() -> None:
    names = ("pressure_lag", "viscoelastic", "pressure_offset")
    case = measured(2, 3, FEW, pressure_lag__constant=2.0)
    found = diagnose(case, quick({name: CATALOGUE[name] for name in names})).attribute
    assert found.effects == ("pressure_lag",) and found.probability > 0.9
    assert found.ranking[0].parameters["pressure_lag.constant"].value == pytest.approx(2.0, abs=0.1)
    unknown, words = np.full(len(case.table), np.nan), ROBOT.actuators.words
    named = [CATALOGUE[e] for e in (*names, "time_offset")]
    ramps = np.abs(np.diff(case.table.pressures, axis=0, prepend=0.0)).max(axis=1) / 10e3
    bare = case.table.replaced({"rate": unknown, "t": np.cumsum(case.table["hold"] + ramps)})
    pauses = bare.replaced({"t": bare["t"] + np.cumsum(5.0 * (np.arange(len(bare)) % 4))})
    tables = [case.table, bare, bare.replaced({"hold": unknown}), pauses]
    told = [list(ramps_assumed(states(replace(case, table=t))[0], named, words)) for t in tables]
    assert told[:2] == [[], []] and [f.values["effect"] for f in told[2]] == [e.name(words) for e in (named[0], named[3])]
    assert all("does not state; assumed: rate 25 kPa/s" in t[0].text for t in told[2:])
    assert design_from_columns(ROBOT, bare.values).rate == pytest.approx(np.full(len(bare), 10e3))  # from times and holds


def test_each_marker_has_its_own_readings_however_many_there_are() -> None:
    robot = FINGER.model_copy(update={"markers": tuple(0.01 * k for k in range(1, 12))})
    p = prepare(robot, marked(read(robot, repeats=1)), {"base_tilt": CATALOGUE["base_tilt"]})
    number = np.array([float(channel[1:-1] or 0) for channel in p.labels.channel])
    parts = _parts(p, number, p.gap(number), np.ones(len(p.states), bool))
    at = {round(100 * value): set(read.ravel()) for factor, value, _, read, _ in parts if factor == "arc_length"}
    assert at == {k: {k} for k in range(1, 12)}


def test_no_effect_alone_does_what_a_set_up_far_beyond_its_tolerances_does() -> None:
    found = diagnose(measured(2, 1, base_tilt__x=0.03), quick({e: CATALOGUE[e] for e in ("base_tilt", "body_modulus")}))
    assert found.attribute.effects == ("base_tilt",) and found.calibration is not None and not found.calibration.alike


@pytest.mark.parametrize("down", [(0, 0, 9.81), (0, -9.81, 0), (0, 0, -9.81)])
@pytest.mark.parametrize("turn", [(0, 0, 0), (0, 5, 0), (6, 0, 6)])
def test_a_tracked_body_that_is_turned_on_the_tip_hides_no_cause_and_is_named(
    down: tuple[float, ...], turn: tuple[int, ...]
) -> None:
    robot, tilt = FINGER.replace(gravity=down), Rotation.from_rotvec([0.0, 3.0, 0.0], degrees=True)
    table, made = read(robot.replace(gravity=tilt.inv().apply(down)), turn=tilt), Rotation.from_rotvec(turn, degrees=True)
    read_off = (Rotation.from_quat(table.orientation, scalar_first=True) * made).as_quat(scalar_first=True)
    found = diagnose(Measured(robot, table.replaced(columns(ORIENTATION, read_off))), quick())
    assert found.attribute.effects == ("base_tilt",)
    named = [f for f in found.findings if f.code == "tracked_turn"]
    assert [f.values["deg"] for f in named] == pytest.approx([np.linalg.norm(turn)] if any(turn) else [], abs=0.3)
    for f in named:
        mount = [float(x) for x in re.findall(r"-?[\d.]+", f.values["remedy"])]
        assert np.degrees((made * Rotation.from_quat(mount, scalar_first=True)).magnitude()) < 0.3


def test_an_offset_of_one_axis_is_named_alone_with_its_size() -> None:
    table = read(FINGER)
    found = diagnose(Measured(FINGER, table.replaced({"y": table["y"] + 0.04 * FINGER.length})), quick())
    (beyond,) = (str(f) for f in found.findings if f.code == "beyond_tolerance")
    named = re.findall(r"(frame_shift\.\w|length|tilt\.\w)( \(`zero` of the positions\))? ([\d.]+) mm", beyond)
    assert [name[:2] for name in named] == [("frame_shift.y", " (`zero` of the positions)")]
    assert float(named[0][2]) == pytest.approx(40 * FINGER.length, rel=0.1) and found.calibration is not None
    assert [(s.name, s.sd) for s in found.calibration.set_up] == [("frame_shift.y", pytest.approx(0.004 * FINGER.length))]


def test_numbers_that_nearly_cancel_are_stated_with_what_they_do_together() -> None:
    base, frame = (Rotation.from_rotvec([0.0, angle, 0.0], degrees=True) for angle in (7.0, 1.0))
    table = read(FINGER.replace(gravity=base.inv().apply(FINGER.gravity)), turn=frame)
    told = Measured(FINGER.replace(uncertainty={"tilt": np.radians(1), "frame_turn": np.radians(1)}), table)
    for found in (diagnose(told, quick({"precurvature": CATALOGUE["precurvature"]})), fit_effects(told, [])):
        (beyond,) = (f for f in found.findings if f.code == "beyond_tolerance")
        assert [n.values.get("name") for n in beyond.values["numbers"]] == ["tilt.y", "frame_turn.y", None]
        assert "hardly tell these apart: change all of them or none. Re-measure" in beyond.text


def test_repeats_that_scatter_are_stated_in_mm() -> None:
    table = read(FINGER, repeats=3)
    told = Measured(FINGER, table.replaced({"y": table["y"] + 5e-3 * (table["repeat"] == 2)}))
    found = diagnose(told, quick({"viscoelastic": CATALOGUE["viscoelastic"]}))
    (scatter,) = (str(f) for f in found.findings if f.code == "scatter_of_repeats")
    assert set(SCATTERS) == {PRESSURE, *(source.spec.id for source in (*BY_TRIAL, *REPEATS))}
    assert f"scatter by {found.locate.noise_floor_mm:.2f} mm rms, the noise floor" in scatter
    assert re.search(r"shifts in its mount by ([\d.]+) mm along each axis, [\d.]+ times as much as usual", scatter), scatter
    farthest = re.search(r"Farthest off is trial \d+ step \d+.*, where .* is ([\d.]+) mm from its repeats at the same", scatter)
    assert farthest is not None and float(farthest[1]) == pytest.approx(5.0, abs=2.0), scatter


# -- sizes that physics bounds, and what robot.yaml says of how well its numbers are known
@pytest.mark.parametrize(("mean", "low", "high"), [(0.3, -1.0, 2.0), (0.0, 5.0, np.inf), (0.0, -np.inf, -21.0), (4.0, 0.0, 0.5)])
def test_quantiles_of_a_cut_normal_keep_their_digits_however_far_out_the_bounds_are(mean: float, low: float, high: float) -> None:
    cut = truncnorm((low - mean) / 0.7, (high - mean) / 0.7, mean, 0.7)
    for share in (0.05, 0.5, 0.95):
        assert cut_quantile(mean, 0.7, low, high, share) == pytest.approx(cut.ppf(share), rel=1e-9, abs=1e-12)


def test_no_payload_takes_more_off_the_tip_than_hangs_there() -> None:
    case = measured(3, 1, FEW, tip_payload__mass=-0.2)
    p = prepare(ROBOT, states(case)[0]).problem.parameters
    assert p.lower[p.names.index("tip_payload.mass")] == -case.robot.tip_mass
    found = diagnose(case, quick({e: CATALOGUE[e] for e in ("tip_payload", "pressure_offset", "base_tilt")}))
    assert found.attribute.effects != ("tip_payload",) or found.attribute.conclusion != "cause"
    said = [r.parameters.get("tip_payload.mass") for r in found.attribute.ranking]
    assert all(v.value >= -case.robot.tip_mass for v in said if v is not None)


TWO = {effect: CATALOGUE[effect] for effect in ("body_modulus", "chamber_azimuth")}


def test_a_modulus_that_is_not_well_known_is_no_cause() -> None:
    case = measured(2, 6, FEW, youngs_modulus__excess=0.15)
    options = replace(quick(), catalogue=TWO)
    assert diagnose(case, options).attribute.effects == ("body_modulus",)
    known = ROBOT.model_copy(update={"uncertainty": Uncertainty(youngs_modulus=0.3)})
    assert diagnose(replace(case, robot=known), options).attribute.verdict == "none"


def test_a_tolerance_has_the_width_that_is_stated() -> None:
    case = measured(1, 6, (0.0,))
    known = ROBOT.model_copy(update={"uncertainty": Uncertainty(tilt=np.radians(2), density=0.05, area_factor=0.03)})
    for robot, tilt, density, area in ((ROBOT, np.radians(0.1), 0.01, 0.5), (known, np.radians(2), 0.05, 0.03)):
        infos = {p.name: p for p in prepare(robot, states(case)[0]).forward.parameters}
        assert infos["tilt.x"].sd == pytest.approx(tilt) and infos["density.excess"].sd == pytest.approx(density)
        assert infos["area.excess"].sd == pytest.approx(area)
        assert infos["density.excess"].low >= -0.8 and infos["frame_shift.x"].sd == pytest.approx(1.6e-3)


# -- a similar robot has the same names and probabilities, and sizes of its own scale
def scaled(campaign: Measured, length: float, modulus: float) -> Measured:
    """The same campaign of a similar robot, seen by cameras as good for its size."""
    rows = (
        replace(
            r,
            pressures=tuple(modulus * p for p in r.pressures),
            rate=modulus * (r.rate or 0.0),
            spine_length=length * r.spine_length,
            tip=None if r.tip is None else (length * r.tip[0], length * r.tip[1], length * r.tip[2]),
        )
        for r in campaign.table
    )
    return Measured(similar(campaign.robot, length, modulus), Table.of(rows))


def test_a_campaign_that_is_done_faster_or_slower_has_the_same_cause_with_the_same_probability() -> None:
    campaign, some = measured(2, 1, FEW, viscoelastic__slow=0.2), {e: CATALOGUE[e] for e in ("viscoelastic", RIVALS[0])}

    def cause(slower: float) -> Attribute:
        rows = [replace(r, t=slower * r.t, hold=slower * r.hold, rate=(r.rate or 0.0) / slower) for r in campaign.table]
        return diagnose(Measured(campaign.robot, Table.of(rows)), quick(some)).attribute

    faster, slower = cause(0.1), cause(10.0)
    assert faster.effects == slower.effects == ("viscoelastic",)
    assert faster.probability == pytest.approx(slower.probability, abs=0.02)


def test_a_similar_robot_has_the_same_cause_with_the_same_probability() -> None:
    campaign = measured(2, 1, FEW, chamber_ballooning__growth=0.12)
    rivals = {effect: SOME[effect] for effect in ("chamber_ballooning", "pressure_offset", "base_tilt")}
    given, small = (diagnose(c, quick(rivals)) for c in (campaign, scaled(campaign, 0.3, 0.2)))

    def growth(d: Diagnosis) -> float:
        return d.attribute.ranking[0].parameters["chamber_ballooning.growth"].value

    assert given.attribute.effects == small.attribute.effects == ("chamber_ballooning",)
    assert small.attribute.conclusion == given.attribute.conclusion
    assert small.attribute.probability == pytest.approx(given.attribute.probability, abs=0.05)
    assert growth(small) == pytest.approx(growth(given), rel=0.05)
