"""Blind cases on a Dask cluster on loopback: all come back, also when a worker dies."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from lab.blind.cluster import spread_on_cluster
from lab.blind.workers import Crew, spread
from lab.config import ConfigError

distributed = pytest.importorskip(
    "distributed", reason="dask.distributed is not installed: pip install 'softlab[cluster]' to test the cluster"
)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A scheduler and two worker processes on loopback."""
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, processes=True
    )
    with cluster:
        yield str(cluster.scheduler_address)


def square(x: int) -> int:
    return x * x


def dies_once(mark: str) -> str:
    """Takes its worker with it the first time it is called."""
    place = Path(mark)
    if not place.exists():
        place.write_text("was here")
        os._exit(1)
    time.sleep(0.05)
    return mark


def test_every_item_comes_back(scheduler: str) -> None:
    assert sorted(spread_on_cluster(square, range(20), scheduler)) == sorted(x * x for x in range(20))


def test_a_lost_worker_loses_no_case(scheduler: str, tmp_path: Path) -> None:
    marks = [str(tmp_path / f"{i}") for i in range(3)]
    (tmp_path / "0").write_text("already")
    (tmp_path / "2").write_text("already")
    assert sorted(spread(dies_once, marks, Crew(scheduler=scheduler, quiet=True), "cases")) == marks


def test_nobody_at_the_address_is_a_clear_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.blind.cluster.CONNECT_SECONDS", 1.0)
    with pytest.raises(ConfigError, match="no scheduler answers"):
        list(spread_on_cluster(square, [1], "tcp://127.0.0.1:9"))
