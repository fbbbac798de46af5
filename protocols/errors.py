"""What can end a protocol early; everything else that an instrument raises is an `InstrumentError`."""

from __future__ import annotations

from drivers.errors import InstrumentError


class ProtocolError(Exception):
    """A protocol ended early; the message says at which step, what was measured, and what to do."""


class MissingInstrument(ProtocolError):
    """The rig lacks instruments that this protocol needs; nothing moved."""


class WrongWiring(ProtocolError):
    """The regulators' wiring cannot make the chamber pattern asked for; nothing moved."""


class NotReached(ProtocolError):
    """A physical state was not reached in the time allowed."""


class TooMuchForce(ProtocolError):
    """The arm met more force than the protocol allows, and was stopped where it was."""


class NotPushing(ProtocolError):
    """A jammed specimen hardly pushes back on the arm."""


class JamLost(ProtocolError):
    """The spine was jammed anew after a pause: what was read in this trial before belongs to another jamming."""


class Suspended(ProtocolError):
    """The rig is not as it must be (tip hidden, supply low, cell open), and a person can put that right."""

    def __init__(self, cause: InstrumentError) -> None:
        super().__init__(str(cause))
        self.cause = cause


class StoodStill(Suspended):
    """This computer stood still (suspended, paused virtual machine): what was being read is begun again, without a person."""


class Skipped(ProtocolError):
    """A person asked to leave this trial out."""


class BadRequest(ValueError):
    """What was asked of a run is no request; the message says what would be one."""


class BadProtocol(ValueError):
    """A protocol of one's own gives no plan that can be used; the message names what is wrong with it."""


class Stopped(ProtocolError):
    """A person asked to stop; what was measured until then is kept."""
