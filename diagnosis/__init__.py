"""Locate the gap between model and measurement, name the effect that causes it, and state how far it shrinks."""
