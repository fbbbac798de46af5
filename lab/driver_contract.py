"""What every driver must do, tried on its fake: `pytest --pyargs lab.driver_contract`, the project's own drivers and those
of installed packages too. `-k NAME` tries one."""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import timing
from drivers.configs import HOSTS, PORTS
from drivers.errors import InstrumentError, LimitExceeded, StaleReading, Unreachable
from drivers.interfaces import ArmSample, BodySample, Identity, PressureSample
from sim_fakes.instrument import FakePart, Site
from sim_fakes.plant import Plant
from sim_fakes.pty_fake import Faults, PtyFake
from sim_fakes.ur.process import free_host
from timing import RigClock

from .files.rig_file import drivers
from .verbs.fakes import PATIENT, found_fakes

SPEED = 20.0
CHANNELS = 3
"""Of regulators whose table sets no `max_length` of `chambers`."""
MARKERS = 2
WITHIN = 30.0
"""Host seconds for what takes a fraction of one: a busy computer is no fault."""
SLACK = 5.0
"""Host seconds after `max_age` within which a stream without a good sample must be stale, on a busy computer too."""
REFUSED = 30
"""Damaged answers in a row without a sample by which a driver shows that it refuses them."""
PLACES = 4
"""Characters of an answer, counted back from the end of what its checksum covers, that are changed one at a time."""
MAX_AGE = 0.5
"""s, host time: the age that the contract asks of a stream, where its table allows it."""
AGO = 1000.0
"""Host seconds since the rig's clock began: its time is neither that since the start of a driver nor the host's."""
ASKED = 20e3
"""Pa."""
OFFER = "give its part `faults = Faults()` of sim_fakes.pty_fake, and send each whole answer by its `send`, through the faults"
CALLS: dict[str, tuple[Callable[[Any], Any], ...]] = {
    "pressure": (lambda d: d.read(), lambda d: d.set((0.0,) * d.channels), lambda d: d.vent()),
    "spine": (lambda d: d.read(), lambda d: d.home(), lambda d: d.stop(), lambda d: d.move_to(0.1, 0.01)),
    "valve": (lambda d: d.read(), lambda d: d.set(False)),
    "gauge": (lambda d: d.read(),),
    "force": (lambda d: d.latest(), lambda d: d.zero(1)),
    "arm": (lambda d: d.moving(), lambda d: d.standing(), lambda d: d.stop()),
    "mocap": (lambda d: d.latest(),),
    "sensor": (lambda d: d.latest(),),
}
"""What may be asked of each kind."""
STREAMS = ("force", "mocap", "sensor")
POLLED = ("pressure", "spine", "valve", "gauge", "force")
"""Answers within milliseconds, so time-outs may be short; the others share the processors with everything else."""


@dataclass
class DriverOnFake:
    """A driver and the fake that it reaches."""

    role: str
    driver: Any
    parts: list[FakePart]
    plant: Plant
    config: Any
    clock: RigClock = field(default_factory=lambda: RigClock(SPEED, timing.now() - AGO))
    samples: list[Any] = field(default_factory=list)
    arrived: list[float] = field(default_factory=list)
    """When it sent them, rig time."""

    def another(self, **changes: Any) -> Any:
        """A driver of the same kind with another table in rig.yaml."""
        kind = drivers()[self.config.driver]
        config = kind.config.model_validate(self.config.model_dump() | changes)
        return kind.make("it", config, self.clock, *((self.take, lambda text: None) if self.role in STREAMS else ()))

    def take(self, sample: Any) -> None:
        """Keep a sample of a stream; its sink."""
        self.arrived.append(self.clock.now())
        self.samples.append(sample)

    def strict(self) -> Any:
        """A stream that is soon too old, opened, and its configuration."""
        self.config = _config(type(self.config), self.config.model_dump(), {"max_age": MAX_AGE})
        self.driver = self.another()
        self.driver.open()
        assert until(lambda: len(self.samples) >= 3 and answers(self.driver.latest)), (
            f"a sound line gave {len(self.samples)} samples within {WITHIN:g} s, and latest() none"
        )
        return self.driver

    def quiet(self) -> bool:
        """Whether a stream has sent nothing for its `max_age` or three of its longest intervals."""
        longest = max(np.diff(self.arrived[:3]), default=0.0) / SPEED
        return (self.clock.now() - self.arrived[-1]) / SPEED > max(self.config.max_age, 3 * longest)

    def hasty(self) -> Any:
        """One that gives up soon, where it can."""
        if self.role in POLLED and hasattr(self.config, "timeout"):
            with contextlib.suppress(ValidationError):
                return self.another(timeout=0.05)
        return self.driver

    @contextlib.contextmanager
    def state(self) -> Iterator[Any]:
        """An arm, opened, and the stream of its state."""
        self.driver.open()
        make = drivers()[self.config.driver].make_state
        assert make is not None
        with contextlib.closing(make("it", self.config, self.clock, self.take)) as state:
            state.open()
            yield state

    @property
    def disturbed(self) -> list[Any]:
        """The parts whose line can be disturbed."""
        return [part for part in self.parts if isinstance(getattr(part, "faults", None), Faults)]

    def lines(self) -> list[Any]:
        """The same; skips the test where there is none."""
        return self.disturbed or pytest.skip(f"no line of its fake can be disturbed: {OFFER}")

    def silence(self) -> None:
        """Let nothing come from the instrument any more."""
        for line in self.disturbed:
            line.faults.silent = True
        if not self.disturbed:
            for part in self.parts:
                part.stop()

    def falsified(self, place: int, one: bool = False) -> contextlib.AbstractContextManager[list[bytes]]:
        """Change one character of every answer, and leave its checksum as it is.

        `place` counts the characters back from the end of what the checksum covers. With `one`, only answers to the first
        request and to its repeats are changed, so that nothing but its checksum tells, where the fake notes its requests."""
        covered = next((part.checked for part in self.disturbed if getattr(part, "checked", None)), None)
        if covered is None:
            pytest.skip(
                "its fake declares no checksum; if answers carry one, set `checked` of its part to the bytes that it covers, "
                "such as slice(0, -3)"
            )
        first: list[bytes] = []

        def change(answer: bytes, request: bytes) -> bytes:
            first[:] = first or [request]
            return one_changed(answer, covered, place) if not one or request == first[0] else answer

        return self.rewritten(change)

    def numbered(self, driver: Any) -> bool:
        """Whether equal calls send different requests, such as numbered ones: a repeat is then not known by its bytes."""
        requests: list[bytes] = []
        with self.rewritten(lambda answer, request: requests.append(request) or answer):  # type: ignore[func-returns-value]
            for _ in range(2):
                outcome(driver.read)
        half = len(requests) // 2
        return requests[:half] != requests[half:]

    @contextlib.contextmanager
    def rewritten(self, change: Callable[[bytes, bytes], bytes]) -> Iterator[list[bytes]]:
        """Change all that the fake's parts send by `send`; gives what arrives instead where it differs.

        `change` takes an answer and the newest request that its line has noted, empty where there is none."""
        changed: list[bytes] = []
        lines = [part for part in self.disturbed if hasattr(part, "send")]
        if not lines:
            pytest.skip(f"no part of its fake sends its answers by `send`: {OFFER}")

        def through(line: Any, send: Callable[..., None], answer: bytes, *more: Any, **named: Any) -> None:
            after = change(answer, line.requests[-1] if getattr(line, "requests", ()) else b"")
            if after != answer:
                changed.append(after)
            send(after, *more, **named)

        with pytest.MonkeyPatch.context() as patch:
            for line in lines:
                patch.setattr(line, "send", functools.partial(through, line, line.send))
            yield changed


def units(*roles: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Try every registered driver of these kinds that has a fake; an error in the fake's own code goes before any other."""
    names = [name for name, fake in found_fakes().usable.items() if fake.role in (roles or CALLS) and name in drivers()]

    def decorated(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def tried(unit: DriverOnFake, **others: Any) -> None:
            try:
                test(unit, **others)
            finally:
                for part in unit.parts:
                    if error := getattr(part, "ended_by", None):
                        raise AssertionError(f"the fake's own code failed: {type(part).__name__} ended by {error!r}") from error

        return pytest.mark.parametrize("unit", names, indirect=True)(tried)

    return decorated


@pytest.fixture
def unit(request: pytest.FixtureRequest) -> Iterator[DriverOnFake]:
    """The driver of one name on its fake, not yet opened."""
    fake = found_fakes().usable[request.param]
    kind = drivers()[request.param]
    limits = kind.config.model_fields["chambers"].metadata if fake.role == "pressure" else []
    channels = next((limit.max_length for limit in limits if hasattr(limit, "max_length")), CHANNELS)
    chambers = np.roll(np.arange(1, max(9, channels) + 1), 1)  # 9, 1, 2 ..: an order in which no driver counts by itself
    hoses = tuple(tuple(group.tolist()) for group in np.array_split(chambers, channels))
    site = Site(Plant(len(chambers)), RigClock(SPEED), 1, hoses, fake.full_scale, host=free_host(), markers=MARKERS)
    parts = list(fake.plug(site))
    for part in parts:
        part.start()
    table: dict[str, Any] = {"driver": request.param, **fake.table(site, parts)}
    if fake.role == "pressure":
        table |= {"chambers": hoses, "full_scale": site.full_scale, "max_pressure": 2 * ASKED}
    settings = {"timeout": 0.5} if fake.role in POLLED else PATIENT["instruments"]["arm"]
    tried = DriverOnFake(fake.role, None, parts, site.plant, _config(kind.config, table, settings))
    tried.driver = tried.another()
    yield tried
    tried.driver.close()
    for part in parts:
        part.stop()


def _config(kind: type[Any], table: dict[str, Any], changes: dict[str, float]) -> Any:
    """The table of rig.yaml with those of these changes that this driver knows and bears."""
    try:
        config = kind.model_validate(table)
    except ValidationError as error:
        pytest.fail(f"the driver rejects the rig.yaml table of its fake: {error}")
    for key in changes.keys() & kind.model_fields:
        with contextlib.suppress(ValidationError):
            config = kind.model_validate(config.model_dump() | {key: changes[key]})
    return config


def until(condition: Callable[[], bool], within: float = WITHIN) -> bool:
    """Look until the condition holds, for some host seconds."""
    end = timing.now() + within
    while not condition():
        if timing.now() > end:
            return False
        timing.sleep(0.01)
    return True


@units()
def test_it_says_who_it_is_and_takes_a_second_open(unit: DriverOnFake) -> None:
    for _ in range(2):
        identity = unit.driver.open()
        assert isinstance(identity, Identity), f"open() returned {identity!r}, needed an Identity"
        assert identity.maker and identity.model, f"open() left maker or model empty: {identity}"
        if unit.role == "arm":
            unit.driver.close()  # nobody else may take control of it meanwhile


@units()
def test_closed_it_refuses_every_call_with_its_name(unit: DriverOnFake) -> None:
    for when in ("never opened", "closed again"):
        for call in CALLS[unit.role]:
            with pytest.raises(InstrumentError) as caught:
                call(unit.driver)
            assert caught.value.instrument == "it", when
        unit.driver.open()
        unit.driver.close()
        unit.driver.close()


@units()
def test_a_port_that_is_not_there_is_unreachable(unit: DriverOnFake) -> None:
    key = next(key for key in (*PORTS, *HOSTS) if isinstance(getattr(unit.config, key, None), str | tuple))  # no number of a port
    nowhere = f"/dev/none-{key}" if key in PORTS else free_host()
    each = [f"{nowhere}{i}" for i, _ in enumerate(unit.config.ports)] if key == "ports" else nowhere
    with pytest.raises(Unreachable, match=nowhere):
        unit.another(**{key: each}).open()


@units()
@pytest.mark.parametrize("fault", ["silent", "corrupt", "truncate", "garbage"])
def test_a_disturbed_line_is_told_as_an_instrument_error_or_overcome(unit: DriverOnFake, fault: str) -> None:
    lines, quick = unit.lines(), unit.hasty()
    assert until(lambda: answers(quick.open))
    for line in lines:
        setattr(line.faults, fault, b"\x00#\x7f!" if fault == "garbage" else True)
    for call in CALLS[unit.role]:
        if isinstance(error := outcome(call, quick), InstrumentError):
            assert error.instrument == "it" and error.message
    for line in lines:
        line.faults = Faults()
    quick.close()


def outcome(call: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a call returns, or the instrument's error that it raises."""
    try:
        return call(*arguments)
    except InstrumentError as error:
        return error


def answers(call: Callable[[], Any]) -> bool:
    """Whether a call succeeds: on a busy computer a quick time-out may pass."""
    return not isinstance(outcome(call), InstrumentError)


def damaged(answer: bytes, _: bytes) -> bytes:
    """An answer of which no byte is right but the ends of its lines."""
    return bytes(byte if byte in b"\r\n" else byte ^ 0x40 for byte in answer)


def one_changed(answer: bytes, covered: slice, place: int) -> bytes:
    """An answer of the same form with another digit, or in a binary one another bit, where its checksum covers it."""
    where = range(len(answer))[covered]
    digits = [at for at in where if answer[at : at + 1].isdigit()]
    places = digits if digits and answer.isascii() and answer.strip().decode().isprintable() else where
    if not places:
        return answer
    at = places[max(-1 - place, -len(places))]
    return answer[:at] + bytes([answer[at] ^ 1]) + answer[at + 1 :]


def other(words: list[bytes]) -> Callable[[bytes, bytes], bytes]:
    """Writes other words of the same form for these: K25 becomes L36."""
    kinds = (b"ABCDEFGHIJKLMNOPQRSTUVWXYZ", b"abcdefghijklmnopqrstuvwxyz", b"0123456789")
    next_one = bytes.maketrans(b"".join(kinds), b"".join(kind[1:] + kind[:1] for kind in kinds))

    def change(answer: bytes, _: bytes) -> bytes:
        for word in words:
            answer = answer.replace(word, word.translate(next_one))
        return answer

    return change


def must_not_open(driver: Any, line: str, remedy: str, sent: Sequence[bytes] = ()) -> None:
    """Fails when the driver opens, or raises anything but one of the drivers' errors; `sent`: the answers that were changed."""
    wrong = ""
    try:
        wrong = f"returned {driver.open()}, needed an error of drivers.errors"
    except InstrumentError as error:
        if error.instrument != "it":
            wrong = f"raised {error!r} for {error.instrument!r}, needed 'it'"
    except Exception as error:  # noqa: BLE001 - whatever else it is, it is wrong
        wrong = f"ended by {error!r}, needed an error of drivers.errors"
    if wrong:
        such = f", such as {sent[-1]!r}," if sent else ""
        pytest.fail(f"open() on {line}{such} {wrong}; {remedy}")


@units()
def test_it_does_not_open_on_a_silent_line(unit: DriverOnFake) -> None:
    unit.silence()
    must_not_open(unit.driver, "a silent line", "wait for an answer up to the time-out, then raise Unreachable")


@units()
def test_it_does_not_open_on_a_line_whose_answers_are_all_damaged(unit: DriverOnFake) -> None:
    remedy = "check the form of each answer, then raise Unreachable or WrongDevice"
    with unit.rewritten(damaged) as sent:
        must_not_open(unit.driver, "a line on which every answer was damaged", remedy, sent)


@units()
def test_it_does_not_open_on_answers_whose_checksum_is_wrong(unit: DriverOnFake) -> None:
    quick, remedy = unit.hasty(), "verify the checksum of each answer, then raise Unreachable or WrongDevice"
    for place in range(PLACES):
        with unit.falsified(place) as sent:
            must_not_open(quick, "a line on which one character of every answer was changed", remedy, sent)
        quick.close()


@units(*(role for role in POLLED if role not in STREAMS))
def test_no_call_returns_on_an_answer_whose_checksum_is_wrong(unit: DriverOnFake) -> None:
    quick = unit.hasty()
    for place, call in itertools.product(range(PLACES), CALLS[unit.role]):
        assert until(lambda: answers(quick.open))
        with unit.falsified(place, one=not unit.numbered(quick)) as sent:
            result = outcome(call, quick)
            if isinstance(result, InstrumentError):
                assert result.instrument == "it", f"{result!r} is for {result.instrument!r}, needed 'it'"
            else:
                assert not sent, (
                    f"a call returned {result} on the answers {sent}, in each of which one character was changed; verify the "
                    "checksum of each answer, then raise BadReply"
                )
        quick.close()


@units()
def test_it_does_not_open_another_device(unit: DriverOnFake) -> None:
    remedy = "compare the answer with the instrument that the driver is for, then raise WrongDevice"
    disguised = [part for part in unit.disturbed if "wrong_id" in getattr(part, "own_faults", ())]
    for part in disguised:
        name, value = part.own_faults["wrong_id"]
        part.faults.extra[name] = value
    if disguised:
        must_not_open(unit.driver, "a line with another device", remedy)
        return
    assert not any(getattr(part, "checked", None) for part in unit.parts), (
        "answers of this fake carry a checksum, so that another maker put into them is refused for the checksum alone: declare "
        "own_faults = {'wrong_id': (NAME, VALUE)}, and answer as another device, checksum included, while faults.extra[NAME] is "
        "VALUE"
    )
    identity = unit.driver.open()
    unit.driver.close()
    words = [word.encode() for word in f"{identity.maker} {identity.model}".split() if len(word) > 1]
    with unit.rewritten(other(words)) as sent:
        if not answers(unit.driver.open):
            return
        unit.driver.close()
        if not sent:
            pytest.skip(f"its fake sends neither maker nor model of {identity}")
        must_not_open(unit.driver, f"a line with another device than {identity.model}", remedy, sent)


@units()
def test_close_leaves_the_port_to_others(unit: DriverOnFake) -> None:
    port = next((part.port for part in unit.parts if isinstance(part, PtyFake)), "")
    open_before = handles(port)
    unit.driver.open()
    unit.driver.close()
    assert handles(port) <= open_before, (
        f"after close() {port} is open {handles(port)} times in this process, before open() it was {open_before} times; close it"
    )
    with contextlib.closing(unit.another()) as second:
        error = outcome(second.open)
        assert not isinstance(error, InstrumentError), (
            f"after close() of a first driver a second could not open the instrument: {error}; close its port"
        )


def handles(port: str) -> int:
    """How often this process has a port open; 0 where the system does not tell."""
    return sum(handle.resolve() == Path(port).resolve() for handle in (Path("/proc/self/fd").glob("*") if port else ()))


@units(*STREAMS)
def test_a_stream_that_falls_silent_is_stale_after_max_age(unit: DriverOnFake) -> None:
    driver = unit.strict()
    unit.silence()
    kind = StaleReading if unit.disturbed else InstrumentError  # an ended connection may be told as such
    assert until(lambda: isinstance(outcome(driver.latest), kind), unit.config.max_age + SLACK), (
        f"{SLACK:g} s after the line had been silent for max_age = {unit.config.max_age:g} s, latest() gave "
        f"{outcome(driver.latest)!r}; needed {kind.__name__}: compare the age of the newest sample, in host time, with max_age"
    )


@units(*STREAMS)
def test_a_stream_hands_over_no_damaged_answer(unit: DriverOnFake) -> None:
    unit.strict()
    hands_over_none(unit, unit.rewritten(damaged), "every answer is damaged", "check the form of each answer")


@units(*STREAMS)
def test_a_stream_hands_over_no_answer_whose_checksum_is_wrong(unit: DriverOnFake) -> None:
    unit.strict()
    what = "one character of every answer is changed"
    for place in range(PLACES):
        before = unit.driver.lost
        hands_over_none(unit, unit.falsified(place), what, "verify the checksum of each answer")
        assert until(lambda before=before: unit.driver.lost > before, SLACK), (  # type: ignore[misc]
            f"lost stays {before} while {what}; count each of them in lost"
        )


def hands_over_none(unit: DriverOnFake, line: contextlib.AbstractContextManager[list[bytes]], what: str, remedy: str) -> None:
    """Fails when a stream still hands over samples on a disturbed line, or a thread of its driver ends."""
    sample_count, sent_by_then = 0, 0  # samples, and the disturbed answers that had been sent when the newest came

    def refused() -> bool:
        nonlocal sample_count, sent_by_then
        if sample_count != len(unit.samples):
            sample_count, sent_by_then = len(unit.samples), len(sent)
        return len(sent) - sent_by_then >= REFUSED

    crashed: list[str] = []  # how threads ended meanwhile by what is no error of an instrument
    with pytest.MonkeyPatch.context() as patch, line as sent:
        patch.setattr(threading, "excepthook", lambda args: crashed.append(repr(args.exc_value)))
        still = not until(lambda: bool(crashed) or refused(), unit.config.max_age + SLACK) and not unit.quiet()
    assert not crashed, (
        f"a thread of the driver ended by {crashed[0]} on the answer {sent[-1:]}; {remedy}, count a damaged one in lost and go on"
    )
    assert not still, (
        f"the driver still hands over samples, the last is {unit.samples[-1]}, while {what}, such as {sent[-1:]}; {remedy} "
        "and count a damaged one in lost"
    )


@units(*STREAMS)
def test_samples_have_the_time_of_the_rig_s_clock(unit: DriverOnFake) -> None:
    began = unit.clock.now()
    unit.driver.open()
    assert until(lambda: len(unit.samples) >= 3)
    for sample, arrived in zip(unit.samples[:3], unit.arrived[:3], strict=True):
        assert began <= sample.t <= arrived, (
            f"a sample has t = {sample.t:.3f} s, the rig's clock was at {began:.3f} s before open() and at {arrived:.3f} s "
            "when the sample came; set t to now() of the clock that the driver is given"
        )


@units(*(role for role in POLLED if role not in STREAMS))
def test_a_reading_is_new_and_has_the_time_of_the_rig_s_clock(unit: DriverOnFake) -> None:
    unit.driver.open()
    for _ in range(2):
        began = unit.clock.now()
        sample = unit.driver.read()
        assert began <= sample.t <= unit.clock.now(), (
            f"read() gave t = {sample.t:.3f} s, called at {began:.3f} s of the rig's clock; ask the instrument at each call and "
            "set t to now() of the clock that the driver is given"
        )


@units("gauge")
def test_a_gauge_reads_the_plant_s_absolute_pressure(unit: DriverOnFake) -> None:
    unit.driver.open()
    for truth in (101_325.0, 61_325.0, 21_325.0):  # each within a hundredth of full scale
        with unit.plant.lock:
            unit.plant.vacuum_absolute = truth
        assert until(lambda truth=truth: abs(unit.driver.read().absolute - truth) < 1e3), (  # type: ignore[misc]
            f"read() gave {unit.driver.read().absolute:g} Pa, in the spine are {truth:g} Pa absolute: check unit, offset, and "
            "that each call asks the instrument anew"
        )


@units("valve")
def test_a_valve_switches_the_vacuum_and_reads_it_back(unit: DriverOnFake) -> None:
    unit.driver.open()
    for on in (True, False):
        unit.driver.set(on)
        assert until(lambda on=on: unit.plant.valve_on == on == unit.driver.read().on), (  # type: ignore[misc]
            f"after set({on}) the valve of the plant is {unit.plant.valve_on}, read() gives {unit.driver.read().on}"
        )


@units("spine")
def test_a_length_unit_pays_out_the_length_that_it_reads(unit: DriverOnFake) -> None:
    unit.driver.open()
    unit.driver.home()
    assert until(lambda: unit.driver.read().homed and not unit.driver.read().moving)
    goal = unit.driver.move_to(0.05, unit.config.max_speed)
    assert until(lambda: not unit.driver.read().moving and abs(unit.driver.read().length - goal) < 1e-3)
    assert until(lambda: abs(unit.plant.spine_drive - goal) < 1e-3), (
        f"read() gives {unit.driver.read().length:.4f} m, the unit has paid out {unit.plant.spine_drive:.4f} m: check the scale"
    )


@units("pressure")
def test_each_channel_fills_its_own_chambers_and_no_other(unit: DriverOnFake) -> None:
    unit.driver.open()
    for channel, chambers in enumerate(unit.config.chambers):
        asked = tuple(ASKED if c == channel else 0.0 for c in range(unit.driver.channels))
        assert until(lambda asked=asked: near(unit.driver.set(asked), asked)), (  # type: ignore[misc]
            f"set({asked}) never confirmed these set-points (Pa): {unit.driver.set(asked)}"
        )
        regulator = [ASKED if number in chambers else 0.0 for number in range(1, unit.plant.chambers + 1)]
        assert until(lambda want=regulator: near(unit.plant.regulator, want)), (  # type: ignore[misc]
            f"channel {channel + 1} at {ASKED:g} Pa must inflate chambers {chambers} alone; the chambers are told "
            f"{np.round(unit.plant.regulator).tolist()} Pa: are channels swapped?"
        )
    sample = unit.driver.read()
    assert isinstance(sample, PressureSample)
    assert len(sample.setpoint) == len(sample.measured) == unit.driver.channels, f"{sample}: one value per channel is needed"
    assert near(sample.setpoint, asked), f"read() gives set-points {sample.setpoint} Pa after set({asked})"


@units("pressure")
def test_what_is_measured_is_the_plant_s_pressure(unit: DriverOnFake) -> None:
    unit.driver.open()
    truth = [1e3 * chamber for chamber in range(1, unit.plant.chambers + 1)]
    with unit.plant.lock:
        unit.plant.chamber_pressure[:] = truth
    wanted = [sum(truth[c - 1] for c in chambers) / len(chambers) for chambers in unit.config.chambers]
    assert until(lambda: near(unit.driver.read().measured, wanted)), (
        f"read() measured {unit.driver.read().measured} Pa, the chambers hold {wanted} Pa: check unit, offset and order"
    )


@units("pressure")
def test_set_points_keep_range_and_rate(unit: DriverOnFake) -> None:
    unit.driver.open()
    beyond = (1e9,) * unit.driver.channels
    assert until(lambda: near(unit.driver.set(beyond), (2 * ASKED,) * unit.driver.channels)), (
        f"set({beyond}) must be clipped to max_pressure {2 * ASKED:g} Pa, confirmed were {unit.driver.set(beyond)} Pa"
    )
    assert max(unit.driver.set(beyond)) <= 2 * ASKED * (1 + 1e-9), f"set() went beyond max_pressure {2 * ASKED:g} Pa"
    unit.driver.close()
    with contextlib.closing(unit.another(max_rate=1.0)) as slow:
        slow.open()
        confirmed = slow.set((ASKED,) * slow.channels)
        assert max(confirmed) < ASKED / 2, f"at max_rate 1 Pa/s the first set() confirmed {confirmed} Pa: the rate is not kept"
        for wrong in ((math.nan,) * slow.channels, (math.inf,) * slow.channels, (0.0,) * (slow.channels + 1)):
            with pytest.raises(LimitExceeded):
                slow.set(wrong)


@units("pressure")
def test_vent_and_close_leave_nothing_inflated(unit: DriverOnFake) -> None:
    unit.driver.open()
    for end in (unit.driver.vent, unit.driver.close):
        asked = (ASKED,) * unit.driver.channels
        assert until(lambda asked=asked: near(unit.driver.set(asked), asked))  # type: ignore[misc]
        end()
        assert until(lambda: not unit.plant.regulator.any()), (
            f"after {end.__name__}() chambers are still told {np.round(unit.plant.regulator).tolist()} Pa"
        )


@units("pressure")
def test_connect_is_enough_to_vent(unit: DriverOnFake) -> None:
    line, asked = unit.lines()[0], (ASKED,) * unit.driver.channels
    unit.driver.open()
    assert until(lambda: near(unit.driver.set(asked), asked))
    line.faults.silent = True  # so that closing cannot vent it
    unit.driver.close()
    line.faults = Faults()
    late = unit.another()
    late.connect()
    late.vent()
    assert until(lambda: not unit.plant.regulator.any()), (
        f"connect() and vent() left chambers told {np.round(unit.plant.regulator).tolist()} Pa; vent() must not need open()"
    )
    late.close()


@units("mocap")
def test_the_cameras_see_tip_and_markers_in_the_base_frame(unit: DriverOnFake) -> None:
    tip, markers = np.array([0.02, -0.03, 0.25]), np.array([[0.0, -0.01, 0.1], [0.01, -0.02, 0.2]])
    turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])  # about x by 36.9 deg
    with unit.plant.lock:
        unit.plant.tip_position, unit.plant.markers, unit.plant.tip_rotation = tip, markers, turned
    unit.driver.open()
    assert until(lambda: close(unit.driver.latest().position, tip)), (
        f"latest() puts the tip at {unit.driver.latest().position} m, in the base frame it is at {tip.tolist()} m"
    )
    sample = unit.driver.latest()
    assert isinstance(sample, BodySample) and sample.valid and len(sample.markers) == MARKERS
    assert all(close(seen, truth) for seen, truth in zip(sample.markers, markers, strict=True))
    assert abs(np.dot(sample.orientation, [math.sqrt(0.9), math.sqrt(0.1), 0.0, 0.0])) > math.cos(0.02)
    with unit.plant.lock:
        unit.plant.tip_visible = False
    assert until(lambda: bool(unit.samples) and not unit.samples[-1].valid)
    assert until(lambda: not answers(unit.driver.latest))  # the last good pose is told for `max_age` at most


@units(*STREAMS)
def test_a_stream_hands_over_its_samples_in_the_order_of_time_until_it_is_closed(unit: DriverOnFake) -> None:
    unit.driver.open()
    assert until(lambda: len(unit.samples) >= 3)
    newest = unit.driver.latest()
    times = [sample.t for sample in unit.samples]
    assert times == sorted(times), "samples did not come in the order of their time t"
    assert newest.t <= unit.samples[-1].t and unit.driver.lost >= 0
    for name in drivers()[unit.config.driver].quantities:
        assert math.isfinite(getattr(newest, name)), name
    unit.driver.close()
    sent = len(unit.samples)
    timing.sleep(0.2)
    assert len(unit.samples) == sent, f"{len(unit.samples) - sent} samples came after close()"


@units("arm")
def test_the_arm_goes_where_it_is_told_and_its_state_shows_it(unit: DriverOnFake) -> None:
    with unit.state() as state:
        goal = ahead(unit, state, 0.02)
        unit.driver.move_to(goal, unit.config.max_speed / 2, unit.config.max_acceleration / 2)
        assert until(lambda: not unit.driver.moving())
        assert unit.driver.standing() and unit.driver.glance()
        assert isinstance(state.latest(), ArmSample)
        assert until(lambda: close(state.latest().tcp_pose[:3], goal[:3]))
        assert until(lambda: close(unit.plant.probe_position, goal[:3]))
        assert len(unit.samples) > 1 and state.lost >= 0


@units("arm")
def test_the_arm_stops_on_its_way(unit: DriverOnFake) -> None:
    with unit.state() as state:
        goal = ahead(unit, state, 0.1)
        unit.driver.move_to(goal, unit.config.max_speed / 20, unit.config.max_acceleration / 2)
        assert unit.driver.moving()
        unit.driver.stop()
        assert until(unit.driver.standing) and not unit.driver.moving()
        assert not close(state.latest().tcp_pose[:3], goal[:3])


@units("arm")
def test_the_arm_refuses_what_is_beyond_its_limits(unit: DriverOnFake) -> None:
    with unit.state() as state:
        goal, config = ahead(unit, state, 0.01), unit.config
        for pose, speed, acceleration in (
            ((config.workspace_max[0] + 0.1, *goal[1:]), config.max_speed, config.max_acceleration),
            ((math.nan, *goal[1:]), config.max_speed, config.max_acceleration),
            (goal, 2 * config.max_speed, config.max_acceleration),
            (goal, config.max_speed, 2 * config.max_acceleration),
        ):
            with pytest.raises(LimitExceeded):
                unit.driver.move_to(pose, speed, acceleration)
        assert not unit.driver.moving()


def ahead(unit: DriverOnFake, state: Any, distance: float) -> tuple[float, ...]:
    """A pose at a distance (m) from where the arm is, towards the middle of its workspace."""
    assert until(lambda: answers(state.latest))
    here = np.array(state.latest().tcp_pose)
    way = (np.array(unit.config.workspace_min) + np.array(unit.config.workspace_max)) / 2 - here[:3]
    return (*(here[:3] + distance * way / np.linalg.norm(way)), *here[3:])


def close(place: Any, wanted: Any) -> bool:
    """The same place, within what noise and tolerances are."""
    return bool(np.linalg.norm(np.subtract(place, wanted)) < 3e-3)


def near(values: Any, wanted: Any) -> bool:
    """Equal within what a regulator's steps and noise are."""
    return all(abs(a - b) < 1.5e3 for a, b in zip(values, wanted, strict=True))
