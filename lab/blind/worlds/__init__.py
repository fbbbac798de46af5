"""Blind cases of other physics: `lab blind make --world W`. Their sealed truth tells in mm what each effect does.

truth   draws a robot of a world: causes, clutter, tolerances
make    has it measured, weighs its effects in mm, writes the case
by_mm   scores answers by what carries, where the truth carries mm
"""
