"""The jamming valve on a Numato relay module."""
