"""Files that people write: rig.yaml, robot.yaml, protocol files, tables; their units, and errors that name the place.

All of `lab` may import from here; nothing here uses an open instrument.
"""
