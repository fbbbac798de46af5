"""What a test of drivers or fakes starts and makes."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import timing
from drivers.errors import InstrumentError
from sim_fakes.plant import Plant
from timing import RigClock


def raises(kind: type[Exception], says: str | None, call: Callable[..., object], *given: Any, **named: Any) -> str:
    """The call raises an error of this kind that says this (a regular expression, None: anything); returns its message."""
    with pytest.raises(kind, match=says) as caught:
        call(*given, **named)
    return str(caught.value)


class Bench:
    """A plant, a clock, and the fakes and drivers of one test, which end with it."""

    def __init__(self, speed: float) -> None:
        self.plant, self.clock = Plant(), RigClock(speed)
        self.ends = contextlib.ExitStack()

    def started(self, fake: Any) -> Any:
        """The fake, started."""
        fake.start()
        self.ends.callback(fake.stop)
        return fake

    def closing(self, driver: Any) -> Any:
        """The driver, or whatever else is closed at the end of the test."""
        self.ends.callback(driver.close)
        return driver

    def end(self) -> None:
        """Close drivers and stop fakes, the last ones first."""
        self.ends.close()


def started_fake(kind: Callable[..., Any], **settings: Any) -> Any:
    """The fixture of a fake that is started for a test."""

    @pytest.fixture
    def fake(bench: Bench) -> Any:
        return bench.started(kind(bench.plant, bench.clock, **settings))

    return fake


def maker(driver: Any, config: Any, name: str, **usual: Any) -> Any:
    """The fixture of what makes such a driver of `fake`, with the usual settings in rig.yaml or others."""

    @pytest.fixture
    def make(bench: Bench, fake: Any) -> Any:
        own = {"port": fake.port} | usual
        return lambda **changes: bench.closing(driver(name, config.model_validate(own | changes), bench.clock))

    return make


def wait_until(condition: Callable[[], object], within: float = 60.0) -> None:
    """Poll until the condition holds; fails the test where it does not `within` s, far more than it takes."""
    deadline = timing.now() + within
    while not condition():
        assert timing.now() < deadline, f"not so after {within:g} s"
        timing.sleep(0.005)


@contextlib.contextmanager
def repeated(act: Callable[[], object], every: float) -> Iterator[None]:
    """Call `act` now, and again each time `every` host seconds have passed, in a thread of its own until the block ends."""
    ended = timing.Event()

    def repeat() -> None:
        while not ended.wait(every):
            act()

    act()
    thread = timing.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def answered(call: Callable[[], Any], within: float = 30.0) -> Any:
    """What `call` gives once the instrument is understood again, after all that it still owes has come in."""
    deadline = timing.now() + within
    while True:
        try:
            return call()
        except InstrumentError:
            assert timing.now() < deadline
            timing.sleep(0.005)
