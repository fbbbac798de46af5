"""What is asked about a robot.yaml and a table of trials that may be right; `diagnosis.data.plausible` refuses what cannot be."""
