"""Jamming valve on a relay of a Numato USB relay module: relay on = vacuum on the spine, relay off = vented.

It reads back its coil: a welded contact or a stuck valve shows only in the gauge. Nothing switches off when the host dies.
"""

from __future__ import annotations

import contextlib
import re
from typing import Literal

from pydantic import Field

import timing
from timing import Clock

from ..configs import ValveConfig
from ..errors import BadReply, DeviceFault, InstrumentError, NoReply
from ..interfaces import Identity, ValveSample
from ..registry import Driver
from ..serial_line import SerialLine, meeting, show

PROMPT = b">"
RELAY_NAMES = "0123456789ABCDEFGHIJKLMNOPQRSTUV"
"""Relays above 9 are called by letters."""


class Config(ValveConfig):
    """Jamming valve by Numato relay module."""

    port: str
    baud: int = Field(default=19200, ge=1200, le=921600, json_schema_extra={"unit": "Bd"})
    """Of no effect on the module's own USB port."""
    relay: int = Field(default=0, ge=0, lt=len(RELAY_NAMES), json_schema_extra={"unit": ""})
    on_close: Literal["release", "keep"] = "release"
    """"keep" leaves the spine jammed when the program ends."""
    timeout: float = Field(default=0.3, gt=0, le=2, json_schema_extra={"unit": "s"})


class NumatoValve:
    """Jamming valve; see the module's text."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self._config = config
        self._clock = clock
        self._relay = RELAY_NAMES[config.relay]
        self._line = SerialLine(name, config.port, config.baud, config.timeout)
        self._lock = timing.RLock()
        self._marks = 0
        self._behind = True
        """Answers may be owed: to a request that failed, or to an earlier program."""

    def open(self) -> Identity:
        """Connect and check that a relay module answers; the relay stays as it is. Raises `Unreachable` or `WrongDevice`."""
        with self._lock:
            self._line.open()
            self._behind = True
            with meeting(self.name, self._line.close, f"{self._config.port} is not a Numato relay module"):
                firmware = self._value("ver", r"[\w.]{8}")
                serial = self._value("id get", r"\S{8}")
                self._state()
            return Identity("Numato", "USB relay module", serial, firmware)

    def close(self) -> None:
        """Un-jam unless configured to keep the vacuum, then disconnect."""
        with self._lock:
            if self._line.is_open and self._config.on_close == "release":
                with contextlib.suppress(InstrumentError):
                    self.set(False)
            self._line.close()

    def set(self, on: bool) -> bool:
        """Switch the relay, read it back and return that; raises `DeviceFault` when it did not follow."""
        with self._lock:
            self._answer(f"relay {'on' if on else 'off'} {self._relay}", lines=0)
            state = self._state()
            if state != on:
                raise DeviceFault(
                    self.name,
                    f"relay {self._relay} was switched {_word(on)} but reads back {_word(state)}; check the module's "
                    "supply and the relay number in rig.yaml",
                )
            return state

    def read(self) -> ValveSample:
        """Poll the state of the relay's coil."""
        with self._lock:
            return ValveSample(self._clock.now(), self._state())

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        return self._line.take_notices()

    def _state(self) -> bool:
        return self._value(f"relay read {self._relay}", "on|off") == "on"

    def _value(self, command: str, pattern: str) -> str:
        """The one line a query returns, which must look like `pattern`."""
        value = self._answer(command, lines=1)[0]
        if not re.fullmatch(pattern, value):
            raise BadReply(self.name, f"answered {value!r} to {command!r}, which is not {pattern!r}; check the relay number")
        return value

    def _answer(self, command: str, lines: int) -> list[str]:
        """Lines between echo and prompt. Every command may be repeated harmlessly, so noise gets a second try."""
        return self._line.twice(lambda: self._exchange(command, lines))

    def _exchange(self, command: str, lines: int) -> list[str]:
        if self._behind:
            self._catch_up()
        self._behind = True
        raw = self._line.ask(command.encode() + b"\r", PROMPT)
        words = [line for line in re.split(r"[\r\n]+", raw.decode("ascii", "replace")) if line]
        if words[:1] != [command] or len(words) != 1 + lines:
            raise BadReply(self.name, f"answered {show(raw)} to {command!r}; check that this port is the relay module")
        self._behind = False
        return words[1:]

    def _catch_up(self) -> None:
        """Take all owed answers, up to the echo of a new word that is no command. Raises NoReply, BadReply."""
        self._marks += 1
        mark = b"mark %d" % self._marks
        self._line.flush()
        self._line.write(b"\r" + mark + b"\r")
        deadline, heard = timing.now() + self._config.timeout, b""
        while re.search(rb"\b%b\b" % mark, heard) is None:
            try:
                heard += self._line.read_until(PROMPT, deadline - timing.now()) + PROMPT
            except NoReply:
                if not heard:
                    raise
                answer = f"answered {show(heard)} to {mark!r}"
                raise BadReply(self.name, f"{answer}; check that this port is the relay module") from None


def _word(on: bool) -> str:
    return "on" if on else "off"


DRIVER = Driver("valve", Config, NumatoValve)
