"""Copies of states count once; repeats that may read alike by chance, or always, are kept."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from foreign import ROBOT

import lab
from lab.files.copies import copies_of
from recordings.table_file import write_csv
from recordings.trials import Table

SWEEP = [(0.0, "load"), (20e3, "load"), (40e3, "load"), (60e3, "load"), (40e3, "unload"), (20e3, "unload")]


def table(noise: float, step: float = 0.0, pressure_noise: float = 0.0, repeats: int = 2) -> Table:
    """Each chamber's sweep, `repeats` times: noise (m, Pa) and resolution (m) of readings."""
    trials, steps = (a.ravel() for a in np.indices((3 * repeats, len(SWEEP))))
    level, random = np.array([p for p, _ in SWEEP])[steps], np.random.default_rng(3)
    bend, azimuth = level / 60e3 * 0.05, 2 * np.pi * (trials % 3) / 3
    tip = np.column_stack([-bend * np.cos(azimuth), -bend * np.sin(azimuth), 0.15 - bend**2 / 0.3])
    tip += noise * random.normal(size=tip.shape)
    tip = np.round(tip / step) * step if step else tip
    pressure = level[:, None] * (np.arange(3) == (trials % 3)[:, None]) + pressure_noise * random.normal(size=(len(level), 3))
    columns = {"trial": trials + 1, "step": steps + 1, "repeat": trials // 3 + 1, "protocol": np.full(len(level), "bending")}
    columns |= {"branch": np.array([b for _, b in SWEEP])[steps], "t": 10.0 * np.arange(len(level)), "spine_length": 0.0 * level}
    return Table(columns | {f"p{k + 1}": p for k, p in enumerate(pressure.T)} | dict(zip("xyz", tip.T, strict=True)))


def twice(once: Table, renumbered: bool) -> Table:
    trial, t = (np.concatenate([once[n], once[n] + renumbered * (once[n].max() + 1)]) for n in ("trial", "t"))
    return Table({n: np.concatenate([v, v]) for n, v in once.values.items()}).replaced({"trial": trial, "t": t})


NOISELESS, FINE = table(0.0), table(1e-4)
WHOLE_MM, TENTHS = table(3e-4, 1e-3), table(1e-4, 1e-4, repeats=3)
ONE_SWEEP = table(1e-4, pressure_noise=50.0, repeats=1)


@pytest.mark.parametrize("once", [NOISELESS, FINE, WHOLE_MM, TENTHS, ONE_SWEEP])
def test_repeats_are_no_copies_and_a_table_behind_itself_is(once: Table) -> None:
    assert not len(copies_of(once))
    n = len(once)
    np.testing.assert_array_equal(copies_of(twice(once, renumbered=False)), np.column_stack([n + np.arange(n), np.arange(n)]))


@pytest.mark.parametrize(
    ("once", "told"), [(FINE, True), (table(1e-4, 1e-5), True), (ONE_SWEEP, True), (NOISELESS, False), (WHOLE_MM, False)]
)
def test_copies_that_were_numbered_anew_are_told_by_the_scatter(once: Table, told: bool) -> None:
    assert len(copies_of(twice(once, renumbered=True))) == told * len(once)


def test_a_state_that_is_always_the_zero_of_its_trial_is_kept() -> None:
    resting, noisy = FINE["step"] == 1, {axis: FINE[axis].copy() for axis in "xyz"}
    for axis, zero in zip("xyz", (0.0, 0.0, 0.15), strict=True):
        noisy[axis][resting] = zero
    assert not len(copies_of(FINE.replaced(noisy)))


def test_a_case_counts_copies_once_and_names_their_rows(tmp_path: Path) -> None:
    shutil.copy(ROBOT, tmp_path)
    write_csv(twice(FINE, renumbered=True), tmp_path / "trials.csv")
    with pytest.warns(match="trials.csv: rows 37 to 72 equal rows 1 to 36 to the last digit"):
        assert len(lab.case(tmp_path).table) == len(FINE)
