"""Other methods on a sealed set, with the forward model and the noise of the diagnosis: `python -m benchmarks.rivals SET`.

textbook   each effect alone, sparse regression
learned    a Gaussian process from the inputs of a state to what the calibrated model misses; names nothing
answers    runs them on a case
table      figures of all methods, as a table, as JSON and as a picture
"""
