"""The TMCL length unit of the spine."""
