"""Work on processes and on a Dask cluster on loopback: the same results as here, none lost with a process or worker."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import pytest

import timing
from diagnosis.inference.executor import Executor
from diagnosis.inference.search import Search
from lab.files.config import ConfigError
from lab.processes import Processes, cluster, processes
from tests.diagnosis.toy import toy_problem
from tests.simulated.bench import raises


# ------------------------------------------------------------------ processes
@pytest.fixture(scope="module")
def two() -> Iterator[Processes]:
    with processes(2) as pool:
        yield pool
    assert active_children() == []


def fails(x: int) -> int:
    raise ValueError(f"no square of {x}")


class DiesElsewhere:
    """Takes with it the process that squares three, if that is another than where it was made."""

    def __init__(self) -> None:
        self.here = os.getpid()

    def __call__(self, x: int) -> int:
        if x == 3 and os.getpid() != self.here:
            os._exit(1)
        return x * x


def test_every_item_comes_back_in_order_and_so_does_an_error(two: Processes) -> None:
    assert list(two.in_order(square, range(20))) == [x * x for x in range(20)]
    raises(ValueError, "no square of 0", list, two.in_order(fails, range(3)))
    assert list(two.in_order(square, range(3))) == [0, 1, 4]


def test_the_fits_of_a_diagnosis_give_the_same_answer_on_processes(two: Processes) -> None:
    problem = toy_problem(5, {"play": 1.0, "turned": -0.9})
    there = Search(problem, executor=Executor(remote_map=two.in_order)).run()
    here = Search(problem).run()
    assert [c.named for c in there] == [c.named for c in here]
    assert [c.log_evidence for c in there] == pytest.approx([c.log_evidence for c in here], abs=1e-9)
    # What candidates share they share here too, not as copies.
    shared = [{id(c.base) for c in found if c.base is not None} for found in (there, here)]
    assert 1 <= len(shared[0]) <= len(shared[1])


class Meets:
    """Waits until it is at work in this many processes; how often it was read in each."""

    reads = 0

    def __init__(self, marks: Path, count: int) -> None:
        self.marks, self.count = marks, count

    def __setstate__(self, state: dict[str, Any]) -> None:
        Meets.reads += 1
        self.__dict__ |= state

    def read(self, _: int) -> tuple[int, int]:
        (self.marks / str(os.getpid())).touch()
        assert timing.wait(lambda: len(list(self.marks.iterdir())) >= self.count, 120)
        return os.getpid(), Meets.reads


def test_this_process_works_beside_the_others_and_what_a_method_belongs_to_is_read_once_by_each_of_them(
    two: Processes, tmp_path: Path
) -> None:
    one = Meets(tmp_path, 3)
    seen = {pair for _ in range(3) for pair in two.in_order(one.read, range(6))}
    assert len(seen) == 3 and (os.getpid(), 0) in seen
    assert {reads for where, reads in seen if where != os.getpid()} == {1}


def test_what_is_begun_ahead_is_done_elsewhere_while_this_process_does_something_else(two: Processes, tmp_path: Path) -> None:
    ahead = Executor(remote_map=two.in_order).ahead(Meets(tmp_path, 2).read, [0, 1])
    assert timing.wait(lambda: len(list(tmp_path.iterdir())) >= 2, 120)
    where = {pid for pid, _ in ahead()}
    assert len(where) == 2 and os.getpid() not in where


def test_a_single_item_is_not_sent(two: Processes, tmp_path: Path) -> None:
    (where,) = {pid for pid, _ in Executor(remote_map=two.in_order).map(Meets(tmp_path, 1).read, [0])}
    assert where == os.getpid()


def test_a_process_that_is_lost_costs_time_only(two: Processes) -> None:
    assert list(two.in_order(DiesElsewhere(), range(6))) == [x * x for x in range(6)]
    assert list(two.in_order(square, range(4))) == [0, 1, 4, 9]


PROGRAMS = {
    "processes": "    with processes(1) as pool:\n        list(pool.in_order(waits, sys.argv[1:]))\n",
    "spread": "    list(spread(waits, sys.argv[1:], 2, ''))\n",
}


ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("program", ["processes", pytest.param("spread", marks=pytest.mark.long)])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_program_that_is_ended_leaves_no_process_behind(tmp_path: Path, program: str, how: signal.Signals) -> None:
    file = tmp_path / "program.py"
    file.write_text(
        "import os, sys, timing\n"
        "from pathlib import Path\n"
        "from benchmarks.blind.workers import spread\n"
        "from lab.processes import processes\n"
        "def waits(file):\n"
        "    Path(file).write_text(str(os.getpid()))\n"
        "    timing.sleep(600)\n"
        "if __name__ == '__main__':\n"
        f"{PROGRAMS[program]}"
    )
    marks = [tmp_path / "a", tmp_path / "b"]
    running = subprocess.Popen(
        [sys.executable, str(file), *map(str, marks)], stderr=subprocess.PIPE, start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert timing.wait(lambda: all(m.exists() and m.read_text() for m in marks), 120) and running.poll() is None
    if how == signal.SIGINT:
        os.killpg(running.pid, how)  # from a terminal
    else:
        running.kill()
    _, said = running.communicate(timeout=60)  # until nobody holds its standard error any more
    assert running.returncode != 0 and (b"KeyboardInterrupt" in said or how == signal.SIGKILL)


# ------------------------------------------------------------------ a cluster
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


@pytest.mark.parametrize("loses", ["nothing", pytest.param("a worker", marks=pytest.mark.long)])
def test_the_fits_of_a_diagnosis_give_the_same_answer_there(scheduler: str, loses: str) -> None:
    told: list[str] = []
    problem = toy_problem(5, {"play": 1.0, "turned": -0.9})

    def hear(step: str, _: float) -> None:
        told.append(step)
        if loses == "a worker" and len(told) == 3:
            os.kill(min(workers._client.run(os.getpid).values()), signal.SIGKILL)

    with cluster(scheduler) as workers:
        there = Search(problem, executor=Executor(progress=hear, remote_map=workers.in_order)).run()
    here = Search(problem).run()
    assert [c.named for c in there] == [c.named for c in here]
    assert [c.log_evidence for c in there] == pytest.approx([c.log_evidence for c in here], abs=1e-6)
    assert told == sorted(told)


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
    monkeypatch.setattr("lab.processes.CONNECT_SECONDS", 1.0)
    with pytest.raises(ConfigError, match="no scheduler answers"), cluster("tcp://127.0.0.1:9"):
        pass
