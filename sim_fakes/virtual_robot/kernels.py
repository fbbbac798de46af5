"""How the compiled functions of this package are compiled, and when their cache is thrown away.

Numba watches a function's own file only: a change in a file it calls into would leave the old machine code of the
caller in use. So the cache goes as a whole when any source file of the package is newer than it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba.core import config
from numba.core.codegen import get_host_cpu_features

# Numba asks for the processor's features once, at the first decorator of a process, and machine code on disk is good for those
# only. As in the rod kernels: else a process with both compiles one of them anew, depending on which was imported first.
_numba: Any = config
if _numba.CPU_FEATURES is None and binding.get_host_cpu_features().get("avx512f", False):
    _numba.CPU_FEATURES = get_host_cpu_features() + ",-prefer-256-bit"

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")
"""Decorator: compiled once and cached, runs without the interpreter lock; strictly rounded, so that bits repeat."""


def forget_stale_cache(folder: Path) -> None:
    """Delete the cache indices beside the sources in `folder` that are older than any of these sources."""
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for index in (folder / "__pycache__").glob("*.nbi"):
        if index.stat().st_mtime < newest:
            index.unlink(missing_ok=True)


forget_stale_cache(Path(__file__).parent)
