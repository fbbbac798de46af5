"""A made-up laser range finder: `?I` is answered by `LRF9;4711`, `?D` by `D;0183.42;mm`, at 38400 Bd, each line ended by CR."""

BAUD = 38400
