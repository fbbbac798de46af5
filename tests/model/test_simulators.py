"""Other simulators agree with the rod as far as they say: the example of one's own, PyElastica and SoRoMoX."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from model.condition import States, conditions
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from model.simulators import Forward, Readings
from tests.model.rods.cases import Bending

EXAMPLE = Path(__file__).parents[2] / "examples/simulator/constant_strain.py"


def apart(robot: Robot, states: States) -> tuple[np.ndarray, np.ndarray]:
    """(n,) m between the example and the rod, and the rod's tips."""
    simulator: Forward = runpy.run_path(str(EXAMPLE))["SIMULATOR"](robot)
    rod = solve(rods_of(robot, states)).tip
    return np.linalg.norm(simulator.predict(states, {}).tip - rod, axis=1), rod


def test_the_example_is_up_to_three_millimetres_from_the_rod(paper_robot: Robot) -> None:
    spine = np.array([0.0, 0.0, 0.1, 0.3, 0.0, 0.2, 0.0, 0.1])
    pressure = np.zeros((8, 9))
    pressure[:, [8, 0, 1]] = np.array([0.0, 250e3, 250e3, 250e3, 120e3, 60e3, 250e3, 0.0])[:, None]
    force = np.zeros((8, 3))
    force[4] = (0.0, 0.3, 0.0)
    roll = np.radians([0, 0, 0, 0, 0, 0, 30, 0])
    states = conditions(paper_robot, spine, pressure, 0.053, roll, force, [[0.0, 0.0, 0.0]] * 7 + [[0.3, 0.1, 0.0]])
    far, rod = apart(paper_robot, states)
    assert np.abs(rod[7] - rod[2])[:2].min() > 5e-3
    assert 0.2e-3 < far.max() < 3e-3
    assert np.linalg.norm(rod - [0.0, 0.0, 0.4], axis=1).max() > 0.2


def test_the_example_knows_tendons_and_tapers(pulled: Robot) -> None:
    radii = {"outer_radius": (0.05, 0.045), "inner_radius": (0.029, 0.029), "path_radius": (0.04, 0.036)}
    taper = [{"length": 0.2, "youngs_modulus": 7e5}, {"length": 0.2, **radii}]
    robot = pulled.replace(area_factor=2.0, sections=taper)
    far, rod = apart(robot, conditions(robot, 0.0, np.outer([0.0, 60e3, 120e3], [1.0, 0.0, 0.0]), 0.0))
    assert far.max() < 2e-3
    assert np.linalg.norm(rod[2] - rod[0]) > 0.02


def read(name: str, robot: Robot, at: States, pieces: int = 0, **changes: float) -> Readings:
    """What a simulator says, with this many elements or segments."""
    if name == "PyElastica":
        from model.simulators.pyelastica import PyElastica as Simulator  # slow to import
    else:
        pytest.importorskip("soromox", reason="pip install 'softlab[soromox]'")
        from model.simulators.soromox import SoRoMoX as Simulator  # type: ignore[assignment]
    own = Simulator(robot, pieces or {"PyElastica": 20, "SoRoMoX": 10}[name])
    assert isinstance(own, Forward)
    return own.predict(at, {key.replace("__", "."): value for key, value in changes.items()})


EACH = pytest.mark.parametrize("name", [pytest.param("PyElastica", marks=pytest.mark.long), "SoRoMoX"])


@EACH
def test_it_stands_and_bends_as_the_rod_does(reference_robot: Robot, bending: Bending, name: str) -> None:
    """PyElastica to 50 kPa: the thrust stretches the body by 0.6 %, and its law differs from the rod's by three times as much."""
    at = bending(reference_robot, [0.0, 0.1, 0.3], [0.0, 50e3] if name == "PyElastica" else [0.0, 50e3, 250e3])
    tip, rod = read(name, reference_robot, at).tip, solve(rods_of(reference_robot, at), FINE).tip
    assert tip == pytest.approx(rod, abs=0.8e-3 if name == "PyElastica" else 2e-3)
    assert name == "SoRoMoX" or np.abs(tip - rod)[at.pressure.max(axis=1) == 0].max() < 0.05e-3
    assert np.linalg.norm(tip - rod, axis=1).max() > 1e-6  # its own solution


@EACH
def test_a_larger_chamber_pushes_more(reference_robot: Robot, bending: Bending, name: str) -> None:
    at, more = (bending(reference_robot, [0.2], [p]) for p in (50e3, 51e3))
    larger = read(name, reference_robot, at, area__excess=0.02).tip
    assert larger == pytest.approx(read(name, reference_robot, more).tip, abs=2e-5)


def test_soromox_agrees_better_with_more_segments(reference_robot: Robot, bending: Bending) -> None:
    at = bending(reference_robot, [0.1], [200e3])
    rod = solve(rods_of(reference_robot, at), FINE).tip
    coarse, fine = (float(np.linalg.norm(read("SoRoMoX", reference_robot, at, n).tip - rod)) for n in (5, 20))
    assert fine < 0.3 * coarse and fine < 0.3e-3


@EACH
def test_a_moment_on_the_tip_bends_it_as_it_does_the_rod(reference_robot: Robot, name: str) -> None:
    at, free = (conditions(reference_robot, 0.1, np.zeros(9), moment=moment) for moment in ((0.3, 0.5, 0.1), np.zeros(3)))
    tip, rod = read(name, reference_robot, at).tip, solve(rods_of(reference_robot, at), FINE).tip
    assert tip == pytest.approx(rod, abs=0.8e-3)
    assert np.linalg.norm(rod - solve(rods_of(reference_robot, free), FINE).tip) > 10e-3
