"""The joint model of a case and its fit: linearised problem, evidence, search, posterior."""
