"""Where the pressure of one channel may be, given what it was told and how slowly its regulator may follow.

A chamber follows its set-point s as  dp/dt = (s - p) / tau'  with any tau' up to the regulator's time constant tau. Such a
pressure stays between two bounds: the upper one jumps up with s and falls towards it with tau, the lower one falls with s
and rises towards it with tau. What is outside of them by more than noise does not follow, whatever the set-points of
this channel or of others are doing.

When between two readings a set-point was told is not known. The bounds take the earlier reading's as told until the
later reading, so that a ramp that is read seldom is not mistaken for a jump; and each that came between (`command`) as
one that may have stood all the while, so that a channel which was down and is up again is not mistaken for a slow one.
"""

from __future__ import annotations

import math


class PressureEnvelope:
    """Bounds (Pa gauge) of one channel, and since when it has been away from its set-point."""

    def __init__(self, time_constant: float, error: float, patience: float) -> None:
        """`time_constant` of the regulator (s), `error` that is tolerated (Pa), for how long (`patience`, s of `t`)."""
        self._tau, self._error, self._patience = time_constant, error, patience
        self._low = self._high = math.nan
        """Bounds at the last reading, Pa."""
        self._setpoint = self._t = math.nan
        """Of the last reading: Pa and s."""
        self._off_since = self._near_since = math.inf
        """Times s since when it is away from its set-point, or near it."""
        self._outside = 0
        """Readings in a row outside of the bounds."""
        self._lowest, self._highest = math.inf, -math.inf
        """Range of the set-points that were told since the last reading."""

    def command(self, setpoint: float) -> None:
        """A set-point (Pa) that was told, or may have been, since the last reading."""
        self._lowest, self._highest = min(self._lowest, setpoint), max(self._highest, setpoint)

    def update(self, t: float, setpoint: float, measured: float) -> bool:
        """Take a reading at time t (s); True when the channel has been too far from its set-point for too long."""
        if math.isnan(self._t):  # what was told before is not known: it may still be on its way from where it is
            self._low, self._high = min(setpoint, measured), max(setpoint, measured)
        else:
            left = math.exp(-max(0.0, t - self._t) / self._tau)
            lowest, highest = min(self._setpoint, self._lowest), max(self._setpoint, self._highest)
            self._low = min(setpoint, lowest + min(0.0, self._low - lowest) * left)
            self._high = max(setpoint, highest + max(0.0, self._high - highest) * left)
        self._t, self._setpoint = t, setpoint
        self._lowest, self._highest = math.inf, -math.inf
        if abs(measured - setpoint) <= self._error:
            self._outside, self._near_since = 0, min(self._near_since, t)
            # a stuck channel is merely passed by its set-point in a ramp
            if t - self._near_since >= 1.0:
                self._off_since = math.inf
            return False
        self._off_since, self._near_since = min(self._off_since, t), math.inf
        outside = not self._low - self._error <= measured <= self._high + self._error
        self._outside = self._outside + 1 if outside else 0
        # one reading may have been read out of step
        return self._outside >= 2 and t - self._off_since >= self._patience
