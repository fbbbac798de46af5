"""What people write and keep: rig.yaml, robot.yaml, protocol files, tables; units, settings, and errors that name the place.

Anybody in `lab` may come in; nothing here knows an instrument that is open.
"""
