"""
The one decorator of the numerical kernels: compiled by numba when it is installed.

A kernel is a plain scalar loop over arrays. With numba it becomes machine code that releases the
interpreter lock; without it (or with ``NUMBA_DISABLE_JIT=1``) the very same function runs in
Python. Both give the same bounds to the last bit: numba neither reorders nor fuses operations
unless told to, and it is not told to.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import hashlib
import os
from pathlib import Path
from typing import Any, TypeVar, overload

try:
    import numba
except ImportError:
    numba = None

Function = TypeVar('Function', bound=Callable[..., Any])


def _cache_directory() -> Path:
    """
    Return where compiled kernels of exactly these sources are kept.

    Numba dates a cached kernel by its own file only, although the kernels it calls are compiled
    into it: an edited callee would leave a stale caller. A folder per state of the sources cannot
    go stale, and lies outside the installation, which may be read-only.
    """
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob('*.py')):
        digest.update(source.read_bytes())
    base = os.environ.get('NUMBA_CACHE_DIR') or os.environ.get('XDG_CACHE_HOME')
    root = Path(base) if base else Path.home() / '.cache'
    return root / 'dg_localization' / digest.hexdigest()[:16]


def _compile(function: Function, borrows: bool, inlined: bool) -> Function:
    """Return `function` as a lazily compiled numba kernel, cached on disk where possible."""
    # Said of every kernel: where nothing is said, numba does as the caller does.
    options = {
        'nogil': True,
        'error_model': 'numpy',
        '_nrt': not borrows,
        'forceinline': inlined,
    }
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE_DIRECTORY
    try:
        return numba.njit(cache=True, **options)(function)
    except (OSError, RuntimeError):
        # No writable folder anywhere: compile anew in every process.
        return numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = previous


@overload
def kernel(function: Function) -> Function: ...


@overload
def kernel(*, borrows: bool = False, inlined: bool = False) -> Callable[[Function], Function]: ...


def kernel(
    function: Function | None = None, *, borrows: bool = False, inlined: bool = False
) -> Function | Callable[[Function], Function]:
    """
    Compile a function as a kernel; without numba, return the function itself.

    Parameters
    ----------
    function : callable
        The function, where the decorator is used without parentheses.
    borrows : bool, optional
        The kernel only borrows arrays: it neither makes nor returns any. Numba counts a reference
        to every array that a function is given, even within a tuple, by two atomic operations: a
        third of the time of a contraction. What is only borrowed need not be counted. Views are
        fine. A kernel that calls `np.empty` or the like does not compile; one that is handed a
        new array by a kernel it calls would never free it.
    inlined : bool, optional
        The kernel borrows, and becomes part of the kernels that call it. For short ones with many
        arguments: numba hands over an array as ten numbers, on the stack.

    Returns
    -------
    callable
        The kernel.

    """
    if function is None:
        return partial(kernel, borrows=borrows, inlined=inlined)
    return function if numba is None else _compile(function, borrows or inlined, inlined)


if numba is not None:
    _CACHE_DIRECTORY = str(_cache_directory())
