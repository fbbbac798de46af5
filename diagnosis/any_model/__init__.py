"""The diagnosis of any forward function: which of the causes that a person lists explains the gap between model and data."""

from model.cause import Cause

from .diagnose import diagnose_model

__all__ = ["Cause", "diagnose_model"]
