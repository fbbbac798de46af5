"""A stop has the line before everything else, and what was under way there ends."""

import pytest

import timing
from drivers.errors import NoReply
from drivers.stop_first import StopFirst

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
