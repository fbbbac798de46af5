"""Mistakes in a robot.yaml or a table, fitted with one misfit of the rod and accepted by one rule."""
