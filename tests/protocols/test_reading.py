"""What every experiment does; a reading that a pause of a stream spoils is taken again where nothing has moved."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.chambers import ChamberMap
from drivers.numato.driver import Config as ValveConfig
from drivers.numato.driver import NumatoValve
from drivers.pfeiffer.driver import Config as GaugeConfig
from drivers.pfeiffer.driver import PfeifferGauge
from protocols.actions import release
from protocols.bench import Bench as Tools
from protocols.bending import Bending
from protocols.bending import plan as bending_plan
from protocols.errors import NotReached
from protocols.experiment import READINGS, Plan, Reading, Trials
from protocols.parameters import Jam
from protocols.visits import Sweep, Visit, plan_of
from recordings.campaign.replay import compare
from recordings.file.journal import Journal
from recordings.file.journal import read as journal_of
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.messages import sensor
from recordings.states.rules import Window
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import AMBIENT
from tests.simulated.bench import Bench, raises
from tests.simulated.clock import SimulatedClock

TOPIC = "/force"


class ClockOfStream:
    """Rig time that passes where somebody waits, and then brings a sample of a force sensor every 0.05 s; none in a pause."""

    def __init__(self) -> None:
        self._t, self._next = 0.0, 0.0
        self.recorder: Recorder | None = None
        self.pauses: list[tuple[float, float]] = []

    def now(self) -> float:
        return self._t

    def sleep(self, duration: float) -> None:
        self._t += duration
        while self.recorder is not None and self._next <= self._t:
            if not any(begin <= self._next < end for begin, end in self.pauses):
                self.recorder.push(TOPIC, self._next, raw=(1.0,) * 6, zero=(0.0,) * 6)
            self._next += 0.05


HUMIDITY = sensor("skin", {"humidity": "1"})


def bench_of(clock: ClockOfStream, recorder: Recorder, said: list[str]) -> Tools:
    """One without instruments, which keeps what is said."""
    narrator: Any = SimpleNamespace(say=said.append, progress=lambda done, total: None)
    nine = ChamberMap(tuple((i,) for i in range(1, 10)))
    return Tools(clock, recorder, cast(Any, None), narrator, *cast(Any, (None,) * 3), nine, patience=0.0)


def read(path: Path, pauses: list[tuple[float, float]], repeatable: bool, topics: tuple[str, ...] = (TOPIC,)) -> list[str]:
    """What is said while one state is read in a window of 1 s; pauses from and to this many s after its begin."""
    clock, said = ClockOfStream(), list[str]()
    with Recorder(path, start_wall_ns=10**18, sensors=[HUMIDITY]) as recorder:
        trials = Trials(bench_of(clock, recorder, said), Plan("test", (), {}))
        trial = trials.begin(repeat=1, spine=0.0)
        begin = clock.now()
        recorder.push(HUMIDITY.topic, begin, humidity=0.4)
        clock.pauses, clock.recorder = [(begin + a, begin + b) for a, b in pauses], recorder
        row = trials.read(
            trial, Window(0.2, 1.0, 3), branch="load", t_start=begin, ramp_end=begin, rate=0.0, targets=(),
            topics=topics, wait=30.0, repeatable=repeatable,
        )  # fmt: skip
        assert trials.rows == [row] and row.step == 1
    return said


def test_a_window_in_which_a_stream_paused_is_read_again(tmp_path: Path) -> None:
    said = read(tmp_path / "run.mcap", [(0.0, 2.0)], True)
    assert len(said) == 1 and "/force" in said[0] and "again" in said[0]
    assert compare(Recording.open(tmp_path / "run.mcap")).equal


@pytest.mark.parametrize(
    ("pauses", "repeatable"),
    [([(0.0, 2.0)], False), ([(1.5 * k, 1.5 * k + 1.42) for k in range(8 * READINGS)], True)],
    ids=["where something creeps", "again and again"],
)
def test_a_pause_is_no_reading(tmp_path: Path, pauses: list[tuple[float, float]], repeatable: bool) -> None:
    raises(NotReached, "usable samples of /force", read, tmp_path / "run.mcap", pauses, repeatable)


def test_the_stream_that_is_silent_is_named_before_those_that_are_not(tmp_path: Path) -> None:
    silent = r"not reached within 30 s: sensors\.skin: no sample for 30\.\d s; check .*; newest samples of the others: force at"
    raises(NotReached, silent, read, tmp_path / "sensor.mcap", [], False, (TOPIC, HUMIDITY.topic))
    with pytest.raises(NotReached, match=r"within 30 s: force: no sample for 29\.\d s; check [^;]*$"):
        read(tmp_path / "force.mcap", [(0.6, 1e9)], False)
    raises(NotReached, "mocap: no sample yet; check .* NEEDS", read, tmp_path / "never.mcap", [], False, (TOPIC, "/tip"))


def test_a_skip_is_of_the_trial_in_which_it_was_asked_even_at_its_very_end(tmp_path: Path) -> None:
    kept: list[tuple[object, ...]] = []
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        bench = bench_of(ClockOfStream(), recorder, [])
        with (
            Journal.begin(recorder.path, "test") as journal,
            bench.steering.of_run(lambda *told: kept.append(told), lambda: None, lambda text: None),
        ):
            trials = Trials(bench, Plan("test", (), {}), journal)
            first, reached = trials.begin(repeat=1, spine=0.0), []
            with trials.doing(first):
                bench.steering.ask("skip", "test")
            with trials.doing(trials.begin(repeat=2, spine=0.0)):
                bench.steering.check_skip()
                reached.append(True)
    told = journal_of(tmp_path / "run.journal")
    assert reached == [True] and told.skipped == {1} and told.done == {2: 0} and told.finished == 2
    assert [(kind, done, trial) for kind, _, _, done, trial, _ in kept] == [("skip", False, 1), ("skip", True, 1)]


# -- with real drivers on fakes; visits and the sweep are one way between states
def test_a_slow_gauge_is_judged_over_as_long_as_its_readings_take(
    simulated: SimulatedClock, bench: Bench, tmp_path: Path
) -> None:
    fake = bench.started(PfeifferFake(bench.plant, bench.clock, seed=4))
    module = bench.started(NumatoFake(bench.plant, bench.clock))
    valve = bench.closing(NumatoValve("valve", ValveConfig(port=module.port, relay=0), bench.clock))
    gauge = bench.closing(PfeifferGauge("gauge", GaugeConfig(port=fake.port, timeout=1.0), bench.clock))
    for driver in (valve, gauge):
        driver.open()
    fake.faults.delay = 0.08  # host s, 1.6 s of the rig: two readings in the rest of 2 s
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        tools = Tools(bench.clock, recorder, *cast(Any, (None,) * 6), valve=valve, gauge=gauge)
        assert release(tools, Jam(rest=2.0, within=30.0)) == pytest.approx(AMBIENT, rel=0.01)


GROUP = [3, 4, 5]
LEVELS = [0.0, 40e3, 70e3, 40e3, 0.0]


def reads(plan: Plan) -> list[tuple[float, tuple[Reading, ...]]]:
    """Of each step that reads: its duration (s), and what it reads."""
    return [(step.seconds, step.reads) for step in plan.steps if step.reads]


def test_settled_states_are_planned_as_those_of_a_bending_sweep() -> None:
    sweep = Bending(pressures=[40e3, 70e3], chambers=GROUP, spine_lengths=[0.0], repeats=2)
    own = plan_of("own", [Visit(dict.fromkeys(GROUP, level)) for level in LEVELS], Sweep(repeats=2))
    assert reads(own) == reads(bending_plan(sweep)) and len(reads(own)) == 2 * len(LEVELS)


def test_a_step_from_chamber_to_chamber_takes_its_ramp() -> None:
    own = plan_of("own", [Visit({1: 50e3}, 10.0), Visit({2: 50e3}, 10.0)], Sweep(rate=10e3))
    (_, first), (second_s, second) = reads(own)
    assert second_s == 5.0 + 10.0 + 2.0  # ramp, hold, average
    assert (first[0].rate, abs(second[0].rate)) == (10e3, 10e3)
