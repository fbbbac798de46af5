"""What the bench has to reach, by kind of set: the project's own aims, written down before it was run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Target:
    """At least `low`, at most `high`."""

    low: float | None = None
    high: float | None = None

    def met(self, value: float) -> bool:
        """Whether the value lies within."""
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    def __str__(self) -> str:
        if self.low is not None and self.high is not None:
            return f"{self.low:g}..{self.high:g}"
        return f">= {self.low:g}" if self.low is not None else f"<= {self.high:g}"


def targets(about: dict[str, Any], after: int) -> dict[str, Target]:
    """By metric, for a set as its commitment describes it, with `after` experiments chosen by the diagnosis."""
    design, cluttered = str(about.get("design", "full")), float(about.get("clutter", 0)) > 0
    per_length = about.get("area_factor") == "by spine length"
    found = {
        "coverage": Target(0.93, 0.98),
        "ece": Target(high=0.04),
        "size_90": Target(0.85, 0.95),
        "failed": Target(high=0.0),
        "false_alarm": Target(high=0.05 if cluttered else 0.01),
        "closed": Target(low=0.85 if cluttered else 0.95),
        "outside_named": Target(high=0.10),
        "flagged_at_10": Target(low=0.75 if cluttered else 0.90),
        "detected": Target(low=0.95),
    }
    if design == "tip":
        found["coverage"] = Target(low=0.95) if cluttered else Target(0.93, 0.98)
        found["top1"] = Target(low=0.65 if cluttered else 0.88)
        del found["detected"]
        return found
    found |= {"set_size": Target(high=2.5)}
    if cluttered:
        found |= {
            "top1": Target(low=0.93 if after else 0.90),
            "p_truth": Target(low=0.85),
            "sure_right": Target(low=0.97),
            "sure_share": Target(low=0.60),
        }
    else:
        found |= {
            "top1": Target(low=0.96 if per_length else 0.98),
            "pair_both": Target(low=0.95),
            "pair_exact": Target(low=0.80),
            "pair_spurious": Target(high=0.15),
        }
    return found
