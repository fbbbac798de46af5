"""A drift of the readings over the trials is found with its size, places of other rows with rows and direction; scatter
from trial to trial is no drift, and what a body does by itself is no shift. What takes the thrust is settled before a cause is
looked for, and hides none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.data import drift, shift
from diagnosis.data.case import states
from diagnosis.diagnose import diagnose
from diagnosis.fit_effects import fit_effects
from diagnosis.inference.prepare import prepare
from diagnosis.inference.thrust import settle_thrust, settled_and_edited
from lab.calibration import calibrate
from lab.files.inputs import Case
from lab.verbs.fit import sheet
from model.arrays import Array
from model.effects import CATALOGUE
from recordings.trials import TIP, Table
from tests.diagnosis.small_campaigns import FEW, measured, quick
from tests.diagnosis.test_case import ROBOT
from tests.diagnosis.test_diagnose import FINGER, Measured, columns, read


@pytest.mark.parametrize(
    ("along", "deg", "roll", "mm"),
    [
        (4e-3, 0.0, 0.0, 4.0),
        (0.0, 1.0, 0.0, 1e3 * np.radians(1.0) * FINGER.length),
        (0.0, 0.0, 0.0, None),
        (4e-3, 0.0, 40.0, None),  # turned in its mount half way: another setting
    ],
)
def test_a_drift_is_found_whatever_it_is_and_scatter_is_none(along: float, deg: float, roll: float, mm: float | None) -> None:
    table = read(FINGER, repeats=6)
    trials, order = np.unique(table["trial"], return_inverse=True)
    u = order / (len(trials) - 1)
    u = u if not roll else np.round(u)
    own = 0.2e-3 * np.random.default_rng(1).normal(size=(len(trials), 3))[order]
    tip = Rotation.from_rotvec(np.radians(deg) * u[:, None] * [1.0, 0.0, 0.0]).apply(table.tip) + own
    tip[:, 0] += along * u
    campaign, _ = states(Measured(FINGER, table.replaced({**columns(TIP, tip), "roll_deg": roll * u})))
    found = list(drift.drift(campaign))
    assert [f.code for f in found] == ([] if mm is None else ["drift"])
    if mm is not None:
        assert found[0].values["mm"] == pytest.approx(mm, rel=0.15)


ROWS = 120


def shifted(begin: int, end: int, by: int, table: Table) -> Table:
    """States whose tips, from `begin` to `end`, are those `by` rows below; none where there is no such row."""
    of, rows = np.arange(ROWS) + by, np.arange(ROWS)
    moved = np.where(((of >= 0) & (of < ROWS))[:, None], table.tip[of.clip(0, ROWS - 1)], np.nan)
    return table.replaced(columns(TIP, np.where(((rows >= begin) & (rows < end))[:, None], moved, table.tip)))


def lagging(pressure: Array, share: float = 0.6) -> Array:
    return np.vstack([pressure[:1], (1 - share) * pressure[1:] + share * pressure[:-1]])


def played(pressure: Array) -> Array:
    """A backlash of half a step."""
    out = pressure.copy()
    for k in range(1, len(out)):
        out[k] = np.clip(out[k - 1], pressure[k] - 22e3, pressure[k] + 22e3)
    return out


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("acting", [None, lambda p: np.clip(p - 20e3, 0.0, None)], ids=["", "dead band"])
@pytest.mark.parametrize(
    ("begin", "end", "by"), [(60, 120, 1), (65, 120, -1), (52, 120, 2), (0, 50, -1), (40, 85, 1), (0, 120, 1)]
)
def test_places_of_other_rows_are_named_with_the_rows(
    begin: int, end: int, by: int, acting: Callable[[Array], Array] | None, noise: float
) -> None:
    table = read(FINGER, acting, repeats=6)
    scatter = noise * FINGER.length / np.sqrt(3) * np.random.default_rng(1).normal(size=(ROWS, 3))
    table = shifted(begin, end, by, table.replaced(columns(TIP, table.tip + scatter)))
    table = table.replaced({"p1": np.where(np.arange(ROWS) == 30, np.nan, table["p1"])})  # one is missing
    (found,) = (f.values for f in shift.shifted(table, FINGER.length))
    assert (found["by"], found["when"]) == (f"{abs(by)} row{'s' * (abs(by) > 1)}", "early" if by > 0 else "late")
    names = [table.place(row) for row in range(ROWS)]
    assert names.index(found["first"]) == pytest.approx(begin, abs=2)
    assert names.index(found["last"]) == pytest.approx(end - 1, abs=2)
    assert found["own_mm"] > 2 * found["mm"]


@pytest.mark.parametrize("from_row", [0, 60])
@pytest.mark.parametrize("law", [lagging, lambda p: lagging(p, 0.8), played, lambda p: p, lambda p: np.clip(p - 20e3, 0.0, None)])
def test_a_lag_or_hysteresis_is_no_shift_also_where_it_begins_at_a_row(law: Callable[[Array], Array], from_row: int) -> None:
    table = read(FINGER, lambda p: np.where((np.arange(ROWS) >= from_row)[:, None], law(p), p), repeats=6)
    assert list(shift.shifted(table, FINGER.length)) == []


def test_a_diagnosis_of_places_of_other_rows_says_so_first_and_is_not_certain() -> None:
    answer = diagnose(Measured(FINGER, shifted(61, 120, 1, read(FINGER, repeats=6))), quick())
    assert answer.headline.startswith("Unclear: positions are logged 1 row early from trial 13 step 2 to trial 24 step 5")
    assert answer.findings[0].severity == "critical" and answer.attribute.conclusion != "cause"


# ------------------------------------------------------------------ thrust
RIVALS = {effect: CATALOGUE[effect] for effect in ("chamber_thrust", "chamber_azimuth", "pressure_offset", "base_tilt")}
ON_WALLS = {"chamber_thrust__share": 1.0, "chamber_thrust__borne": 0.3}


@pytest.fixture(scope="module")
def turned() -> Measured:
    """Thrust on the walls, and chambers 8 deg from where they should be."""
    return measured(3, 2, FEW, chamber_azimuth__angle=np.radians(8), **ON_WALLS)


def test_thrust_on_the_walls_does_not_hide_the_cause_beyond_it(turned: Measured) -> None:
    found = diagnose(turned, quick(RIVALS))
    assert found.attribute.effects == ("chamber_azimuth",) and "chambers are turned by" in found.headline
    (note,) = [f for f in found.findings if f.code == "thrust_settled"]
    assert "write `thrust: walls`" in note.text and note.values["walls_mm"] < 0.3 * note.values["cap_mm"]


def test_to_state_the_walls_that_were_settled_changes_no_answer() -> None:
    plain = measured(3, 2, FEW, chamber_azimuth__angle=np.radians(8), chamber_thrust__share=1.0)
    settled, stated = (
        diagnose(replace(plain, robot=plain.robot.replace(thrust=thrust)), quick(RIVALS)).attribute for thrust in (None, "walls")
    )
    assert settled.effects == stated.effects == ("chamber_azimuth",) and settled.ranking == stated.ranking


def test_a_little_thrust_on_the_cap_is_no_cause_beyond_thrust_on_the_walls() -> None:
    little = measured(3, 2, FEW, chamber_thrust__share=0.93, chamber_thrust__borne=0.6)
    found = diagnose(little, quick(RIVALS | {"marker_offset": CATALOGUE["marker_offset"]}))
    assert found.attribute.effects == ("chamber_thrust",) and "thrust_settled" in [f.code for f in found.findings]
    first, _, rest = found.headline.partition("; no other cause ")
    assert first == "The side walls carry the chambers' thrust" and rest.endswith(
        f" ({found.attribute.p}). Write `thrust: walls`."
    )


def test_thrust_is_settled_behind_a_mistake_that_hides_it(turned: Measured) -> None:
    rows = [replace(r, tip=tuple(np.add(r.tip, (0.06, 0.0, -0.05)))) for r in turned.table.rows if r.repeat == 1]
    own, _ = states(replace(turned, table=Table.of(rows)))
    assert settle_thrust(ROBOT, own, RIVALS) is None
    settled, first = settled_and_edited(ROBOT, own, RIVALS, RIVALS)
    assert first.changes and settled is not None and first.robot.thrust == "walls"


def test_a_fit_settles_it_too_and_writes_it_down(turned: Measured) -> None:
    fitted = fit_effects(turned, ["chamber_azimuth"])
    assert fitted.robot.thrust == "walls" and fitted.robot.effects["chamber_thrust"]["share"].value == pytest.approx(
        1.0, abs=0.01
    )
    assert fitted.parameters["chamber_azimuth.angle"].value == pytest.approx(np.radians(8), rel=0.1)
    assert fitted.left_mm < 0.2 * fitted.calibrated_mm
    again = fit_effects(replace(turned, robot=fitted.robot), ["chamber_azimuth"])
    assert again.left_mm == pytest.approx(fitted.left_mm, rel=0.05)
    calibrated, stated = (calibrate(Case(ROBOT.replace(thrust=thrust), turned.table)) for thrust in (None, "walls"))
    assert calibrated.robot == stated.robot and str(sheet(calibrated).title).endswith(", thrust: walls")


def test_thrust_that_an_obstacle_hides_is_likely_and_no_cause_is_certain_until_it_is_stated() -> None:
    touching = measured(3, 2, FEW, contact__stiffness=100.0, contact__distance=-0.02, **ON_WALLS)
    found = diagnose(touching, quick(RIVALS | {"contact": CATALOGUE["contact"]}))
    (first,) = [f for f in found.findings if f.code == "thrust_likely"]
    assert first.severity == "critical" and 0.3 < first.values["walls_mm"] / first.values["cap_mm"] < 0.8
    # the walls bear 0.3 of the stretch, which is more than the law's tolerance
    assert found.attribute.effects == ("chamber_thrust", "contact") and found.attribute.probability <= 0.8
    left = diagnose(touching, quick(RIVALS))
    assert left.headline == "Unclear: robot.yaml must say whether cap or walls take the thrust of the chambers."


@pytest.mark.parametrize("borne", [0.0, 1.0])
def test_how_thrust_gets_into_the_walls_is_settled_with_it_only_where_plain_walls_leave_far_more(borne: float) -> None:
    made = measured(3, 2, FEW, chamber_thrust__share=1.0, chamber_thrust__borne=borne, base_tilt__y=np.radians(1))
    on_walls = settle_thrust(ROBOT, states(made)[0], RIVALS)
    assert on_walls is not None and on_walls[0].thrust == "walls"
    found = {name: stated.value for name, stated in on_walls[0].effects.get("chamber_thrust", {}).items()}
    assert found == ({"share": 1.0, "borne": pytest.approx(1.0, abs=0.1), "growth": pytest.approx(0.0, abs=0.1)} if borne else {})


def test_what_robot_yaml_states_or_the_data_do_not_ask_for_is_left(turned: Measured) -> None:
    own, _ = states(turned)
    for thrust in ("cap", "walls"):
        assert settle_thrust(ROBOT.model_copy(update={"thrust": thrust}), own, RIVALS) is None
    assert settle_thrust(ROBOT, own, {}) is None
    hopeless = ROBOT.with_modulus(1e-3)  # no state has an equilibrium, and each is followed to where it is lost
    assert settle_thrust(hopeless, own.take(np.arange(len(own)) < 3), RIVALS) is None
    on_cap = measured(2, 2, FEW, chamber_azimuth__angle=np.radians(8), body_modulus__excess=-0.3)
    assert settle_thrust(ROBOT, states(on_cap)[0], RIVALS) is None


def test_the_noise_floor_is_the_same_whatever_the_description() -> None:
    case = measured(3, 3, FEW)
    rng, rows = np.random.default_rng(3), list(case.table.rows)
    for i, r in enumerate(rows):
        change = 1.0 + 0.05 * rng.normal()
        rows[i] = replace(r, pressures=tuple(change * p for p in r.pressures), tip=(change * r.tip[0], *r.tip[1:]))
    own, _ = states(replace(case, table=Table.of(rows)))
    floors = [prepare(ROBOT.replace(area_factor=factor), own, catalogue=RIVALS).noise_floor for factor in (0.8, 1.5, 2.2)]
    assert floors == pytest.approx([floors[0]] * 3, rel=0.05) and 0.3e-3 < floors[0] < 1e-3
