"""The robot as a Cosserat rod: description, cross-section, solvers, calibration, the method of the paper."""
