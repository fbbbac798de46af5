"""Alicat pressure controllers on one RS-232/485 line."""
