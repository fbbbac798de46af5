"""Blind cases and the fits of a diagnosis on a Dask cluster on loopback: all come back, also when a worker dies."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import timing
from diagnosis.inference.executor import Executor
from diagnosis.inference.search import Search
from lab.blind.workers import Crew, spread
from lab.cluster import cluster
from lab.files.config import ConfigError
from tests.diagnosis.toy import toy_problem


@pytest.fixture(scope="module", autouse=True)
def distributed() -> Any:
    """Slow to import."""
    return pytest.importorskip("distributed", reason="not installed: pip install 'softlab[cluster]' to test the cluster")


@pytest.fixture(scope="module")
def scheduler(distributed: Any) -> Iterator[str]:
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
    timing.sleep(0.05)
    return mark


@pytest.mark.long
def test_every_item_comes_back(scheduler: str) -> None:
    with cluster(scheduler) as workers:
        assert sorted(workers.as_they_come(square, range(20))) == [x * x for x in range(20)]
        assert list(workers.in_order(square, range(20))) == [x * x for x in range(20)]


@pytest.mark.long
def test_the_fits_of_a_diagnosis_give_the_same_answer_there(scheduler: str) -> None:
    told: list[str] = []
    problem = toy_problem(5, {"play": 1.0, "turned": -0.9})
    with cluster(scheduler) as workers:
        there = Search(problem, executor=Executor(progress=lambda step, _: told.append(step), remote_map=workers.in_order)).run()
    here = Search(problem).run()
    assert [c.named for c in there] == [c.named for c in here]
    assert [c.log_evidence for c in there] == pytest.approx([c.log_evidence for c in here], abs=1e-6)
    assert told == sorted(told)


@pytest.mark.long
def test_a_lost_worker_loses_no_case(scheduler: str, tmp_path: Path) -> None:
    marks = [str(tmp_path / f"{i}") for i in range(3)]
    (tmp_path / "0").write_text("already")
    (tmp_path / "2").write_text("already")
    assert sorted(spread(dies_once, marks, Crew(scheduler=scheduler, quiet=True), "cases")) == marks


class DiesOnce:
    """Takes its worker with it the first time that three is squared."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def square(self, x: int) -> int:
        if x == 3 and not self.mark.exists():
            self.mark.write_text("was here")
            os._exit(1)
        return x * x


@pytest.mark.long
def test_a_worker_lost_in_the_middle_loses_nothing_of_what_was_sent_once(scheduler: str, tmp_path: Path) -> None:
    one = DiesOnce(tmp_path / "mark")
    with cluster(scheduler) as workers:
        for _ in range(2):
            assert list(workers.in_order(one.square, range(8))) == [x * x for x in range(8)]
    assert one.mark.exists()


def test_nobody_at_the_address_is_a_clear_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.cluster.CONNECT_SECONDS", 1.0)
    with pytest.raises(ConfigError, match="no scheduler answers"), cluster("tcp://127.0.0.1:9"):
        pass
