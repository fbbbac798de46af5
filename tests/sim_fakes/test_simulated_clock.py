"""A clock that jumps: what its threads do comes in one order, and takes no time but that of their computation."""

import os
import queue
import signal
import threading
import time

import pytest

import timing
from tests.simulated import clock as simulated
from tests.simulated.bench import raises
from tests.simulated.clock import Deadlock
from timing import RigClock


def test_hours_take_no_time_and_threads_wake_in_the_order_of_their_deadlines() -> None:
    began, log = time.monotonic(), []

    def wake(every: float, name: str) -> None:
        for _ in range(3):
            timing.sleep(every)
            log.append((name, round(timing.now() - simulated.START)))

    threads = [timing.Thread(target=wake, args=(every, name)) for every, name in ((3600.0, "a"), (5000.0, "b"))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert log == [("a", 3600), ("b", 5000), ("a", 7200), ("b", 10000), ("a", 10800), ("b", 15000)]
    assert time.monotonic() - began < 5.0


def test_a_thread_whose_condition_holds_goes_on_before_time_does() -> None:
    event, numbers, seen = timing.Event(), timing.Queue(), []

    def take() -> None:
        seen.append(numbers.get())
        seen.append(event.wait(5.0))

    thread = timing.Thread(target=take)
    thread.start()
    before = timing.now()
    numbers.put(7)
    event.set()
    thread.join()
    assert seen == [7, True] and timing.now() - before < 1e-3
    raises(queue.Empty, None, numbers.get, timeout=2.0)
    assert not timing.Event().wait(3.0) and timing.now() - before == pytest.approx(5.0)


def test_a_lock_is_waited_for_while_its_owner_sleeps() -> None:
    lock, got = timing.RLock(), []

    def hold() -> None:
        with lock, lock:
            timing.sleep(10.0)

    timing.Thread(target=hold).start()
    timing.sleep(1.0)
    got.append(lock.acquire(timeout=2.0))
    got.append(lock.acquire())
    assert got == [False, True] and timing.now() - simulated.START == pytest.approx(10.0)


def test_a_pipe_is_readable_as_soon_as_it_is_written_and_not_after_the_time_out() -> None:
    ours, theirs = os.pipe()

    def write() -> None:
        timing.sleep(4.0)
        os.write(theirs, b"x")

    timing.Thread(target=write).start()
    assert timing.readable([ours], 3.0) == []
    assert timing.readable([ours], 3.0) == [ours] and timing.now() - simulated.START == pytest.approx(4.0)
    os.close(ours)
    os.close(theirs)


def test_threads_that_wait_for_each_other_for_ever_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated, "STUCK_AFTER", 0.05)
    timing.Thread(target=timing.Event().wait, name="the other").start()
    raises(Deadlock, "the other", timing.Event().wait)


def test_an_interrupt_reaches_who_waits_and_the_clock_goes_on() -> None:
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    going = True

    def tick() -> None:
        while going:
            time.sleep(1e-4)
            timing.sleep(1.0)

    timing.Thread(target=tick).start()
    with pytest.raises(KeyboardInterrupt):
        timing.Event().wait(1e9)
    going, before = False, timing.now()
    timing.sleep(2.0)
    assert timing.now() - before == pytest.approx(2.0)


def test_it_stands_still_while_nobody_lives_in_it_and_others_keep_their_own() -> None:
    rig = RigClock(20.0)
    rig.sleep(60.0)
    assert rig.now() == pytest.approx(60.0)
    seen: list[bool] = []
    outside = threading.Thread(target=lambda: seen.append(timing.together()))
    outside.start()
    outside.join()
    assert timing.together() and seen == [False]
    raises(ValueError, "must be above 0", RigClock, 0.0)
