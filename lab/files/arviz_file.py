"""The probabilities of a diagnosis as ArviZ's InferenceData: a NetCDF file that arviz, xarray, Julia and R open.

Group `posterior`: parameters of the most probable hypothesis that names an effect, dimensions chain and draw. A diagnosis states
each parameter's normal posterior (for the leading hypothesis also the physical bounds at which it is cut) and no covariance:
parameters are drawn independently of each other. Group `evidence`: every hypothesis of the ranking with its probability, log
evidence, error on unseen states and sizes.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import truncnorm

from diagnosis.answer.result import Diagnosis, Ranked
from model.robot import Robot
from recordings.own_files import replacing

from ..version import NAME, installed, source
from .config import ConfigError

CHAINS, DRAWS, SEED = 4, 1000, 1
NORMAL = "normal of the stated standard deviation, each parameter drawn independently: no covariance is stated"
CUT = "normal posterior cut at the physical bounds, each parameter drawn independently: no covariance is stated"

Array = NDArray[np.float64]


def write_inference(path: Path, answer: Diagnosis, robot: Robot) -> Path:
    """Write the file; returns it. Raises ConfigError where xarray is not installed or nothing was weighed."""
    try:
        xarray = import_module("xarray")
        import_module("h5netcdf")
    except ImportError as e:
        raise ConfigError(f"--arviz needs {e.name}, which is not installed; pip install 'softlab[arviz]'") from e
    if not answer.attribute.ranking:
        raise ConfigError(f"{path}: the diagnosis weighs no hypothesis")
    git = source()
    shared = {
        "created_at": datetime.now(UTC).isoformat(), "inference_library": NAME, "inference_library_version": installed(),
        "robot": robot.name, "statement": answer.statement, "verdict": answer.attribute.verdict, "states": answer.data.rows,
        "trials": answer.data.trials, **({"source_commit": git["commit"]} if git["commit"] else {}),
    }  # fmt: skip
    groups = {"evidence": _evidence(xarray, answer, shared)}
    named = next((r for r in answer.attribute.ranking if r.parameters), None)
    if named is not None:
        groups["posterior"] = _posterior(xarray, answer, named, shared)
    with replacing(path) as (file, new):
        file.close()
        xarray.Dataset(attrs=shared).to_netcdf(new, mode="w", engine="h5netcdf")
        for name, group in groups.items():
            group.to_netcdf(new, mode="a", group=name, engine="h5netcdf")
    return path


def _posterior(xarray: Any, answer: Diagnosis, named: Ranked, shared: Mapping[str, Any]) -> Any:
    leads = list(named.effects) == list(answer.detail.get("best_hypothesis", ()))
    cut = {s["name"]: s for s in answer.detail.get("sizes", ())} if leads else {}
    rng = np.random.default_rng(SEED)
    variables = {}
    for name, p in named.parameters.items():
        stated = cut.get(name, {"mean": p.value, "low": -np.inf, "high": np.inf})
        values = _drawn(stated["mean"], p.sd, stated["low"], stated["high"], rng)
        variables[name] = xarray.DataArray(values, dims=("chain", "draw"), attrs={"units": p.unit})
    about = {
        "hypothesis": " + ".join(named.effects), "probability": named.probability, "seed": SEED,
        "drawn_from": CUT if cut else NORMAL,
    }  # fmt: skip
    counts = {"chain": np.arange(CHAINS), "draw": np.arange(DRAWS)}
    return xarray.Dataset(variables, coords=counts, attrs={**shared, **about})


def _drawn(mean: float, sd: float, low: float, high: float, rng: np.random.Generator) -> Array:
    """(chains, draws) of a normal cut at low and high."""
    if sd <= 0.0:
        return np.full((CHAINS, DRAWS), mean)
    cut = truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)
    return np.clip(cut.rvs(size=(CHAINS, DRAWS), random_state=rng), low, high)


def _evidence(xarray: Any, answer: Diagnosis, shared: Mapping[str, Any]) -> Any:
    ranking = answer.attribute.ranking
    sizes = {name: p.unit for r in ranking for name, p in r.parameters.items()}
    effects = sorted({e for r in ranking for e in r.effects})

    def column(of: list[float | None], about: str, units: str = "1") -> Any:
        values = np.array([np.nan if v is None else v for v in of])
        return xarray.DataArray(values, dims="hypothesis", attrs={"units": units, "long_name": about})

    def table(of: str, about: str) -> Any:
        rows = [[getattr(r.parameters[n], of) if n in r.parameters else np.nan for n in sizes] for r in ranking]
        values = np.array(rows, np.float64).reshape(len(ranking), len(sizes))
        return xarray.DataArray(values, dims=("hypothesis", "parameter"), attrs={"long_name": about})

    named = np.array([[int(e in r.effects) for e in effects] for r in ranking], np.int8).reshape(len(ranking), -1)
    variables = {
        "probability": column([r.probability for r in ranking], "probability given the data"),
        "log_evidence": column([r.log_evidence for r in ranking], "log marginal likelihood, as computed"),
        "heldout_rmse": column([r.heldout_rmse_mm for r in ranking], "rms tip error on states that the fit did not see", "mm"),
        "named": xarray.DataArray(named, dims=("hypothesis", "effect"), attrs={"long_name": "1 where the hypothesis names it"}),
        "value": table("value", "fitted, in the parameter's unit"),
        "sd": table("sd", "standard deviation, in the parameter's unit"),
    }  # fmt: skip
    coords = {
        "hypothesis": [" + ".join(r.effects) or "none" for r in ranking],
        "effect": effects,
        "parameter": list(sizes),
        "unit": ("parameter", list(sizes.values())),
    }
    return xarray.Dataset(variables, coords=coords, attrs=dict(shared))
