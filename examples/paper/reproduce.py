"""Reproduce the paper: its model curves, what its integrator alone contributes to its error, and what its tables say.

    python examples/paper/reproduce.py --out out/paper      # tables on the screen; six figures and paper.json in the folder

Table I and II and the calibrated area factors are in robot.yaml. Table III (mean error of the paper's model against its
measurements) stands below: the measured tips were not published. The paper's X is -x of the base frame, its Y is z. SI units.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lab.pages.figures import BLUE, GREY, STYLE, colours, save
from model.body import annulus_second_moment, body_of
from model.calibration import fit_area_factor_by_length
from model.compare import error_table
from model.condition import States, conditions
from model.effects.layout import INNER, OUTER
from model.robot import Robot, load_robot
from model.rods import FINE, PAPER, Paper, Rods, solve
from model.section import rods_of

Array = NDArray[np.float64]
ROBOT = load_robot(Path(__file__).with_name("robot.yaml"))
SPINE_LENGTHS = np.array([0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30])
PRESSURES = np.array([50e3, 100e3, 150e3, 200e3, 250e3])
"""m and Pa gauge, as in Fig. 5; chambers 9, 1 and 2 are inflated."""
PUBLISHED = np.array([[12.7, 3.4], [7.8, 3.7], [9.0, 3.2], [9.6, 3.7], [13.2, 3.5], [11.0, 4.2], [9.99, 4.4]]) * 1e-3
"""(l, 2) m, Table III: mean absolute error in X and Y by spine length."""
EXTENDING = np.arange(0, 151e3, 30e3)
"""Pa gauge in all nine chambers, as in Fig. 4 (C)."""
READINGS = {"force and moment (eq. 4, 5 as printed)": True, "moment alone (walls balanced)": False}
"""Two readings of the pressure load: whether the gas also pushes at the tip, or the curved walls balance that force."""
RED = "#b5382a"


def bending_states(robot: Robot = ROBOT) -> States:
    """The 35 states of Fig. 5: spine lengths (slow) by pressures (fast)."""
    length, pressure = (a.ravel() for a in np.meshgrid(SPINE_LENGTHS, PRESSURES, indexing="ij"))
    chambers = np.zeros((length.size, 9))
    chambers[:, [8, 0, 1]] = pressure[:, None]
    return conditions(robot, length, chambers)


# ------------------------------------------------------------------ the curves, and the integrator's own error
class Curves(NamedTuple):
    """Tips (l, p, 3) m of the converged rod and of the paper's Euler steps, and what the steps alone move."""

    converged: Array
    euler: Array
    backbones: Array
    """(l, k, 3) m at the highest pressure."""
    integrator: Array
    """(l, 2) m, mean absolute error in X and Y."""
    worst: Array
    """(l,) m."""
    worst_fine: float
    """m, with a thousand steps."""
    factor: Array
    """(l,) A_eff / A_norm with which the converged rod comes closest to the paper's curves."""
    after_calibration: Array
    """(l,) m rms that this factor leaves."""


def curves(robot: Robot = ROBOT) -> Curves:
    """Solve Fig. 5 with the converged rod and as the paper does. Raises `SolveFailed`."""
    states, grid = bending_states(robot), (len(SPINE_LENGTHS), len(PRESSURES), 3)
    rods = rods_of(robot, states)
    converged, euler, fine = (solve(rods, method).trusted().tip for method in (FINE, PAPER, Paper(1000)))
    rows = error_table(states, euler, converged, robot.length).rows
    refitted = fit_area_factor_by_length(robot, states, euler).values()
    highest = rods_of(robot, states[states.pressure.max(axis=1) == PRESSURES[-1]])
    return Curves(
        converged.reshape(grid),
        euler.reshape(grid),
        solve(highest, FINE, arc_lengths=np.linspace(0, robot.length, 41)).trusted().shape,
        np.array([[row.mean_abs_x, row.mean_abs_z] for row in rows]),
        np.array([row.worst for row in rows]),
        float(np.linalg.norm(fine - converged, axis=1).max()),
        np.array([fit.value for fit in refitted]),
        np.array([fit.rms_residual for fit in refitted]),
    )


def elongation(robot: Robot = ROBOT) -> Array:
    """(l, p) m by which all nine chambers lengthen the robot at `SPINE_LENGTHS` and `EXTENDING`. Raises `SolveFailed`."""
    length, pressure = (a.ravel() for a in np.meshgrid(SPINE_LENGTHS, EXTENDING, indexing="ij"))
    rods = rods_of(robot, conditions(robot, length, np.tile(pressure[:, None], 9)))
    down = solve(rods, FINE).trusted().tip[:, 2].reshape(len(SPINE_LENGTHS), -1)
    return np.asarray(down - down[:, :1])


# ------------------------------------------------------------------ Table II: which form its modulus over length follows
Form = Callable[[Array, Array], Array]
"""(parameters above 0, lengths in m) -> modulus in MPa."""
FORMS: dict[str, tuple[str, tuple[float, ...], Form]] = {
    "constant": ("E0", (2.0,), lambda p, x: np.full(x.shape, p[0])),
    "shear-like": ("1/E = 1/E0 + a/L^2", (5.0, 0.01), lambda p, x: 1 / (1 / p[0] + p[1] / x**2)),
    "shear and root rotation": ("1/E = 1/E0 + a/L^2 + b/L", (5.0, 0.01, 1e-3),
                                lambda p, x: 1 / (1 / p[0] + p[1] / x**2 + p[2] / x)),
    "root rotation": ("1/E = 1/E0 + b/L", (50.0, 0.1), lambda p, x: 1 / (1 / p[0] + p[1] / x)),
    "root translation": ("1/E = 1/E0 + d/L^3", (5.0, 3e-4), lambda p, x: 1 / (1 / p[0] + p[1] / x**3)),
    "shear alone": ("1/E = a/L^2", (0.01,), lambda p, x: x**2 / p[0]),
    "affine": ("E = e (L - c)", (15.0, 0.01), lambda p, x: p[0] * (x - p[1])),
    "hanging weight": ("E = E0 + g L^3", (1.0, 50.0), lambda p, x: p[0] + p[1] * x**3),
    "power": ("E = c L^n", (20.0, 1.4), lambda p, x: p[0] * x ** p[1]),
    "dead length": ("E = E0 (1 - d/L)^3", (6.0, 0.02), lambda p, x: p[0] * np.clip(1 - p[1] / x, 1e-3, None) ** 3),
}  # fmt: skip


def of_weight(density: float, length: float, radius: float) -> float:
    """Pa, what its own weight adds to the apparent modulus k L^3 / (3 I) of a beam that hangs from its clamp and is pushed
    sideways at its tip: rho g L^3 / (2 r^2), from the work of the tension rho g A (L - x) along the deflection of a tip load."""
    return density * 9.81 * length**3 / (2 * radius**2)


class FormFit(NamedTuple):
    """A form fitted by least squares of log E, so that all rows of the table have the same weight."""

    form: str
    formula: str
    parameters: tuple[float, ...]
    log_rms: float
    aicc: float
    """Akaike's criterion for few points; the scatter counts as a parameter."""
    left_out: float
    """rms of log E at the length left out."""


def modulus_forms(table: Mapping[float, float]) -> list[FormFit]:
    """Fit all forms to spine length (m) -> apparent modulus (Pa), the best by `left_out` first. ValueError below five rows."""
    if len(table) < 5:
        raise ValueError(f"a table of {len(table)} spine lengths: at least 5 are needed to compare forms of 2 parameters")
    x, y = np.array(sorted(table)), np.log([table[length] / 1e6 for length in sorted(table)])

    def misses(form: Form, p: Array, at: slice | Array = slice(None)) -> Array:
        return np.log(np.maximum(form(p, x[at]), 1e-6)) - y[at]

    def fitted(form: Form, start: tuple[float, ...], at: slice | Array = slice(None)) -> Array:
        found = least_squares(lambda q: misses(form, np.exp(q), at), np.log(start), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        return np.exp(found.x)

    fits = []
    for name, (formula, start, form) in FORMS.items():
        p, n, k = fitted(form, start), len(x), len(start) + 1
        square = float(np.mean(misses(form, p) ** 2))
        out = [misses(form, fitted(form, start, np.arange(n) != i), np.arange(n) == i)[0] for i in range(n)]
        aicc = n * math.log(square) + 2 * k + (2 * k * (k + 1) / (n - k - 1) if n > k + 1 else math.inf)
        fits.append(
            FormFit(name, formula, tuple(map(float, p)), math.sqrt(square), aicc, float(np.sqrt(np.mean(np.square(out)))))
        )
    return sorted(fits, key=lambda f: f.left_out)


# ------------------------------------------------------------------ A_eff 1.5 -> 2.4: how eq. 10 mixes the spine in
class Area(NamedTuple):
    """The paper's curves refitted under one reading of the pressure load. Factors are A_eff / A_norm, rms in m."""

    rms_volume: float
    """One factor, Young's moduli mixed by volume (eq. 10)."""
    rms_added: float
    """One factor, stiffnesses added: E_c I_c + E_s I_s, E_c A_c + E_s A_s."""
    needed: Array
    """(l,) factors that added stiffnesses need."""
    share: float
    """Of the stiffness that eq. 10 credits to the spine: what one factor for all lengths asks for."""
    rms_share: float


def added_bending(robot: Robot, lengths: Array) -> Array:
    """E_c I_c + E_s I_s (N m^2) at spine lengths (m)."""
    assert robot.spine is not None
    spine = robot.spine.modulus_at(lengths) * annulus_second_moment(robot.spine.radius)
    return robot.youngs_modulus * body_of(robot).mean_second + np.where(lengths > 0, spine, 0.0)


def mixed_bending(robot: Robot, lengths: Array) -> Array:
    """E_eq I (N m^2) of the part with spine at spine lengths (m): Young's moduli mixed by volume (eq. 10)."""
    bend = rods_of(robot, conditions(robot, lengths, np.zeros(9))).field("bend_stiffness")[..., 0]
    return np.where(lengths > 0, bend[:, INNER], bend[:, OUTER])


def area_by_reading(robot: Robot = ROBOT) -> dict[str, Area]:
    """Refit the paper's own curves under each of `READINGS`."""
    spine, states, unit = robot.spine, bending_states(robot), robot.replace(area_factor=1.0)
    assert spine is not None

    def rods(of: Robot, pushes: bool) -> Rods:
        return rods_of(of, states) if pushes else rods_of(of, states).changed(tip_force=0.0)

    def tips(of: Rods, factor: float = 1.0) -> Array:
        scaled = {name: factor * of.field(name) for name in ("tip_force", "tip_moment")}
        return solve(of.changed(**scaled), FINE).trusted().tip

    def weaker(share: float, pushes: bool) -> Rods:
        modulus = {length: share * e for length, e in spine.modulus.items()}
        return rods(unit.model_copy(update={"spine": spine.model_copy(update={"modulus": modulus})}), pushes)

    def rms(distance: Array) -> float:
        return float(np.sqrt(np.mean(np.sum(distance**2, axis=1))))

    def one_factor(of: Rods, wanted: Array) -> tuple[float, float]:
        x = least_squares(lambda x: (tips(of, x[0]) - wanted).ravel(), [1.6], bounds=(0.2, 5), diff_step=1e-4).x
        return float(x[0]), rms(tips(of, x[0]) - wanted)

    found = {}
    for name, pushes in READINGS.items():
        wanted, volume = tips(rods(robot, pushes)), rods(unit, pushes)
        stretch, bend = volume.field("stretch_stiffness").copy(), volume.field("bend_stiffness").copy()
        area = math.pi * spine.radius**2 * spine.modulus_at(states.spine_length) * (states.spine_length > 0)
        more = added_bending(robot, states.spine_length) / (robot.youngs_modulus * body_of(robot).mean_second)
        stretch[:, INNER] = stretch[:, OUTER] * (1 + area / (robot.youngs_modulus * body_of(robot).mean_area))[:, None]
        bend[:, INNER] = bend[:, OUTER] * more[:, None]
        added = volume.changed(stretch_stiffness=stretch, bend_stiffness=bend)
        factor, rms_added = one_factor(added, wanted)
        both = least_squares(lambda x: (tips(weaker(x[1], pushes), x[0]) - wanted).ravel(),  # noqa: B023
                             [factor, 0.5], bounds=([0.2, 0.05], [5, 2]), diff_step=1e-4).x  # fmt: skip
        needed = np.array([one_factor(added[own], wanted[own])[0] for _, own in states.by_spine_length()])
        left = rms(tips(weaker(both[1], pushes), both[0]) - wanted)
        found[name] = Area(one_factor(volume, wanted)[1], rms_added, needed, float(both[1]), left)
    return found


# ------------------------------------------------------------------ tables and figures
def show(c: Curves, forms: list[FormFit], areas: Mapping[str, Area], longer: Array) -> None:
    """Print the tables, and what they say and do not say."""
    cm = [f"{100 * length:g} cm" for length in SPINE_LENGTHS]
    tips = [[f"{-1e3 * x:.1f}, {1e3 * z:.1f}" for x, _, z in row] for row in c.converged]
    print("Model tips of Fig. 5, converged: sideways, down (mm)")
    print(pd.DataFrame(tips, cm, [f"{p / 1e3:g} kPa" for p in PRESSURES]).to_string())
    print(f"\nTable III next to the error of {PAPER.steps} Euler steps alone (mm); a thousand leave {1e3 * c.worst_fine:.2f} mm")
    errors = 1e3 * np.column_stack([PUBLISHED, c.integrator, c.worst, c.after_calibration])
    print(pd.DataFrame(errors, cm, ["paper X", "paper Y", "steps X", "steps Y", "worst", "calibrated"]).round(2).to_string())
    print("The paper does not give its step count, and a calibrated area factor absorbs most of this error.")
    x, y = PUBLISHED.max(axis=0)
    print(f"The text says 3.3 % and 1.05 % of {ROBOT.length:g} m. Largest in Table III: {x / ROBOT.length:.1%} in X; in Y "
          f"{1e3 * y:.1f} mm, {y / ROBOT.length:.2%}, where the text has 4.2 mm.")  # fmt: skip
    print("\nFig. 4 (C): how much all nine chambers lengthen the calibrated model (mm)")
    print(pd.DataFrame(1e3 * longer, cm, [f"{p / 1e3:g} kPa" for p in EXTENDING]).round(1).to_string())
    shorter = ", ".join(name for name, own in zip(cm, longer[:, -1], strict=True) if own < longer[0, -1])
    print(
        f"The paper says that a spine reduces extension. Its model extends less with {shorter} only: A_eff outweighs the others."
    )
    print("\nTable II: forms of the modulus over length; errors are rms of log E")
    print(pd.DataFrame([f._replace(parameters="") for f in forms]).drop(columns="parameters").round(3).to_string(index=False))
    print("Rotation or translation of the root alone is excluded; six points do not separate shear from an affine form. One\n"
          "30 cm spine clamped at spans of 5 to 30 cm would: sheared, its modulus follows the span.")  # fmt: skip
    assert ROBOT.spine is not None
    grown = (max(ROBOT.spine.modulus.values()) - min(ROBOT.spine.modulus.values())) / 1e6
    light, heavy = (of_weight(rho, SPINE_LENGTHS[-1], ROBOT.spine.radius) / 1e6 for rho in (150, 1300))
    print(f"Gravity, the paper's explanation, adds rho g L^3 / (2 r^2) to a beam that hangs: {light:.2f} to {heavy:.2f} MPa at "
          f"{cm[-1]} for 150 to 1300 kg/m^3, of a growth by {grown:.2f} MPa.")  # fmt: skip
    print("\nA_eff / A_norm, published, and needed when stiffnesses are added in place of mixing moduli by volume")
    needed = {"published": ROBOT.area_factor_at(SPINE_LENGTHS), **{name: a.needed for name, a in areas.items()}}
    print(pd.DataFrame(needed, cm).round(2).to_string())
    for name, a in areas.items():
        print(f"{name}: one factor leaves {1e3 * a.rms_volume:.1f} mm rms mixed by volume, {1e3 * a.rms_added:.1f} mm added, "
              f"{1e3 * a.rms_share:.1f} mm with {a.share:.2f} of the spine's credited stiffness")  # fmt: skip
    print("Eq. 10 credits the spine with two to three times its bending stiffness. Area moments or a weak spine explain it.")


def figures(c: Curves, forms: list[FormFit], areas: Mapping[str, Area], longer: Array, out: Path) -> list[Path]:
    """Draw six figures (PNG) into `out`."""
    assert ROBOT.spine is not None
    cm, kpa, euler = 100 * SPINE_LENGTHS, PRESSURES / 1e3, f"Euler, {PAPER.steps} steps"
    names, shades = [f"{x:g} cm" for x in cm], colours(len(cm))
    made = []

    def panels(n: int, *size: float) -> Any:
        figure, axes = plt.subplots(1, n, figsize=size, layout="constrained", squeeze=False)
        return figure, axes[0]

    with plt.rc_context(STYLE):
        figure, axes = panels(2, 9.6, 4.2)
        for axis, k, sign, name in ((axes[0], 0, -1e3, "x, sideways"), (axes[1], 2, 1e3, "y, down")):
            for i, colour in enumerate(shades):
                axis.plot(kpa, sign * c.converged[i, :, k], color=colour, label=names[i])
                axis.plot(kpa, sign * c.euler[i, :, k], "o", ms=4.5, mfc="none", color=colour)
            axis.set(xlabel="pressure in three chambers (kPa)", ylabel=f"tip {name} (mm)", xticks=kpa)
        axes[0].legend(title=f"spine; marks: {euler}")
        made.append(save(figure, out / "model_curves.png"))

        figure, (axis,) = panels(1, 4.8, 5.2)
        inside = np.linspace(0, ROBOT.length, c.backbones.shape[1]) <= SPINE_LENGTHS[:, None] + 1e-9
        for i, (shape, colour) in enumerate(zip(1e3 * c.backbones, shades, strict=True)):
            # short spines on top of long ones, or the longest would hide them all
            axis.plot(-shape[inside[i], 0], shape[inside[i], 2], color=colour, lw=5, zorder=3 - 0.1 * i)
            axis.plot(-shape[:, 0], shape[:, 2], color=colour, lw=1.5, zorder=3 - 0.1 * i, label=names[i])
        axis.set(
            aspect="equal", xlabel="x, sideways (mm)", ylabel="y, down (mm)", title=f"{kpa[-1]:g} kPa; thick: holds the spine"
        )
        axis.invert_yaxis()
        axis.legend(title="spine")
        made.append(save(figure, out / "backbones.png"))

        figure, axes = panels(2, 9.0, 3.4)
        for k, (axis, name) in enumerate(zip(axes, ("X, sideways", "Y, down"), strict=True)):
            for values, shift, colour, label in (
                (PUBLISHED, -0.2, GREY, "Table III"),
                (c.integrator, 0.2, RED, f"{euler}, alone"),
            ):
                bars = axis.bar(np.arange(len(cm)) + shift, 1e3 * values[:, k], 0.38, color=colour, label=label)
                axis.bar_label(bars, fmt="%.1f", fontsize=7)
            axis.set_xticks(range(len(cm)), names)
            axis.set(title=name, xlabel="spine length", ylabel="mean absolute error (mm)")
        axes[0].legend()
        made.append(save(figure, out / "integrator_error.png"))

        figure, (left, right) = panels(2, 9.6, 3.9)
        x = np.linspace(0.04, 0.31, 300)
        for f in forms:
            if f.form in ("shear-like", "affine", "root translation", "root rotation", "constant"):
                left.semilogy(100 * x, FORMS[f.form][2](np.array(f.parameters), x), label=f"{f.form}, {f.log_rms:.0%}")
        left.plot([100 * k for k in ROBOT.spine.modulus], [e / 1e6 for e in ROBOT.spine.modulus.values()], "ks", label="Table II")
        left.set(ylim=(0.2, 9), xlabel="spine length (cm)", ylabel="apparent modulus (MPa)")
        left.legend(fontsize=8)
        at = np.arange(len(forms))
        right.barh(at - 0.19, [100 * f.log_rms for f in forms], 0.36, color=GREY, label="fitted")
        right.barh(at + 0.19, [100 * f.left_out for f in forms], 0.36, color=BLUE, label="at a length left out")
        right.set_yticks(at, [f.form for f in forms])
        right.set_xlabel("rms error of log E (%)")
        right.legend()
        made.append(save(figure, out / "modulus.png"))

        figure, (axis,) = panels(1, 6.2, 3.9)
        axis.plot(cm, ROBOT.area_factor_at(SPINE_LENGTHS), "-s", color=GREY, label="published: moduli mixed by volume")
        axis.plot(cm, c.factor, "--", color=RED, label=f"converged rod, fitted to the curves of {euler}")
        for (name, a), mark, colour in zip(areas.items(), "o^", (RED, BLUE), strict=True):
            axis.plot(cm, a.needed, f"-{mark}", mfc="white", color=colour, label=f"stiffnesses added; {name}")
        axis.set(ylim=(1.3, 3.2), xticks=cm, xlabel="spine length (cm)", ylabel="A_eff / A_norm")
        axis.legend(fontsize=8)
        made.append(save(figure, out / "area_factor.png"))

        figure, (axis,) = panels(1, 5.4, 3.9)
        for own, name, colour in zip(1e3 * longer, names, shades, strict=True):
            axis.plot(EXTENDING / 1e3, own, color=colour, label=name)
        axis.set(xlabel="pressure in nine chambers (kPa)", ylabel="elongation (mm)", xticks=EXTENDING / 1e3)
        axis.legend(title="spine")
        made.append(save(figure, out / "elongation.png"))
    return made


def main(out: Path) -> None:
    """Compute and print everything; write figures and paper.json into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    c, forms, areas = curves(), modulus_forms(ROBOT.spine.modulus if ROBOT.spine else {}), area_by_reading()
    longer = elongation()
    show(c, forms, areas, longer)
    stiffer = mixed_bending(ROBOT, SPINE_LENGTHS) / added_bending(ROBOT, SPINE_LENGTHS)
    numbers = {"spine_lengths": SPINE_LENGTHS, "pressures": PRESSURES, **c._asdict(), "published_error_xy": PUBLISHED,
               "elongation_pressures": EXTENDING, "elongation": longer,
               "modulus_forms": [f._asdict() for f in forms], "stiffness_by_volume_over_added": stiffer,
               "area_factor": {name: a._asdict() for name, a in areas.items()}}  # fmt: skip
    (out / "paper.json").write_text(json.dumps(numbers, indent=1, default=lambda a: a.tolist()) + "\n", encoding="utf-8")
    for path in figures(c, forms, areas, longer, out):
        print(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Reproduce the paper's tables and model curves.")
    parser.add_argument("--out", type=Path, default=Path("out/paper"), help="folder for figures and paper.json")
    main(parser.parse_args().out)
