"""What a person runs: the `lab` command, rig assembly, processes, figures and reports.

`import lab` is the front door for scripts and notebooks; `lab.api` documents its names.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import (
        Case,
        case,
        compare,
        diagnose,
        fit,
        fit_with,
        inverse,
        load_robot,
        open_rig,
        predict,
        predictor,
        read,
        run,
    )

__all__ = [
    "Case",
    "case",
    "compare",
    "diagnose",
    "fit",
    "fit_with",
    "inverse",
    "load_robot",
    "open_rig",
    "predict",
    "predictor",
    "read",
    "run",
]


def __getattr__(name: str) -> Any:
    """A name of the front door, when it is first used: the command's own start does not wait for all of it."""
    if name in __all__:
        from .neighbours import strangers

        if wrong := strangers():
            raise ImportError(wrong)
        return getattr(import_module(".api", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
