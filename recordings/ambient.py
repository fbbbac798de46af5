"""Standard ambient pressure; imports nothing, so that a guard starts at once."""

AMBIENT = 101_325.0
"""Standard atmosphere, Pa."""
