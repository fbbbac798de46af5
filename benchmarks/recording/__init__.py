"""The figures of the recordings: `python -m benchmarks.recording`."""
