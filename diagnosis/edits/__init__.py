"""Ways in which a robot.yaml or a table can be wrong, one misfit of the rod for all of them, and one rule of how much better."""
