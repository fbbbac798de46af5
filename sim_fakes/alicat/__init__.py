"""Fake Alicat pressure controllers: units (`device`) behind one addressed line (`fake`)."""

from .device import PA_PER_UNIT, UNITS
from .fake import AlicatFake

__all__ = ["PA_PER_UNIT", "UNITS", "AlicatFake"]
