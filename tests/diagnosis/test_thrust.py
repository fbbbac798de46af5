"""What takes the chambers' thrust is settled before a cause is looked for, and hides none."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from diagnosis.fit_effects import fit_effects
from diagnosis.inference.prepare import prepare
from diagnosis.inference.thrust import settle_thrust, settled_and_edited
from lab.calibration import calibrate
from lab.files.inputs import Case
from lab.verbs.fit import sheet
from model.effects import CATALOGUE
from recordings.trials import Table
from tests.diagnosis.small_campaigns import FEW, measured, quick
from tests.diagnosis.test_case import ROBOT, Measured, states

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
    assert found.attribute.effects == ("contact",) and found.attribute.p == "p ≤ 0.80"
    left = diagnose(touching, quick(RIVALS))
    assert left.headline == "Unclear: robot.yaml must say whether cap or walls take the thrust of the chambers."


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
