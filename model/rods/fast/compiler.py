"""How the kernels are compiled: pieces that are inlined or called, entry points that are cached on disk, one instruction that
Python has no word for.

Numba decides by the date of one file whether its cached machine code is still good; the kernels here are spread over
several files, so a change in any of them drops what was compiled from all of them.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from llvmlite import binding
from numba.core import config, types
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary, get_host_cpu_features
from numba.core.compiler import Compiler
from numba.core.runtime import rtsys
from numba.extending import intrinsic

Function = TypeVar("Function", bound=Callable[..., Any])

_STAMP = "kernels.sha"
_kernels: list[Any] = []

# Loops over lanes become vectors; whether LLVM unrolls them before, to scalars, would hang on what it guesses of their size.
binding.set_option("", "-unroll-full-max-count=8")

# LLVM leaves half of an AVX-512 vector empty on processors that it fears slow down. Numba asks for features once, at its first
# decorator, so this file comes before all others of the package.
_numba: Any = config
if _numba.CPU_FEATURES is None and binding.get_host_cpu_features().get("avx512f", False):
    _numba.CPU_FEATURES = get_host_cpu_features() + ",-prefer-256-bit"


def _compiled(**options: Any) -> Callable[[Any], Any]:
    """Numba's decorator with what all kernels and pieces have in common.

    `options` are further ones of `numba.njit`. Arithmetic is that of IEEE 754: a division by zero gives inf or nan and raises
    nothing (`error_model`), and without `fastmath`, since a loop is compiled with and without vectors, and where arrays lie in
    memory decides which of the two runs; with strict rounding alone both give the same bits. It costs no measurable time.
    """
    made: Callable[[Any], Any] = numba.njit(error_model="numpy", **options)
    return made


class _PieceCode(JITCodeLibrary):  # type: ignore[misc]
    """The code of a piece, which LLVM optimises and turns into machine code only as part of the kernels that call it."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> _PieceCode:
        return self

    def set_env(self, name: str, env: object) -> None:
        """Nothing: there is no machine code to be told of its environment."""


class _PieceCompiler(Compiler):  # type: ignore[misc]
    """Compiles a piece."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.state.library = _PieceCode(self.state.targetctx.codegen(), "piece")


def _piece(function: Function, **options: bool) -> Function:
    """A piece of a kernel, not to be called from Python, so that nothing is compiled for that. It makes no array.

    Pieces work on arrays that their kernel keeps: counting references to these whenever a group of arrays is handed on would
    take a tenth of the time and more.
    """
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    piece = _compiled(pipeline_class=_PieceCompiler, **options)(function)
    # Numba compiles a piece anew for each constant it is called with (stage 0, stage 1, ..): a third of all compiling.
    for_types = piece.get_call_template
    piece.get_call_template = lambda args, kws: for_types(
        [types.unliteral(a) for a in args], {name: types.unliteral(a) for name, a in kws.items()}
    )
    return cast(Function, piece)


def inline(function: Function) -> Function:
    """A piece that is compiled into its callers."""
    return _piece(function, forceinline=True)


def routine(function: Function) -> Function:
    """A piece that is compiled once and called: for what would be large when copied into its callers."""
    return _piece(function, forceinline=False)  # said, since numba takes over what it does not hear from the caller


def allocating(function: Function) -> Function:
    """A piece that makes arrays for the kernel that calls it."""
    return cast(Function, _compiled(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function))


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """Machine code on disk, which is loaded without all that Numba imports in order to compile."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)  # what allocates arrays
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def kernel(function: Function) -> Function:
    """An entry point: compiled once a machine, runs without the interpreter lock."""
    made: Any = _compiled(nogil=True)(function)
    made._cache = _KernelCache(function)
    _kernels.append(made)
    return cast(Function, made)


def compiled_here() -> int:
    """How many times this process had to compile an entry point, because its machine code was not on disk."""
    return sum(sum(made.stats.cache_misses.values()) for made in _kernels)


def drop_stale_kernels(folder: Path = Path(__file__).parent.parent) -> None:
    """Delete the cached machine code of this package when its sources are not those that it was made from (by their digest)."""
    digest = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    cache = folder / "__pycache__"
    stamp = cache / _STAMP
    # A read-only installation has nothing to drop: its sources do not change either.
    with contextlib.suppress(OSError):
        if stamp.exists() and stamp.read_text(encoding="ascii") == digest.hexdigest():
            return
        cache.mkdir(exist_ok=True)
        for index in folder.rglob("__pycache__/*.nbi"):
            index.unlink(missing_ok=True)
        stamp.write_text(digest.hexdigest(), encoding="ascii")


_FUSES = binding.get_host_cpu_features().get("fma", True)
"""Whether this processor fuses; those that are not asked (all but x86) do."""


def _fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    def written(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        a, b, c = values
        return builder.fma(a, b, c) if _FUSES else builder.fadd(builder.fmul(a, b), c)

    return types.float64(types.float64, types.float64, types.float64), written


fused = cast(Callable[[float, float, float], float], intrinsic(_fused))
"""a b + c, rounded once. Said here, not left to the compiler, it has the same bits in a loop with vectors and in one without."""
