"""Whichever instruments fail their stop, the others stop; nothing counts as safe that was not read back."""

import itertools
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from house import House, until

import timing
from drivers.errors import Unreachable
from drivers.interfaces import PressureSample, SpineSample, ValveSample
from lab.files.rig_file import Safe, load_rig
from lab.guard import hosted, landing
from lab.guard.hosted import under_guard
from lab.guard.instruments import ACTUATORS
from lab.guard.landing import Landing, Owned, SafeReport
from timing import RigClock

LANDINGS: list[Landing] = []
ORDER = ("valve", "spine", "pressure", "arm")


@pytest.fixture(autouse=True)
def no_attempts_left() -> Iterator[None]:
    """A landing that is not confirmed goes on; not into the next test."""
    yield
    while LANDINGS:
        LANDINGS.pop().end()


def landing_of(drivers: dict[str, Any], policy: Safe, speed: float, busy: set[str] | None = None) -> Landing:
    """A landing of drivers that are open."""
    owned = Owned(drivers, list(drivers), busy=set() if busy is None else busy)
    LANDINGS.append(Landing(policy, owned, lambda name: drivers[name].open(), speed))
    return LANDINGS[-1]


PATIENCE = 5.0
"""Host seconds for those that stop; only one that fails uses them up, so a busy computer may take its time."""
SUBSETS = [s for n in range(5) for s in itertools.combinations(ACTUATORS, n)]


@pytest.fixture(scope="module")
def drivers(simulated_house: House) -> Iterator[dict[str, Any]]:
    """The real drivers as under the guard, opened on the fakes."""
    from lab.verbs.fakes import write_rig

    write_rig(simulated_house.fakes, simulated_house.rig)
    instruments = load_rig(simulated_house.rig).instruments
    clock = RigClock(20.0)
    made = {}
    for name in ACTUATORS:
        config = getattr(instruments, name)
        known = config if name != "arm" else config.model_copy(update={"timeout": 3.0})
        made[name] = under_guard(name, known, clock)
        made[name].open()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hosted, "STOP_WITHIN", PATIENCE)
        yield made
    for driver in made.values():
        driver.close()


@pytest.mark.parametrize(
    "failing",
    [s if len(s) < 2 or len(s) > 3 else pytest.param(s, marks=pytest.mark.long) for s in SUBSETS],
    ids=lambda s: "+".join(s) or "none",
)
def test_the_others_stop(
    house: House, drivers: dict[str, Any], failing: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(landing, "LEAST_TIME", PATIENCE)
    drivers["pressure"].set((30e3, 30e3, 30e3))
    drivers["valve"].set(True)
    for name in failing:
        house.fakes.switch.begin(name, "silence")
    if "arm" in failing:
        assert until(lambda: stale(drivers["arm"]))
    landed = landing_of(drivers, Safe(within=PATIENCE), 20.0)
    report = landed.make_safe(ACTUATORS, keep_vacuum=False)
    assert set(landed.going) == set(failing)
    house.fakes.switch.end()
    assert {s.instrument: s.confirmed for s in report.steps} == {n: n not in failing for n in ACTUATORS}, report
    assert report.confirmed is (not failing)
    assert until(lambda: not landed.going), "what answers again is landed"
    assert until(lambda: not stale(drivers["arm"]))


def stale(arm: Any) -> bool:
    try:
        arm.standing()
    except Exception:
        return True
    return False


def test_nothing_open_is_safe_and_says_so() -> None:
    assert SafeReport().confirmed and "nothing" in str(SafeReport())


def test_the_vacuum_is_kept_when_the_policy_says_so(house: House, drivers: dict[str, Any]) -> None:
    drivers["valve"].set(True)
    report = landing_of(drivers, Safe(), 20.0).make_safe(ACTUATORS, keep_vacuum=True)
    assert report.confirmed and "valve" not in {s.instrument for s in report.steps}
    assert house.fakes.plant.valve_on
    drivers["valve"].set(False)


class Refusing:
    """An actuator that refuses its stop, told in `told`, and shows nothing."""

    def __init__(self, name: str, told: list[str]) -> None:
        self.name, self.told = name, told

    def stop(self) -> None:
        self.told.append(self.name)
        raise RuntimeError("no")

    vent = stop

    def connect(self) -> None:
        pass

    def set(self, on: bool) -> None:
        self.stop()

    def standing(self) -> bool:
        raise RuntimeError("no")


def test_stops_are_sent_in_the_order_of_the_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landing, "HEAD_START", 60.0)  # a stop that is refused makes room for the next at once
    monkeypatch.setattr(landing, "LEAST_TIME", 1.0)
    told: list[str] = []
    report = landing_of({n: Refusing(n, told) for n in ORDER}, Safe(order=ORDER, within=0.1), 200.0).make_safe(ORDER, False)
    assert tuple(dict.fromkeys(told)) == ORDER
    assert not report.confirmed and all("did not accept the stop" in s.text for s in report.steps)


def test_a_stop_that_does_not_come_back_holds_up_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landing, "LEAST_TIME", 1.0)
    told: list[str] = []
    others_told = timing.Event()

    class Hanging(Refusing):
        def stop(self) -> None:
            assert others_told.wait(60.0)
            super().stop()

    class Last(Refusing):
        def stop(self) -> None:
            others_told.set()
            super().stop()

        vent = stop

    drivers = {n: {"valve": Hanging, "arm": Last}.get(n, Refusing)(n, told) for n in ORDER}
    landing_of(drivers, Safe(order=ORDER), 20.0).make_safe(ORDER, False)
    assert set(told) == set(ORDER), "the first comes back only after the last was told"


def test_nobody_waits_for_an_instrument_that_does_not_let_itself_be_opened() -> None:
    """The arm's controller and the gauge keep whoever opens them; the regulators are told, identified and read meanwhile."""
    told, freed, opened = timing.Event(), timing.Event(), list[str]()

    class Regulators:
        def connect(self) -> None:
            assert not opened

        def vent(self) -> None:
            told.set()

        def read(self) -> PressureSample:
            assert "pressure" in opened
            return PressureSample(0.0, (0.0,), (0.0,))

    class Arm:
        def stop(self) -> None: ...

        def standing(self) -> bool:
            return True

    def open_one(name: str) -> None:
        if name != "pressure":
            assert freed.wait(60.0)
        opened.append(name)

    owned = Owned({"arm": Arm(), "pressure": Regulators(), "gauge": object()}, opened)
    reports: list[SafeReport] = []
    landing_ = Landing(Safe(), owned, open_one, 20.0)
    thread = timing.Thread(target=lambda: reports.append(landing_.make_safe(ACTUATORS[:2], False, 60.0)), daemon=True)
    thread.start()
    assert told.wait(30.0) and until(lambda: opened == ["pressure"], 30.0)
    assert thread.is_alive()
    freed.set()
    thread.join(60.0)
    assert reports[0].confirmed and {s.instrument for s in reports[0].steps} == {"arm", "pressure"}


class Spine:
    """Its motion ends with `stop`."""

    moving, stops = False, 0

    def stop(self) -> None:
        self.stops += 1
        self.moving = False

    def read(self) -> SpineSample:
        return SpineSample(0.0, 0.1, 0.0, 0.1, self.moving, True)


def test_a_stop_that_overtook_a_command_is_sent_again() -> None:
    """The command was let through just before the landing and reaches the instrument after the first stop."""
    spine, looks = Spine(), iter([True, True])

    class Busy(set[str]):
        def __contains__(self, name: object) -> bool:
            if next(looks, False):
                return True
            if spine.stops == 2:
                spine.moving = True  # here it comes
            return False

    report = landing_of({"spine": spine}, Safe(), 20.0, Busy()).make_safe(["spine"], keep_vacuum=False)
    assert report.confirmed and spine.stops == 3 and not spine.moving


def test_an_instrument_that_is_confirmed_after_the_report_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landing, "LEAST_TIME", 0.2)
    back, late = timing.Event(), []

    class Valve:
        opened = 0

        def open(self) -> None:
            self.opened += 1
            if not back.is_set():
                raise Unreachable("valve", "cannot open it")

        def set(self, on: bool) -> None:
            if not back.is_set():
                raise Unreachable("valve", "lost")

        def read(self) -> ValveSample:
            return ValveSample(0.0, False)

    valve, lost = Valve(), set[str]()

    def reopen(name: str) -> None:
        valve.open()
        lost.discard(name)

    owned = Owned({"valve": valve}, ["valve"], lost)
    going = Landing(Safe(within=0.1), owned, reopen, 20.0, lambda step, seconds: late.append(step))
    report = going.make_safe(["valve"], keep_vacuum=False)
    assert not report.confirmed and going.going == ("valve",) and not late
    assert until(lambda: valve.opened > 2)
    back.set()
    assert until(lambda: bool(late))
    assert late[0].confirmed and going.going == ()


def test_a_new_landing_ends_the_attempts_of_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landing, "LEAST_TIME", 0.2)
    told: list[str] = []
    first = landing_of({"spine": Refusing("spine", told)}, Safe(within=0.1), 20.0)
    first.make_safe(["spine"], False)
    before = threading.active_count()
    first.make_safe(["spine"], False)
    assert first.going == ("spine",) and until(lambda: threading.active_count() <= before)
    first.end()
    assert first.going == ()


def test_a_command_that_does_not_come_back_keeps_the_landing_unconfirmed() -> None:
    landed = landing_of({"spine": Spine()}, Safe(within=0.1), 200.0, {"spine"})
    report = landed.make_safe(["spine"], keep_vacuum=False)
    assert not report.confirmed and "has not returned" in str(report)
