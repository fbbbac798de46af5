"""The fast method: the static Cosserat rod compiled to machine code, batches of rods side by side, with derivatives.

Kernels, from the section to the batch
    compiler, lanes                    how kernels are compiled; numbers of rods side by side, by their names
    algebra, equations, runge_kutta    vectors; equilibrium and section laws; a step along the rod
    group, passes                      a group of rods; one pass from tip to base
    newton, direct                     the tip pose whose base satisfies the boundary condition; cold or warm
    walk                               positions, wrenches and axial strain between base and tip
    derivatives/                       implicit differentiation
Python in front of them
    method, with the load steps; stations; batches: how arrays are handed over

Only `model.rods` comes in here, `model.warm_up`, and benchmarks that call a kernel.
"""
