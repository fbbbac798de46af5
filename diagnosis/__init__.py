"""The gap between model and measurement: where it lies, which effect causes it, how far it shrinks."""
