"""What a person runs: the `lab` command, rig assembly, processes, figures and reports."""
