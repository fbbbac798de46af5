"""What was promised in numbers, measured by commands anyone can run: `python -m benchmarks.<name>`."""
