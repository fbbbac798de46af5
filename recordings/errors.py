"""The error tree of the recordings.

    RecordingError                      anything that went wrong with a recording or a table of trials
    |-- NotARecording    (ValueError)      the file is not an MCAP file, or not one of this house
    |   `-- Foreign                        an MCAP file of other software, without the topics that are needed
    |-- Truncated        (EOFError)        the file ends before its end mark
    |-- Damaged          (ValueError)      bytes of the file changed since they were written
    |-- Oversized        (MemoryError)     a file that says it holds more than is ever read at once
    |-- MissingStream    (LookupError)     a topic that the file does not hold
    |-- OtherVersion     (ValueError)      messages of a schema version this software does not read
    |-- BadMessage       (ValueError)      a message or state that does not fit its definition; it was not recorded
    |-- WriteFailed      (OSError)         the file can no longer be written
    |-- NotSettled       (TimeoutError)    a state that never met the rule by which it was to be read
    |   |-- TooFewSamples                  its window holds fewer samples than it needs
    |   |-- VacuumLost                     the jammed spine did not keep its vacuum
    |   |-- Misplaced                      a body is where the robot cannot have brought it
    |   `-- NoResistance                   the jammed specimen hardly pushed back
    |-- BadTable         (ValueError)      a table of trials that cannot be right
    |-- BadJournal       (ValueError)      a journal that does not tell what is finished
    `-- MissingPackage   (ImportError)     an optional package that is not installed

Each message names the file or topic, the value with its unit, the limit and what to do next.
"""

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


class MissingPackage(RecordingError, ImportError):
    """An optional package that is not installed."""
