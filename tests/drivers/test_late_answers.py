"""An answer that is late belongs to no later question, and is no restart; a stop has the line before everything else."""

import contextlib
import random
from collections.abc import Iterator
from typing import Any

import pytest

import timing
from drivers.dynamixel.bus import Register, Servo
from drivers.errors import DeviceFault, InstrumentError, NoReply
from drivers.numato.driver import Config, NumatoValve
from drivers.stop_first import StopFirst
from drivers.tmcl.bus import MotorAxis
from sim_fakes.dynamixel import DynamixelFake
from sim_fakes.numato import NumatoFake
from sim_fakes.tmcl import TmclFake
from tests.drivers.spines import homed, make_pair
from tests.simulated.bench import Bench, answered, raises

PATIENT = {"dynamixel": {"watchdog": 2.54, "timeout": 0.1}, "tmcl": {"heartbeat": 30.0, "timeout": 0.15}}


@pytest.fixture(params=PATIENT)
def pair(bench: Bench, request: pytest.FixtureRequest) -> Iterator[tuple[Any, Any]]:
    """A driver whose spine has its zero, and its fake."""
    unit, fake = make_pair(bench, request.param, **PATIENT[request.param])
    homed(unit)
    yield unit, fake
    fake.faults.delay = 0.0


def recovered(unit: Any) -> Any:
    """The first reading that comes, however long late answers keep coming."""
    deadline = timing.now() + 30
    while True:
        try:
            return unit.read()
        except DeviceFault as e:
            assert "restarted" not in str(e)
            unit.stop()
        except InstrumentError:
            assert timing.now() < deadline


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2, 3))])
def test_answers_that_come_late_are_no_restart(pair: tuple[Any, Any], seed: int) -> None:
    unit, fake = pair
    rng = random.Random(seed)
    errors = []
    for _ in range(12):
        fake.faults.delay = rng.choice([0.0, 0.05, 0.12, 0.21, 0.33])
        try:
            unit.read()
        except InstrumentError as e:
            errors.append(str(e))
    fake.faults.delay = 0.0
    sample = recovered(unit)
    assert not [e for e in errors if "restarted" in e]
    assert sample.homed and sample.length == pytest.approx(0.0, abs=1e-3)


def test_a_restart_is_told_also_after_late_answers_and_when_the_unit_was_stopped_first(pair: tuple[Any, Any]) -> None:
    unit, fake = pair
    fake.faults.delay = 0.33
    raises(InstrumentError, None, unit.read)
    fake.faults.delay = 0.0
    assert recovered(unit).homed
    fake.reset(silence=0.0)
    unit.stop()
    raises(DeviceFault, "restarted", unit.read)


def test_a_late_dynamixel_answer_is_never_the_answer_to_a_later_question(bench: Bench) -> None:
    fake = bench.started(DynamixelFake(bench.plant, bench.clock))
    servo = bench.closing(Servo("spine", fake.port, 57600, 1, 0.05))
    servo.open()
    truth = {Register(7, 1): 1, Register(9, 1): 250, Register(31, 1): 80, Register(146, 1): 31, Register(144, 2): 120,
             Register(38, 2): 1193, Register(36, 2): 885}  # fmt: skip
    check(fake, servo.read, truth)


def test_a_late_tmcl_answer_is_never_the_answer_to_a_later_question(bench: Bench) -> None:
    fake = bench.started(TmclFake(bench.plant, bench.clock))
    axis = bench.closing(MotorAxis("spine", fake.port, 115200, 1, 2, 0, 0.05))
    axis.open()
    check(fake, axis.get, {4: 51200, 5: 51200, 193: 1, 194: 1000, 195: 100, 212: 0})


def test_a_late_state_of_the_relay_is_never_the_present_one(bench: Bench) -> None:
    fake = bench.started(NumatoFake(bench.plant, bench.clock))
    valve = bench.closing(NumatoValve("valve", Config(port=fake.port, timeout=0.1), bench.clock))
    valve.open()
    for delay in (0.25, 0.35, 0.45):
        fake.coils[0], fake.faults.delay = False, delay
        with contextlib.suppress(InstrumentError):
            assert not valve.read().on
        fake.coils[0], fake.faults.delay = True, 0.0
        assert answered(valve.read).on


def check(fake: Any, ask: Any, truth: dict[Any, int]) -> None:
    """Ask at random while answers come late by random times; what is answered must be true."""
    rng, answered = random.Random(7), 0
    for i in range(60):
        fake.faults.delay = rng.choice([0.0, 0.0, 0.03, 0.07, 0.11, 0.2]) if i < 40 else 0.0
        question = rng.choice(list(truth))
        try:
            assert ask(question) == truth[question]
        except InstrumentError as e:
            assert isinstance(e, NoReply) or "damaged" in str(e), e
        else:
            answered += 1
    assert answered > 5


LONG = 30.0
"""Host seconds: longer than any of these tests takes."""


def test_an_exchange_under_way_gives_way_to_a_stop() -> None:
    lock, begun, ended = StopFirst("pressure"), timing.Event(), []

    def exchange() -> None:
        with lock:
            begun.set()
            try:
                lock.sleep(LONG)
            except NoReply as e:
                ended.append(str(e))

    thread = timing.Thread(target=exchange, daemon=True)
    thread.start()
    assert begun.wait(LONG)
    with lock.stopping():
        assert ended == ["pressure: cancelled by a stop; repeat it when the stop is done"]
    thread.join(LONG)


def test_nobody_gets_in_between_while_a_stop_waits() -> None:
    lock = StopFirst("pressure")
    with lock.stopping():
        other: list[object] = []

        def look() -> None:
            try:
                lock.give_way()
            except NoReply as e:
                other.append(e)

        thread = timing.Thread(target=look, daemon=True)
        thread.start()
        thread.join(LONG)
        assert len(other) == 1


def test_the_stop_itself_is_not_interrupted_not_even_by_a_second_stop() -> None:
    lock, waiting = StopFirst("pressure"), timing.Event()

    def second() -> None:
        waiting.set()
        with lock.stopping():
            pass

    with lock.stopping():
        thread = timing.Thread(target=second, daemon=True)
        thread.start()
        assert waiting.wait(LONG)
        lock.sleep(0.05)
        with lock:
            lock.give_way()
    thread.join(LONG)
    assert not thread.is_alive()


def test_after_the_stop_the_line_is_as_before() -> None:
    lock = StopFirst("pressure")
    with pytest.raises(ValueError), lock.stopping():
        raise ValueError
    with lock:
        lock.give_way()
        before = timing.now()
        lock.sleep(0.03)
        assert timing.now() - before == pytest.approx(0.03)
