"""How the compiled functions of this package are compiled, and when their cache is thrown away.

Numba watches a function's own file only: a change in a file it calls into would leave the old machine code of the
caller in use. So the cache goes as a whole when any source file of the package is newer than it.
"""

from __future__ import annotations

from pathlib import Path

import numba

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")
"""Decorator: compiled once and cached, runs without the interpreter lock; strictly rounded, so that bits repeat."""


def forget_stale_cache(folder: Path) -> None:
    """Delete the cache indices beside the sources in `folder` that are older than any of these sources."""
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for index in (folder / "__pycache__").glob("*.nbi"):
        if index.stat().st_mtime < newest:
            index.unlink(missing_ok=True)


forget_stale_cache(Path(__file__).parent)
