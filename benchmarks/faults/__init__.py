"""The fault matrix: every instrument, fifteen faults, five phases of an experiment, each through the real clients and wires."""
