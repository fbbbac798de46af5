"""A made-up laser range finder: `?I` is answered by `LRF9;4711`, `?D` by `D;0183.42;mm`, at 38400 Bd, each line ended by CR.

A newer one sends a checksum before the CR: the sum of the characters before it modulo 256, as two hexadecimal digits. A vacuum
gauge at 38400 Bd takes two bytes, a letter and any number, and answers six: to `I` the bytes `IVG1`, 0 and their sum modulo
256, to `P` the byte P, the pressure (0.1 Pa, four bytes, highest first) and the sum.
"""

BAUD = 38400


def total(data: bytes) -> int:
    """The checksum of an answer."""
    return sum(data) & 0xFF
