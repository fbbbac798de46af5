"""A line that drops out and returns behind the same path, in every phase: everything is vented and stopped, and confirmed. A
computer that stood still (SIGSTOP of all its processes, a paused virtual machine) goes on where it was."""

import itertools
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from house import House, inflate, until

import timing
from drivers.errors import InstrumentError, Unreachable, WrongDevice
from lab.files.config import load
from lab.files.inputs import read_case
from lab.files.rig_file import load_rig
from lab.guard import new_guard
from lab.guard.instruments import ACTUATORS
from lab.guard.messages import Event, RigLanded
from lab.guard.new_guard import make_safe_with_new_guard
from lab.rig import assembly
from lab.rig.assembly import Rig
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE, played, write_rig
from model.robot import Robot
from sim_fakes.rig import FakeRig
from tests.lab.commands import command
from tests.lab.virtual_lab import settings
from tests.sim_fakes.plugged import Plugged
from tests.simulated.bench import raises
from timing import RigClock

FIRST, SECOND = "alicat+dynamixel", "smc_itv+tmcl"
NETWORK = ("arm", "force")
"""Watched by the program, and slow to connect; the others are polled by the guard."""
OUT = 0.7
"""Host seconds for which a cable is out."""
LINES = (
    *((FIRST, name) for name in ("pressure", "spine", "valve", "gauge", *NETWORK)),
    *((SECOND, name) for name in ("pressure", "pressure2", "spine")),
)
PHASES = ("ramping", "reading", "landing")
CELLS = [
    pytest.param(*line, phase, marks=[pytest.mark.long] if line[1] in NETWORK or (k + j) % 3 else [])
    for (k, line), (j, phase) in itertools.product(enumerate(LINES), enumerate(PHASES))
]
"""Each line in each phase; without `make test LONG=1` each in one, and each phase at several."""


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    with FakeRig(speed=20.0, seed=2, regulators="smc_itv", spine="tmcl") as fakes:
        yield House(fakes, tmp_path_factory.mktemp("second") / "rig.yaml")


@pytest.fixture
def real_second(tmp_path: Path) -> Iterator[House]:
    with FakeRig(speed=20.0, seed=2, regulators="smc_itv", spine="tmcl") as fakes:
        made = House(fakes, tmp_path / "rig.yaml")
        write_rig(fakes, made.rig, {"instruments": PATIENT["instruments"], "limits": {"max_age": 5.0}})
        yield made


@pytest.fixture
def of(house: House, second: House) -> Iterator[dict[str, House]]:
    write_rig(second.fakes, second.rig)
    second.latch.unlink(missing_ok=True)
    yield {FIRST: house, SECOND: second}
    second.fakes.switch.end()


def use(house: House, name: str) -> None:
    """Leave out what a cell does not need."""
    house.change(without=("mocap",) if name in NETWORK else ("mocap", *NETWORK))


def experiment(rig: Rig, ramps: bool) -> None:
    """Command and watch as an experiment does, until something is raised; then land."""
    rig.watch.over([n for n in rig.identities if n not in ("arm_state",)])
    pressure, give_up = 60e3, timing.now() + 60.0
    with pytest.raises((InstrumentError, RigLanded)):
        while timing.now() < give_up:
            if ramps:
                pressure = min(pressure + 100.0, 100e3)
                rig.actuators.pressure.set((pressure,) * 3)
            else:
                rig.actuators.pressure.read()
            if "arm" in rig.identities:
                rig.actuators.arm.moving()
            rig.watch.look()
    rig.make_safe()


@pytest.mark.parametrize(("kind", "name", "phase"), CELLS)
def test_the_rig_is_made_safe_once_the_line_is_back(of: dict[str, House], kind: str, name: str, phase: str) -> None:
    house = of[kind]
    use(house, name)
    fakes = house.fakes
    with house.opened(inflated=True) as rig:
        fakes.switch.drop_out(name, OUT)
        if phase == "landing":
            rig.make_safe()
        else:
            experiment(rig, ramps=phase == "ramping")
    assert house.landed()


@pytest.mark.real
@pytest.mark.parametrize(
    ("kind", "name"), [pytest.param(*line, marks=[pytest.mark.long] if line != (FIRST, "pressure") else []) for line in LINES]
)
def test_an_inflated_rig_whose_guard_was_killed_is_landed_once_a_line_is_back(
    house: House, real_second: House, kind: str, name: str
) -> None:
    house = {FIRST: house, SECOND: real_second}[kind]
    use(house, name)
    with house.opened(inflated=True, despite_latch=True) as rig:
        rig.actuators._process.kill()
        rig.actuators._process.wait()
        house.fakes.switch.drop_out(name, OUT)
        names = [n for n in ACTUATORS if n in rig.identities]
        report = make_safe_with_new_guard(rig.file, RigClock(20.0), names, "test", unlock=True)
        assert report.confirmed, report
    assert house.landed()


@pytest.mark.parametrize("name", ["pressure", "spine", "valve", "gauge"])
def test_the_guard_lands_everything_by_itself_and_names_the_line(small: House, name: str) -> None:
    with small.opened(inflated=True) as rig:
        small.fakes.switch.drop_out(name, OUT)
        assert small.landed()
        assert until(lambda: rig.vital.landed is not None)
        landed = rig.vital.landed
        assert landed is not None and isinstance(landed.error, Unreachable) and landed.error.instrument == name
        raises(Unreachable, f"{name}: lost ", rig.actuators.pressure.set, (10e3, 10e3, 10e3))


def test_a_line_that_returns_after_the_report_is_still_landed_and_that_is_reported(small: House) -> None:
    small.change(safe={"within": 0.1})
    events: list[Event] = []
    with Rig(load_rig(small.rig)) as rig:
        rig.actuators._on_event = events.append
        assert rig.open_all(str) == {}
        inflate(rig, small)
        small.fakes.switch.begin("pressure", "disconnect")
        assert until(lambda: any(e.kind == "landed" for e in events))
        report = rig.make_safe()
        assert [s.instrument for s in report.steps if not s.confirmed] == ["pressure"]
        assert small.latch.exists()
        raises(InstrumentError, None, rig.actuators.pressure.set, (10e3, 10e3, 10e3))
        small.fakes.switch.end()
        assert small.landed()
        assert until(lambda: any(e.kind == "confirmed" for e in events))
        (late,) = [e for e in events if e.kind == "confirmed"]
        assert late.report is not None and late.report.said.startswith("vented: confirmed ")


def test_the_guard_lives_on_after_its_program_and_lands_what_comes_back(small: House) -> None:
    small.change(safe={"within": 0.1})
    with small.opened(inflated=True) as rig:
        small.fakes.switch.begin("pressure", "disconnect")
        assert not rig.make_safe().confirmed
    assert any("pressure" in text and "tries again" in text for text in rig.notices)
    assert small.highest() > 40e3 and small.latch.exists()
    small.fakes.switch.end()
    assert small.landed()
    assert "vented: confirmed" in small.rig.with_suffix(".guard.log").read_text()
    with small.opened():  # the guard has ended by itself
        pass


def test_a_guard_that_ended_as_it_was_told_needs_no_rescue(small: House, monkeypatch: pytest.MonkeyPatch) -> None:
    rescues: list[str] = []
    monkeypatch.setattr(assembly, "make_safe_after_loss", lambda *about: rescues.append("rescue"))
    with small.opened() as rig:
        guard_ended = rig.actuators._end

        def noticed(lives_on: bool = False) -> None:
            guard_ended(lives_on)
            assert until(lambda: bool(rig.actuators.lost))  # its pipe has ended

        monkeypatch.setattr(rig.actuators, "_end", noticed)
    assert rescues == []


@pytest.mark.real
def test_a_rescue_goes_on_after_its_program(small: House, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(new_guard, "REACH_WITHIN", 0.5)  # of the program; its rescue goes on for longer
    with small.opened(inflated=True) as rig:
        small.fakes.switch.begin("pressure", "disconnect")
        os.kill(rig.actuators._process.pid, signal.SIGKILL)
        report = rig.make_safe()
        assert [s.instrument for s in report.steps if not s.confirmed] == ["pressure"]
    assert small.highest() > 40e3 and small.latch.exists()
    small.fakes.switch.end()
    assert small.landed()


def test_an_adapter_that_comes_back_under_the_name_of_another_is_landed_and_not_used_again(
    small: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    spine, gauge = (small.fakes.lines[name].port for name in ("spine", "gauge"))
    plugged = Plugged(monkeypatch, [line.port for line in small.fakes.lines.values()])
    with small.opened(inflated=True) as rig:
        small.fakes.lines["spine"].unplug()
        assert small.vented()
        plugged.exchange(spine, gauge)
        small.fakes.lines["spine"].plug()
        assert until(lambda: rig.make_safe().confirmed)
        raises(WrongDevice, "is the USB adapter .* as before", rig.actuators.resume)
        plugged.exchange(spine, gauge)
        rig.actuators.resume()
        inflate(rig, small)


# ------------------------------------------------------------------ a computer that stood still
ROBOT = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"
LONG = 12.0
"""Host seconds; Motive forgets a client after 10."""
SHORT = settings("pressures=[30 kPa]", "chambers=[1]", "rate=10 kPa/s", *PATIENT_SETTLE)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    """A robot without a spine: a length unit's own watchdog would have stopped it, and that ends a run."""
    path = tmp_path_factory.mktemp("three") / "rig.yaml"
    with FakeRig(speed=5.0, seed=7, truth=played(load(ROBOT, Robot)), without=("spine",)) as fakes:
        present = fakes.rig_file()["instruments"]
        changes = {"instruments": {k: v for k, v in PATIENT["instruments"].items() if k in present}}
        write_rig(fakes, path, {**PATIENT, **changes}, ROBOT)
        yield House(fakes, path)


def mocap(house: House) -> set[tuple[str, int]]:
    assert house.fakes.mocap is not None
    return set(house.fakes.mocap.clients)


def ramping(house: House) -> bool:
    return 5e3 < float(house.fakes.plant.regulator.max()) < 25e3


def reading(house: House) -> bool:
    return house.highest() > 28e3


@pytest.mark.real
@pytest.mark.parametrize(
    ("phase", "seconds"),
    [
        (reading, LONG),
        pytest.param(ramping, LONG, marks=pytest.mark.long),
        pytest.param(lambda house: bool(mocap(house)), LONG, marks=pytest.mark.long, id="at zero"),  # before any pressure
        pytest.param(ramping, 3.0, marks=pytest.mark.long),
        pytest.param(reading, 40.0, marks=pytest.mark.long),
    ],
)
def test_a_run_goes_on_after_a_standstill_without_a_person(
    three: House, tmp_path: Path, phase: Callable[[House], bool], seconds: float
) -> None:
    three.fakes.troubles.clear()
    assert until(lambda: not mocap(three))
    with command("run", "bending", "--rig", three.rig, "--out", tmp_path, *SHORT) as process:
        assert until(lambda: phase(three) or process.poll() is not None, 120)
        root = psutil.Process(process.pid)
        stopped = [root, *root.children(recursive=True)]  # as a suspended computer does; the instruments go on
        for one in stopped:
            one.send_signal(signal.SIGSTOP)
        timing.sleep(seconds)
        for one in stopped:
            one.send_signal(signal.SIGCONT)
        said, _ = process.communicate(timeout=300)
    assert process.returncode in (0, 3), said
    assert three.fakes.troubles == []
    (file,) = tmp_path.glob("*.mcap")
    rows = read_case([file]).table
    assert [(r.step, r.branch, round(max(r.pressures) / 30e3)) for r in rows] == [
        (1, "load", 0), (2, "load", 1), (3, "unload", 0),
    ], said  # fmt: skip
    assert (seconds > LONG / 2) == ("stood still" in said)
    assert until(lambda: three.highest() < 5e3)
