"""What the paper's Table II says: which simple form its apparent modulus over spine length follows, and which it rules out.

A cantilever read by eq. 9 gives an apparent modulus E(L) = F L^3 / (3 y I). A tip deflection that holds more than bending
makes it depend on the length, each cause in its own way:

    shear               1/E = 1/E0 + a/L^2          a = 3 r^2 / (4 kappa G) for a round bar of radius r
    root turns          1/E = 1/E0 + b/L
    root or arm gives   1/E = 1/E0 + d/L^3
    dead length         E = E0 (1 - d/L)^3          the first d of the spine does not bend

Errors are of log E: all rows of the table have the same weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Form = Callable[[Array, Array], Array]
"""(parameters, lengths in m) -> modulus in MPa."""
DECISIVE_TEST = (
    "One 30 cm spine, jammed once, clamped at spans of 5, 10, .. 30 cm: if it shears, the apparent modulus follows the span "
    "(as in Table II); if longer spines jam better, it stays that of 30 cm at every span. At 5 cm the two are a factor "
    "{factor:.0f} apart."
)


@dataclass(frozen=True)
class Law:
    """A form of E(L) with its free parameters: names with units, starting values, and whether they must be above 0."""

    name: str
    formula: str
    parameters: tuple[str, ...]
    start: tuple[float, ...]
    form: Form
    positive: bool = True


def _over(terms: Callable[[Array, Array], Array]) -> Form:
    return lambda p, length: 1 / terms(p, length)


_E0, _A, _B, _D = "E0 (MPa)", "a (m^2/MPa)", "b (m/MPa)", "d (m^3/MPa)"
LAWS: tuple[Law, ...] = (
    Law("constant", "E0", (_E0,), (2.0,), lambda p, x: np.full(x.shape, p[0])),
    Law("shear-like", "1/E = 1/E0 + a/L^2", (_E0, _A), (5.0, 0.01), _over(lambda p, x: 1 / p[0] + p[1] / x**2)),
    Law("shear and root rotation", "1/E = 1/E0 + a/L^2 + b/L", (_E0, _A, _B), (5.0, 0.01, 1e-3),
        _over(lambda p, x: 1 / p[0] + p[1] / x**2 + p[2] / x)),
    Law("root rotation", "1/E = 1/E0 + b/L", (_E0, _B), (50.0, 0.1), _over(lambda p, x: 1 / p[0] + p[1] / x)),
    Law("root translation", "1/E = 1/E0 + d/L^3", (_E0, _D), (5.0, 3e-4), _over(lambda p, x: 1 / p[0] + p[1] / x**3)),
    Law("shear alone", "1/E = a/L^2", (_A,), (0.01,), _over(lambda p, x: p[0] / x**2)),
    Law("affine", "E = c + e L", ("c (MPa)", "e (MPa/m)"), (0.1, 15.0), lambda p, x: p[0] + p[1] * x, positive=False),
    Law("power", "E = c L^n", ("c (MPa)", "n"), (20.0, 1.4), lambda p, x: p[0] * x ** p[1]),
    Law("dead length", "E = E0 (1 - d/L)^3", (_E0, "d (m)"), (6.0, 0.02),
        lambda p, x: p[0] * np.clip(1 - p[1] / x, 1e-3, None) ** 3),
)  # fmt: skip


@dataclass(frozen=True)
class LawFit:
    """A form fitted to the table."""

    law: Law
    values: tuple[float, ...]
    log_rms: float
    """Root mean square of log E: 0.06 is 6 %."""
    aicc: float
    """Akaike's criterion for few points; the scatter counts as a parameter. Smaller is better."""
    leave_one_out: float
    """Root mean square of log E at the length left out."""
    shortest: float
    """m: below this length the form gives no positive modulus; 0 when it always does."""

    def as_dict(self) -> dict[str, object]:
        """JSON-able."""
        return {
            "form": self.law.name, "formula": self.law.formula,
            "parameters": dict(zip(self.law.parameters, self.values, strict=True)),
            "log_rms": self.log_rms, "aicc": self.aicc if math.isfinite(self.aicc) else None,
            "leave_one_out": self.leave_one_out,
        }  # fmt: skip


@dataclass(frozen=True)
class ModuliFindings:
    """Table II against all forms, and what the best physical one would imply."""

    lengths: Array
    moduli: Array
    """MPa"""
    fits: tuple[LawFit, ...]
    spine_radius: float
    """m"""
    shape_factor: float = 0.9
    """Shear coefficient kappa of a round section."""

    def fit(self, name: str) -> LawFit:
        """By the form's name."""
        return next(f for f in self.fits if f.law.name == name)

    @property
    def shear_modulus(self) -> float:
        """MPa that the shear-like form implies for a solid round bar: G = 3 r^2 / (4 kappa a)."""
        return 3 * self.spine_radius**2 / (4 * self.shape_factor * self.fit("shear-like").values[1])

    @property
    def tied(self) -> tuple[str, ...]:
        """Forms within 4 of the smallest AICc, the shear-like one left out: not to be told from it by six points."""
        best = min(f.aicc for f in self.fits)
        return tuple(f.law.name for f in self.fits if f.aicc < best + 4 and f.law.name != "shear-like")

    @property
    def growth(self) -> float:
        """Largest over smallest modulus."""
        return float(self.moduli.max() / self.moduli.min())

    def sentences(self) -> tuple[str, ...]:
        """What may be said, and no more."""
        shear, constant, affine = self.fit("shear-like"), self.fit("constant"), self.fit("affine")
        turn, shift = self.fit("root rotation"), self.fit("root translation")
        e0 = shear.values[0]
        stiff = e0 / self.shear_modulus
        return (
            f"Table II grows {self.growth:.0f}-fold. One modulus misses it by {constant.log_rms:.0%} (rms of log E); "
            f"{e0:.1f} MPa with a shear-like compliance a/L^2, a = {shear.values[1]:.4f} m^2/MPa, by {shear.log_rms:.1%}, and by "
            f"{shear.leave_one_out:.1%} at a length left out, the best of all forms tried.",
            f"Excluded as sole causes: rotation of the root ({turn.log_rms:.0%}) and translation of root or arm "
            f"({shift.log_rms:.0%}).",
            f"Not settled: {' and '.join(self.tied) or 'no other form'} fits as well ({affine.log_rms:.1%}, but "
            f"{affine.leave_one_out:.0%} at a length left out, and negative below {affine.shortest * 100:.1f} cm); there are six "
            f"points without scatter; and a solid bar of this radius would need G = {self.shear_modulus:.3f} MPa, E0/G = "
            f"{stiff:.0f} where a solid has about 3: if this is shear, it is not that of a solid beam.",
            DECISIVE_TEST.format(factor=self.moduli[-1] / self.moduli[0]),
        )

    def as_dict(self) -> dict[str, object]:
        """JSON-able."""
        return {
            "forms": [f.as_dict() for f in self.fits],
            "implied_shear_modulus_mpa": self.shear_modulus,
            "tied_with_shear": list(self.tied),
            "said": list(self.sentences()),
        }


def modulus_forms(table: Mapping[float, float], spine_radius: float) -> ModuliFindings:
    """Fit all forms to a table spine length (m) -> apparent modulus (Pa); raises ValueError for fewer than five rows."""
    if len(table) < 5:
        raise ValueError(f"a table of {len(table)} spine lengths: at least 5 are needed to compare forms of 2 parameters")
    lengths = np.array(sorted(table))
    moduli = np.array([table[x] for x in lengths]) / 1e6
    return ModuliFindings(lengths, moduli, tuple(_fitted(law, lengths, moduli) for law in LAWS), spine_radius)


def _fitted(law: Law, lengths: Array, moduli: Array) -> LawFit:
    values = _values(law, lengths, moduli)
    misses = np.log(law.form(values, lengths)) - np.log(moduli)
    n, k = len(lengths), len(values) + 1
    aicc = n * math.log(float(misses @ misses) / n) + 2 * k + (2 * k * (k + 1) / (n - k - 1) if n > k + 1 else math.inf)
    left_out = []
    for i in range(n):
        others = np.arange(n) != i
        guess = law.form(_values(law, lengths[others], moduli[others]), lengths[i : i + 1])
        left_out.append(math.log(max(float(guess[0]), 1e-6) / moduli[i]))
    grid = np.linspace(0.001, 0.3, 3000)
    bad = grid[law.form(values, grid) <= 0]
    return LawFit(
        law,
        tuple(float(v) for v in values),
        float(np.sqrt(np.mean(misses**2))),
        aicc,
        float(np.sqrt(np.mean(np.square(left_out)))),
        float(bad.max()) if bad.size else 0.0,
    )


def _values(law: Law, lengths: Array, moduli: Array) -> Array:
    """Least squares of log E; parameters that must be above 0 are searched for as logarithms."""
    start = np.array(law.start)

    def misses(x: Array) -> Array:
        guess = law.form(np.exp(x) if law.positive else x, lengths)
        return np.log(np.maximum(guess, 1e-6)) - np.log(moduli)

    found = least_squares(misses, np.log(start) if law.positive else start, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=4000)
    return np.exp(found.x) if law.positive else found.x
