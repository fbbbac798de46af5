"""A rig as a program sees it: its instruments opened, watched, recorded, and handed to a protocol.

Verbs come in by `assembly.Rig`; what may move is asked of `limits` before and of the guard while it moves.
"""
