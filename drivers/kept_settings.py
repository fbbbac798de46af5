"""Numbers that an instrument keeps beyond a program, most of them without power, and on which its driver's promises rest.

Those that the driver may decide are written when they differ; the others are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from .errors import DeviceFault, WrongDevice


@dataclass(frozen=True)
class Setting:
    """One number and the value that it needs."""

    name: str
    """With its place in the instrument."""
    read: Callable[[], int | None]
    """None where older firmware has no such setting."""
    needed: int | Callable[[int], int]
    """The value, or what it is by the one that was found."""
    why: str
    """What another value does."""
    write: Callable[[int], object] | None = None
    """None: another value is refused."""


@dataclass(frozen=True)
class KeptSettings:
    """All settings of one instrument."""

    instrument: str
    device: str
    """What it is, for messages."""
    tool: str
    """The maker's program, by which a person sets what is refused."""
    settings: Iterable[Setting]

    def apply(self) -> None:
        """Write what differs and read it back. Raises WrongDevice for what is refused, DeviceFault for what is not taken."""
        for setting, found, needed in self._differing():
            if setting.write is None:
                raise self._refused(setting, found, needed)
            setting.write(needed)
            if (kept := setting.read()) != needed:
                raise DeviceFault(
                    self.instrument,
                    f"{setting.name} was set to {needed}, but the {self.device} holds {kept}; check that no other host writes "
                    "to it",
                )

    def confirm(self) -> None:
        """Raise WrongDevice when a setting has changed since `apply`."""
        for differing in self._differing():
            raise self._refused(*differing)

    def _differing(self) -> Iterator[tuple[Setting, int, int]]:
        """The settings that differ, each with the value found and the value needed."""
        for setting in self.settings:
            if (found := setting.read()) is not None:
                needed = setting.needed(found) if callable(setting.needed) else setting.needed
                if found != needed:
                    yield setting, found, needed

    def _refused(self, setting: Setting, found: int, needed: int) -> WrongDevice:
        remedy = f"set it with the maker's {self.tool}" if setting.write is None else "open the unit again"
        return WrongDevice(
            self.instrument,
            f"{setting.name} is {found}, needed {needed}: {setting.why}; {remedy}, and keep other hosts off the {self.device}",
        )
