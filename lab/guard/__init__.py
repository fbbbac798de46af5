"""The process that owns the actuators: it judges what they show, and makes the rig safe when nobody else can.

Who commands a rig comes in by `lab.rig.actuators`; who finds one without its guard, by `new_guard` and `door`.
"""
