"""How far stated probabilities are to be trusted: constants found on a bench of sealed cases.

Evidence is sharper than the model deserves, because no model is exact. Dividing log evidence by a temperature makes the
stated probabilities match how often they were right on the bench that is named here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tempering:
    """Constants for one kind of data set."""

    temperature: float
    flagged: float
    """Probability of a cause outside the catalogue from which the answer is `unknown`."""
    bench: str
    """What they were fitted on; shown with every probability."""


DEVELOPED = (
    "temperature by the log score on 31 development cases, clean and cluttered; docs/blind.md has the sealed ones"
)

TABLE: dict[str, Tempering] = {
    "tip": Tempering(1.3, 0.5, DEVELOPED),
    "tip, orientation": Tempering(1.3, 0.5, DEVELOPED),
    "tip, unload": Tempering(1.3, 0.5, DEVELOPED),
    "tip, orientation, unload": Tempering(1.3, 0.5, DEVELOPED),
}
"""By what the data set holds."""


def tempering(orientation: bool, unload: bool) -> Tempering:
    """The constants for a data set with or without tip orientation and unload branch."""
    return TABLE[", ".join(["tip"] + ["orientation"] * orientation + ["unload"] * unload)]
