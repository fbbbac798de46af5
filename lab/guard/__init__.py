"""The process that owns the actuators: it checks their readings, and makes the rig safe when nobody else can.

A program commands a rig through `lab.rig.actuators`, and lands one without a guard through `new_guard` and `door`.
"""
