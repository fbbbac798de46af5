"""The error tree of the recordings. Each message names file or topic, value with its unit, limit and what to do next."""

from __future__ import annotations


class RecordingError(Exception):
    """Something went wrong with a recording or a table of trials."""


class NotARecording(RecordingError, ValueError):
    """The file is not an MCAP file, or not one of this house."""


class Foreign(NotARecording):
    """An MCAP file of other software: sound, but without the topics that are needed."""


class Truncated(RecordingError, EOFError):
    """The file ends before its end mark."""


class Damaged(RecordingError, ValueError):
    """Bytes of the file changed since they were written."""


class Oversized(RecordingError, MemoryError):
    """A file that says it holds more than is ever read at once."""


class MissingStream(RecordingError, LookupError):
    """A topic that the file does not hold."""


class OtherVersion(RecordingError, ValueError):
    """Messages of a schema version this software does not read."""


class BadMessage(RecordingError, ValueError):
    """A message or state that does not fit its definition; it was not recorded."""


class WriteFailed(RecordingError, OSError):
    """The file can no longer be written; what reached the disk before stays readable."""


class NotSettled(RecordingError, TimeoutError):
    """A state that never met the rule by which it was to be read."""


class TooFewSamples(NotSettled):
    """A state whose window holds fewer samples than it needs: a stream paused."""


class VacuumLost(NotSettled):
    """A state of a jammed spine that did not keep its vacuum."""


class Misplaced(NotSettled):
    """A state in which a body of the cameras is where the robot cannot have brought it."""


class NoResistance(NotSettled):
    """A state of a jammed specimen that hardly pushed back."""


class BadTable(RecordingError, ValueError):
    """A table of trials that cannot be right."""


class BadJournal(RecordingError, ValueError):
    """A journal that does not tell what is finished."""
