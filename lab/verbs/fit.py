"""`lab fit`: moduli from stiffness trials, the effective chamber area from bending states, and a robot.yaml that holds them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import yaml
from rich.table import Table as Sheet

from model.errors import ModelError
from model.estimate import Estimate

from ..calibration import Calibration, calibrate
from ..console import note, out
from ..files.config import ConfigError
from ..files.inputs import read_case


def fit(inputs: Sequence[Path], robot: Path | None, folder: Path | None, as_json: bool) -> int:
    """Print the calibration; with a folder also write the calibrated robot.yaml."""
    case = read_case(inputs, robot)
    note(case.table.warnings)
    try:
        result = calibrate(case)
    except ModelError as e:
        raise ConfigError(str(e)) from e
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.yaml").write_text(yaml.safe_dump(result.robot.model_dump(mode="json"), sort_keys=False))
    if as_json:
        print(json.dumps(result.as_dict(), indent=1))
    else:
        out.print(sheet(result))
    return 0


def sheet(c: Calibration) -> Sheet:
    """The calibration as a table."""
    t = Sheet(title="Calibration (± standard error)", title_justify="left")
    for column in ("parameter", "spine", "value", "n", "left over"):
        t.add_column(column)
    for length, e in c.spine_modulus.items():
        t.add_row("E of the spine", f"{length * 100:.1f} cm", _mpa(e), str(e.n), f"{e.rms_residual:.3f} N")
    if c.body_modulus:
        t.add_row(
            "E of the body (eq. 8)",
            "0 cm",
            _mpa(c.body_modulus),
            str(c.body_modulus.n),
            f"{c.body_modulus.rms_residual:.3f} N",
        )
    for length, a in c.area_factor_by_length.items():
        t.add_row(
            "A_eff / A", f"{length * 100:.1f} cm", _plain(a.factor), str(a.factor.n), f"{a.rmse * 1e3:.2f} mm rms"
        )
    if c.area_factor:
        t.add_row(
            "A_eff / A, one for all",
            "all",
            _plain(c.area_factor.factor),
            str(c.area_factor.factor.n),
            f"{c.area_factor.rmse * 1e3:.2f} mm rms",
        )
    return t


def _mpa(e: Estimate) -> str:
    return f"{e.value / 1e6:.3f} ± {e.standard_error / 1e6:.3f} MPa"


def _plain(e: Estimate) -> str:
    return f"{e.value:.3f} ± {e.standard_error:.3f}"
