"""The error tree of the drivers. Each message names the instrument, the value with its unit, the limit and what to do next."""

from __future__ import annotations


class InstrumentError(Exception):
    """Something went wrong with one instrument; `instrument` is its name in rig.yaml."""

    def __init__(self, instrument: str, message: str) -> None:
        super().__init__(f"{instrument}: {message}")
        self.instrument = instrument
        self.message = message

    def __reduce__(self) -> tuple[type[InstrumentError], tuple[str, str]]:
        return type(self), (self.instrument, self.message)


class Unreachable(InstrumentError, ConnectionError):
    """The port or host cannot be opened, or nobody answers at connect."""


class NoReply(InstrumentError, TimeoutError):
    """An instrument that was reachable did not answer in time."""


class BadReply(InstrumentError, ValueError):
    """An answer that is damaged, out of protocol, or a refusal."""


class Refused(BadReply):
    """A refusal that came with a right checksum: repeating the request changes nothing, and the line is sound."""


class WrongDevice(InstrumentError, ValueError):
    """Something else than the configured instrument answers at this address."""


class LimitExceeded(InstrumentError, ValueError):
    """A request beyond the configured limit; nothing was sent."""


class StaleReading(InstrumentError, TimeoutError):
    """The newest reading is older than the configured maximum age."""


class DeviceFault(InstrumentError, RuntimeError):
    """The instrument reports a fault of its own."""


class NotReady(InstrumentError, RuntimeError):
    """A call that the present state does not allow (closed, not homed, ...); nothing was sent."""
