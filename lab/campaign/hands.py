"""Whose hands prepare the rig: asked when the set-up changes, not before every run."""

from __future__ import annotations

from protocols.bench import Operator, Setup


class Prepared:
    """An operator who is not asked again for what stands already. What stands when the program starts is not known."""

    def __init__(self) -> None:
        self._operator: Operator | None = None
        self._stands: Setup | None = None
        self.asked = 0
        """How often somebody was asked to prepare."""

    def over(self, operator: Operator) -> Prepared:
        """From now on this operator is asked."""
        self._operator = operator
        return self

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare."""
        if setup == self._stands:
            return
        assert self._operator is not None
        self._stands = None  # where it is refused half-way, nobody knows
        self._operator.prepare(setup)
        self._stands = setup
        self.asked += 1

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm."""
        assert self._operator is not None
        self._operator.confirm(trouble)
