"""Copies of states count once; repeats that may read alike by chance, or always, are kept."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import lab
from lab.files.copies import copies_of
from recordings.table_file import write_csv
from recordings.trials import Table
from tests.diagnosis.test_case import sweep


def table(noise: float, step: float = 0.0, pressure_noise: float = 0.0, repeats: int = 2) -> Table:
    """Readings with noise (m, Pa), rounded to steps (m)."""
    made, random = Table.of(sweep(repeats)), np.random.default_rng(3)
    tip = made.tip + noise * random.normal(size=made.tip.shape)
    pressures = made.pressures + pressure_noise * random.normal(size=made.pressures.shape)
    columns = dict(zip("xyz", (np.round(tip / step) * step if step else tip).T, strict=True))
    return made.replaced(columns | {f"p{k}": p for k, p in enumerate(pressures.T, 1)})


def twice(once: Table, renumbered: bool) -> Table:
    again = {name: once[name] + renumbered * (once[name].max() + 1) for name in ("trial", "t")}
    return Table.stacked([once, once.replaced(again)])


FINE, ONE_SWEEP = table(1e-4), table(1e-4, pressure_noise=50.0, repeats=1)
BY_CHANCE = [table(0.0), table(3e-4, 1e-3), table(1e-4, 1e-4, repeats=3)]
"""Noiseless, in whole mm, in tenths."""


@pytest.mark.parametrize("once", [FINE, ONE_SWEEP, *BY_CHANCE])
def test_repeats_are_no_copies_and_a_table_behind_itself_is(once: Table) -> None:
    own = np.arange(len(once))
    assert not len(copies_of(once))
    np.testing.assert_array_equal(copies_of(twice(once, renumbered=False)), np.column_stack([len(once) + own, own]))


@pytest.mark.parametrize(("once", "told"), [(FINE, 1), (table(1e-4, 1e-5), 1), (ONE_SWEEP, 1), *((t, 0) for t in BY_CHANCE[:2])])
def test_copies_that_were_numbered_anew_are_told_by_the_scatter(once: Table, told: int) -> None:
    assert len(copies_of(twice(once, renumbered=True))) == told * len(once)


def test_a_state_that_is_the_zero_of_each_trial_is_kept() -> None:
    zero = {axis: np.where(FINE["step"] == 1, at, FINE[axis]) for axis, at in zip("xyz", (0.0, 0.0, 0.4), strict=True)}
    assert not len(copies_of(FINE.replaced(zero)))


def test_a_case_counts_copies_once_and_names_their_rows(tmp_path: Path) -> None:
    shutil.copy(Path(__file__).parents[2] / "examples" / "paper" / "robot.yaml", tmp_path)
    write_csv(twice(FINE, renumbered=True), tmp_path / "trials.csv")
    with pytest.warns(match="trials.csv: rows 31 to 60 equal rows 1 to 30 to the last digit"):
        assert len(lab.case(tmp_path).table) == len(FINE)
