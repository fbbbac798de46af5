"""A rig for a program: open its instruments, watch and record them, and pass them to a protocol.

Verbs use `assembly.Rig`; `limits` is checked before a motion, the guard watches it.
"""
