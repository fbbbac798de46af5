"""A made-up thermometer on the robot's skin: ten lines a second by itself, at 9600 Bd: `T=296.41 H=0.38\\n`, in K and as a
share of saturation."""

BAUD = 9600
RATE = 10.0
"""Hz."""
