"""Ctrl-C, SIGTERM and a closed terminal (SIGHUP): Ctrl-C once finishes the step; twice, or one of the others, stops now.
After that nothing interrupts the clean-up. Where SIGHUP is ignored (nohup), a closed terminal does not end the run.

"Now" is told to the guard from within the signal handler, so that the actuators stop while the experiment still unwinds.
No exception is thrown into code that does not expect one: the experiment looks between its steps. Only a program that
waits for a person at the keyboard is interrupted where it stands.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

from ..guard.child import SIGNALS
from ..guard.pulse import SIGNAL, Pulse


class Interrupts:
    """Handles signals between `with` and its end."""

    def __init__(self, say: Callable[[str], None], pulse: Pulse, at_once: bool = False) -> None:
        """`at_once`: one Ctrl-C stops now."""
        self._say, self._pulse, self._at_once = say, pulse, at_once
        self._pressed = 0
        self._before: dict[int, Any] = {}
        self.now = False
        """True once a person wants everything to stop at once."""

    def __enter__(self) -> Interrupts:
        kept = {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else set()
        self._before = {n: signal.signal(n, self._on_signal) for n in SIGNALS if n not in kept}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            # a program that was told to stop is ending: nothing is to cut its way out short
            signal.signal(number, signal.SIG_IGN if self._pressed else handler)

    def stopping(self) -> bool:
        """True once a person asked to end after this step."""
        return self._pressed > 0

    def finish(self) -> None:
        """As one Ctrl-C does, from any thread."""
        self._pressed = max(self._pressed, 1)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        """Count Ctrl-C once, SIGTERM and SIGHUP twice; at two tell the guard, and interrupt a wait for a person."""
        self._pressed += 1 if number == signal.SIGINT and not self._at_once else 2
        if self._pressed >= 2 and not self.now:
            self.now = True
            self._pulse.send(SIGNAL, float(number))
            if self._pulse.waiting:
                raise KeyboardInterrupt
        elif self._pressed == 1:
            self._say("Stopping after this step; Ctrl-C again stops now")


class Shielded:
    """Signals do nothing between `with` and its end: landing and disconnecting are not to be cut short."""

    def __enter__(self) -> Shielded:
        try:
            self._before = {n: signal.signal(n, signal.SIG_IGN) for n in SIGNALS}
        except ValueError:  # not the main thread, which alone receives signals
            self._before = {}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
