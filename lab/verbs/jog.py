"""`lab jog`: set-points of a chamber, the spine and the valve by a line each, with the readings beside it; Ctrl-C vents."""

from __future__ import annotations

import contextlib
import queue
import re
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

import timing
from drivers.errors import InstrumentError
from protocols.actions import grow, home, ramp, release, vent
from protocols.bench import Bench
from protocols.errors import ProtocolError
from protocols.parameters import Jam, SpineMotion
from protocols.steering import Steering

from ..console import Screen, out
from ..files.config import ConfigError, in_si
from ..files.rig_file import RigFile, load_rig
from ..files.units import KINDS, shown
from ..guard.messages import SafeReport
from ..options import Result, Verb, option, rig
from ..rig.assembly import Rig
from ..rig.by_hand import by_hand
from ..rig.keys import Keys, Line
from ..rig.limits import unlimited
from .run import connect

JOGGED, SEEN = ("pressure", "spine", "valve", "gauge"), ("mocap", "force")
"""Instruments whose readings are demanded, and those that are only shown."""
RECENT, SHOWN_EVERY = 5.0, 0.2
"""Rig seconds for which a reading counts as present; host seconds between two looks at the readings."""
LAG = 1.0
"""Rig seconds after which readings show what was done."""


class Commands(Line):
    """A terminal on which each line is a command."""

    def __init__(self, lines: queue.SimpleQueue[str], screen: Screen) -> None:
        super().__init__(Steering(), screen.say, screen.typed)
        self._lines = lines
        self.end()

    def end(self) -> None:
        """Begin a new line."""
        self._typed = ""
        self._show("")

    def _ask(self, kind: str, text: str = "") -> None:
        self._lines.put(text)


@contextlib.contextmanager
def commands(screen: Screen) -> Iterator[queue.SimpleQueue[str]]:
    """Lines as a person types them below the readings, or as a program writes them to the standard input; q at its end."""
    lines = queue.SimpleQueue[str]()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        lines.put("q")

    if sys.stdin.isatty():
        with Keys(sys.stdin.fileno(), Commands(lines, screen)):
            yield lines
    else:
        timing.Thread(target=read, name="jog-input", daemon=True).start()
        yield lines


def readings(bench: Bench) -> str:
    """The newest reading of each instrument, in the units in which people read them."""
    first = [group[0] - 1 for group in bench.chambers.channels]

    def numbers(values: Iterable[float]) -> str:
        return " ".join(f"{value:.1f}" for value in values)

    said: dict[str, Callable[[np.void], str]] = {
        "/pressure": lambda row: f"pressures {numbers(1e-3 * row['measured'][first])} kPa",
        "/spine": lambda row: f"spine {row['length'] * 1e3:.1f} mm",
        "/vacuum": lambda row: f"gauge {row['absolute'] / 1e3:.1f} kPa absolute",
        "/tip": lambda row: f"tip {numbers(1e3 * row['position'])} mm" if row["valid"] else "tip hidden",
    }
    since = bench.clock.now() - RECENT
    newest = {topic: bench.recorder.buffers.window(topic, since, np.inf)[-1:] for topic in said if bench.has_topic(topic)}
    return ", ".join(said[topic](row) for topic, rows in newest.items() for row in rows) or "no reading"


def act(bench: Bench, file: RigFile, line: str, rate: float) -> str:
    """Do what a line says and return what was reached; raises ConfigError for one that says nothing or demands too much."""
    word, _, value = line.strip().partition(" ")
    chamber, pressure = re.fullmatch(r"p(\d+)", word), file.instruments.pressure
    if chamber is not None and pressure is not None:
        target, number = list(bench.need(bench.pressure, "pressure").read().setpoint), int(chamber[1])
        channel = next((i for i, group in enumerate(bench.chambers.channels) if number in group), None)
        if channel is None:
            raise ConfigError(f"{word}: chamber {number} is on no channel of rig.yaml")
        target[channel] = in_si(word, value, "Pa")
        if not 0 <= target[channel] <= (most := pressure.limits[channel]):
            of_robot = min(file.body.pressure_limits[c - 1] for c in pressure.chambers[channel])
            whose = file.robot if most == of_robot else f"{file.path}: instruments.pressure"
            raise ConfigError(f"{line}: must be 0 to {shown(most, 'Pa')}, max_pressure of {whose}")
        ramp(bench, target, min(rate, pressure.max_rate))
        return f"set-point of chamber {', '.join(map(str, bench.chambers.channels[channel]))}: {shown(target[channel], 'Pa')}"
    if word == "spine" and bench.spine is not None and file.instruments.spine is not None:
        length, most = in_si(word, value, "m"), file.instruments.spine.max_length
        if not 0 <= length <= most:
            raise ConfigError(f"{line}: must be 0 to {shown(most, 'm')}, max_length of rig.yaml")
        release(bench, Jam())
        home(bench)
        grow(bench, length, SpineMotion(speed=min(SpineMotion().speed, file.instruments.spine.max_speed)))
        return f"spine at {shown(bench.spine.read().length, 'm')}"
    if word == "valve" and bench.valve is not None and value.strip() in ("on", "off"):
        bench.valve.set(value.strip() == "on")
        return f"valve {value.strip()}"
    if word == "vent":
        vent(bench)
        return "vented"
    raise ConfigError(f"{line!r}: no such command; this rig takes {known(file)}")


def known(file: RigFile) -> str:
    """The commands that this rig can carry out."""
    spine, valve = file.instruments.spine is not None, file.instruments.valve is not None
    moves = f"p2 20 kPa | {'spine 5 cm | ' * spine}{'valve on | valve off | ' * valve}vent"
    units = f"numbers without a unit are in Pa{' or m' * spine}, pressures may be in {', '.join(KINDS['Pa'])}"
    return f"{moves} | help | q; {units}; Ctrl-C vents and ends"


def jog(rig_path: Path, rate: str) -> Result:
    """Do what is typed until q or Ctrl-C, and land the rig. Raises ConfigError, and what an instrument raised."""
    file = load_rig(rig_path)
    if missing := unlimited(file, file.body):
        raise ConfigError(*missing)
    speed = in_si("--rate", rate, "Pa/s")
    if not speed > 0:
        raise ConfigError(f"--rate {rate}: must be above 0 Pa/s")
    reports: list[SafeReport] = []
    screen = Screen("jog", file.clock.speed)
    screen.prompt("> {}_")
    with Rig(file) as opened:
        connect(opened, (*JOGGED, *SEEN))
        with screen, by_hand(opened, screen, reports.append, JOGGED, at_once=True) as bench, commands(screen) as lines:
            screen.say(known(file))
            ended = timing.Event()
            timing.Thread(target=_show, args=(bench, screen, ended), name="jog-readings", daemon=True).start()
            with contextlib.suppress(KeyboardInterrupt):
                _follow(bench, opened.file, screen, lines, speed)
            ended.set()
    out.print(str(reports[0]), soft_wrap=True)
    return Result(code=0 if reports[0].confirmed else 1, safe=reports[0].confirmed)


def _follow(bench: Bench, file: RigFile, screen: Screen, lines: queue.SimpleQueue[str], rate: float) -> None:
    """Do one line after the other; what one cannot reach is said, and the next one may be tried."""
    while True:
        bench.pause(0.1)
        try:
            line = lines.get_nowait().strip()
        except queue.Empty:
            continue
        if line == "q":
            return
        try:
            done = "" if line in ("", "help", "?") else act(bench, file, line, rate)
            bench.pause(LAG if done else 0.0)
            screen.say(f"{done}; {readings(bench)}" if done else known(file))
        except (ConfigError, ProtocolError) as e:
            screen.say(str(e))


def _show(bench: Bench, screen: Screen, ended: threading.Event) -> None:
    """Keep the readings on the screen."""
    while not ended.wait(SHOWN_EVERY):
        with contextlib.suppress(InstrumentError):
            screen.step(readings(bench), 0.0)


VERBS = (
    Verb(
        "jog",
        lambda a: jog(a.rig, a.rate),
        options=(
            rig(),
            option("--rate", default="10 kPa/s", metavar="RATE", help="of pressures (default 10 kPa/s), in Pa/s without a unit"),
        ),
        examples=("lab jog --rig rig/rig.yaml", "lab jog --rig rig/rig.yaml --rate '2 kPa/s'"),
        page="docs/tutorials/your-rig.md",
    ),
)
