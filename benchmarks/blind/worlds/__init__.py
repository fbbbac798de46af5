"""Worlds: robots of other physics than the virtual robot's, each with its own form of every effect.

A discrete rod of screws in equilibrium (frames, equilibrium), a body with its material and gas (robot, body, material, gas), the
forms of effects by stage (actuation, silicone, spine, loads, boundary, seen, outside), and campaigns of named worlds
(table, walk, campaign, carried). Nothing here knows the laws of the diagnosis. See docs/howto/blind.md.
"""
