"""Derivatives of a fast solution by any number of a rod, in one pass: implicit differentiation with reciprocity.

    tangent         how a section answers to a change; columns that walk with the rod
    collect         what they collect on the way: work on every number of an element
    columns_walk    the columns of a group of rods past their stations, and what a direction in parameter space makes of them
    ends            what changes at the tip and at the base
    implicit        the kernel
    sensitivity     Python in front of it

Only `model.rods` comes in here.
"""
