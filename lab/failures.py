"""Which failures a person can do something about, and the exit code of each."""

from __future__ import annotations

from pydantic import ValidationError

from diagnosis.errors import DiagnosisError
from drivers.errors import InstrumentError, LimitExceeded
from model.errors import ModelError
from protocols.errors import BadProtocol, MissingInstrument, ProtocolError
from recordings.errors import BadTable, Foreign, MissingStream, RecordingError

from .files.config import ConfigError
from .guard.latch import RigLocked
from .guard.messages import RigLanded
from .rig.actuators import ActuatorsLost


def explained(error: Exception) -> tuple[str, int] | None:
    """Message and exit code of a failure that is not a mistake in this program; None for anything else."""
    asked_wrong = (ConfigError, ModelError, DiagnosisError, MissingInstrument, LimitExceeded, BadProtocol)
    if isinstance(error, (*asked_wrong, BadTable, Foreign, MissingStream)):
        return str(error), 2
    if isinstance(error, ValidationError):
        return "\n".join(f"{'.'.join(map(str, e['loc']))} = {e['input']!r}: {e['msg']}" for e in error.errors()), 2
    if isinstance(error, (InstrumentError, ProtocolError, RecordingError, ActuatorsLost, RigLanded, RigLocked)):
        return str(error), 1
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}", 1
    return None
