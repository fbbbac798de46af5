"""SMC ITV pressure regulators, one line each."""
