"""A short form of the fault matrix: each instrument once, each phase at least once; `make faults` runs all of it.

The second rig's regulators and length unit are left to the whole matrix.
"""

from collections.abc import Iterator

import pytest

from benchmarks.faults.cells import FaultCell, cells
from benchmarks.faults.trial import FaultBench
from sim_fakes.faults import FAULTS

SHORT = (
    FaultCell("pressure/alicat", "disconnect", "hold"),
    FaultCell("pressure/alicat", "replay", "sweep"),
    FaultCell("spine/dynamixel", "nak", "approach"),
    FaultCell("valve/numato", "stuck", "shutdown"),
    FaultCell("gauge/pfeiffer", "over_range", "sweep"),
    FaultCell("mocap/natnet", "silence", "connect"),
    FaultCell("force/ft300s", "nak", "connect"),
    FaultCell("arm/ur5", "disconnect", "sweep"),
)


@pytest.fixture(scope="module")
def bench() -> Iterator[FaultBench]:
    opened = FaultBench(second_rig=False, seed=5)
    yield opened
    opened.close()


def test_the_matrix_is_nine_instruments_by_fifteen_faults_by_five_phases() -> None:
    assert len(FAULTS) == 15 and len(cells()) == len(set(cells())) == 9 * 15 * 5


@pytest.mark.long
@pytest.mark.parametrize("cell", SHORT, ids=lambda c: f"{c.instrument}-{c.fault}-{c.phase}")
def test_it_ends_safe_with_an_error_that_names_the_instrument_or_is_told_as_not_confirmed(
    bench: FaultBench, cell: FaultCell
) -> None:
    verdict = bench.verdict(cell)
    assert verdict.mark in (".", "e", "l"), verdict
