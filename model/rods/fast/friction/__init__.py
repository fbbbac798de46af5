"""Rods with friction that remembers: a history of states, solved one after the other."""
