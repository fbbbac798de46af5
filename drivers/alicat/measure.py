"""In which unit of measure one Alicat unit shows and takes pressures: asked where its firmware tells, tried where it does not.

No data frame names it, and a panel changes it at any time. A set-point is then another pressure, while set-point and reading
go on agreeing with each other.
"""

from __future__ import annotations

import math

from ..errors import WrongDevice
from .wire import COUNTS, PA, UNITS, AlicatUnit, Variable

KNOWS_FULL_SCALE = (6, 0)
"""First firmware that answers FPF, and so tells its unit of measure."""
UNKNOWN = 1e6
"""Pa taken for a unit of measure that is not known: the largest, so that no pressure passes for vented."""
TRIAL_SHARE = 0.25
"""By which what it shows may differ from what rig.yaml makes of that: nominal ranges are rounded, units lie further apart."""


class Measure:
    """Keeps `unit.pa` true, so that readings are Pa whatever the display shows."""

    def __init__(self, name: str, unit: AlicatUnit, stated: str | None, full_scale: float) -> None:
        """`stated`: the unit of measure in rig.yaml; `full_scale` there, Pa."""
        self._name, self._unit, self._stated, self._full_scale = name, unit, stated, full_scale
        self._needed = stated or "kPa"
        self._pa = unit.pa = UNITS[self._needed][1]
        self._range = full_scale
        self.tells = True
        self.untried = False
        """It does not tell, and must be tried before its next pressure."""
        self.wrong = ""
        """What is wrong, with its remedy; nothing may be inflated while there is something."""

    def begin(self, firmware: str, version: tuple[int, int]) -> None:
        """At opening. Raises WrongDevice when the unit does not tell and rig.yaml does not say."""
        self.tells = version >= KNOWS_FULL_SCALE
        if not self.tells and self._stated is None:
            raise WrongDevice(
                self._name,
                f"unit {self._unit.letter} has firmware {firmware}, which does not report its unit of measure; write what its "
                f"display shows in rig.yaml: instruments.{self._name}.unit: one of {', '.join(UNITS)}",
            )

    def ask(self) -> None:
        """Ask for it, or have it tried before the next pressure."""
        if not self.tells:
            self.untried = True
            return
        value, code, label = self._unit.full_scale(Variable.GAUGE_PRESSURE)
        self._unit.pa = PA.get(code, UNKNOWN)
        self._range = value * self._unit.pa
        self.wrong = ""
        if self._unit.pa != self._pa:
            self.wrong = (
                f"unit {self._unit.letter} shows {label or 'an unknown unit of measure'} (code {code}; register FPF "
                f"{Variable.GAUGE_PRESSURE}), {self._needed} is needed (code {UNITS[self._needed][0]}); set its pressure unit to "
                f"{self._needed}, or write in rig.yaml which `unit` it shows"
            )

    def check_range(self) -> None:
        """Compare the range that it told last with rig.yaml. Raises WrongDevice."""
        if not math.isclose(self._range, self._full_scale, rel_tol=1e-3):
            raise WrongDevice(
                self._name,
                f"unit {self._unit.letter} has a full scale of {self._range / 1e3:g} kPa, rig.yaml says "
                f"{self._full_scale / 1e3:g} kPa; correct full_scale in rig.yaml, or fit the right unit",
            )

    def try_out(self, held: float = 0.0) -> None:
        """Of a unit that does not tell: send `held` (Pa, or a small pressure) as a share of the full scale, which is the same
        whatever it shows, and see what it makes of that."""
        # 5 kPa on a unit of 2 MPa, the widest that rig.yaml takes, and less on any other
        counts = round(held / self._full_scale * COUNTS) or 160
        wanted = counts / COUNTS * self._full_scale
        shown = self._unit.set_share(counts).setpoint / self._unit.pa
        if abs(shown * self._pa - wanted) <= max(TRIAL_SHARE * wanted, 0.6 * self._unit.digit):
            self._unit.pa, self.untried, self.wrong = self._pa, False, ""
            return
        fits = [name for name, (_, pa) in UNITS.items() if abs(shown * pa - wanted) <= TRIAL_SHARE * wanted]
        self._unit.pa = UNITS[fits[0]][1] if fits else UNKNOWN
        self.wrong = (
            f"unit {self._unit.letter} shows {shown:g} for {wanted / self._pa:.4g} {self._needed}, sent as a share of its range: "
            f"it does not show {self._needed}{f' but {fits[0]}' if fits else ''}, or its range is not "
            f"{self._full_scale / 1e3:g} kPa; correct unit or full_scale in rig.yaml"
        )
