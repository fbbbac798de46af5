"""The fast method: the static Cosserat rod compiled to machine code, batches of rods side by side, with sensitivities.

Kernels, from the section to the batch
    algebra, equations, runge_kutta    vectors; equilibrium and section laws; a step along the rod
    lanes, passes                      a group of rods in arrays; one pass from tip to base
    newton, direct, follow             the tip that brings the base to its place; cold or warm; load steps
    walk                               positions and wrenches between base and tip
    stage_buffer, tangent, ends, implicit, stations_tangent    implicit differentiation
Python in front of them
    method, stations, sensitivity, energy_sensitivity
"""
