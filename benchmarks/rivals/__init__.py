"""Other methods on a sealed set, with the forward model and the noise of the diagnosis: `python -m benchmarks.rivals SET`."""
