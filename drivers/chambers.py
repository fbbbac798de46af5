"""Which pressure channel feeds which chambers of the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

PAPER_WIRING = ((9, 1, 2), (3, 4, 5), (6, 7, 8))
"""Nine chambers in three sets of three neighbours, each set on one channel."""


class ChamberMap:
    """The wiring: `channels[i]` are the chambers that hang on channel i, in the regulators' order; `count` has the robot."""

    def __init__(self, chambers_by_channel: Sequence[Sequence[int]], count: int | None = None) -> None:
        """`count`: chambers that the robot has; as many as are wired when it is not known.

        Raises ValueError for a number outside 1..count, a chamber named twice, or a channel without a chamber.
        """
        wired = [n for group in chambers_by_channel for n in group if isinstance(n, int)]
        self.count = min(max(wired, default=0), 64) if count is None else count
        self.channels = tuple(tuple(group) for group in chambers_by_channel)
        self._channel_of: dict[int, int] = {}
        for channel, group in enumerate(self.channels):
            if not group:
                raise ValueError(f"channel {channel + 1} feeds no chamber; name its chambers or leave the channel out")
            for chamber in group:
                self._check_number(chamber)
                if chamber in self._channel_of:
                    raise ValueError(
                        f"chamber {chamber} is listed for channel {self._channel_of[chamber] + 1} and for channel "
                        f"{channel + 1}; each chamber is fed by one channel"
                    )
                self._channel_of[chamber] = channel

    def setpoints(self, chamber_pressures: Mapping[int, float]) -> tuple[float, ...]:
        """Channel pressures that give these chamber pressures (any one unit); a chamber that is not named stays at 0.

        Raises ValueError when the wiring cannot make the pattern: a chamber that is not connected is to be inflated, or
        chambers on one channel are to have different pressures.
        """
        for chamber, pressure in chamber_pressures.items():
            if pressure:
                self._check_number(chamber)
            if chamber not in self._channel_of and pressure != 0:
                raise ValueError(
                    f"chamber {chamber} is not connected to any channel, but {pressure:g} Pa is requested; connected are "
                    f"{self._connected()}"
                )
        setpoints = []
        for channel, group in enumerate(self.channels):
            pressures = {chamber: float(chamber_pressures.get(chamber, 0.0)) for chamber in group}
            if len(set(pressures.values())) > 1:
                pattern = ", ".join(f"chamber {c}: {p:g} Pa" for c, p in pressures.items())
                raise ValueError(
                    f"channel {channel + 1} feeds chambers {', '.join(map(str, group))} with one pressure, but the "
                    f"pattern requires {pattern} (0 where a chamber is not named); give all of them the same pressure, or "
                    "rewire"
                )
            setpoints.append(pressures[group[0]])
        return tuple(setpoints)

    def by_chamber(self, channel_values: Sequence[float]) -> tuple[float, ...]:
        """One value a chamber from one value a channel; 0 for a chamber that is not connected.

        Raises ValueError when the number of values is not the number of channels.
        """
        if len(channel_values) != len(self.channels):
            raise ValueError(f"{len(channel_values)} values for {len(self.channels)} channels; give one value per channel")
        values = [0.0] * self.count
        for chamber, channel in self._channel_of.items():
            values[chamber - 1] = float(channel_values[channel])
        return tuple(values)

    def _connected(self) -> str:
        return ", ".join(map(str, sorted(self._channel_of))) or "none"

    def _check_number(self, chamber: int) -> None:
        if isinstance(chamber, bool) or not isinstance(chamber, int) or not 1 <= chamber <= self.count:
            raise ValueError(f"{chamber!r} is not a chamber; chambers are numbered 1 to {self.count}")
