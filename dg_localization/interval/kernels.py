# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The decorator of all numerical kernels: compiled by numba if it is installed.

A kernel is a plain scalar loop over arrays. With numba it becomes machine code that releases the
interpreter lock; without it (or with ``NUMBA_DISABLE_JIT=1``) the same function runs in Python.
Both give the same bounds to the last bit: by default numba neither reorders nor fuses operations.

Two undocumented options of numba are used: ``_nrt``, without which kernels are slower (see
`kernel`), and ``no_cfunc_wrapper``, without which compilation takes an eighth longer: no kernel is
called through a C pointer. Versions of numba without these options compile without them. Arguments
between kernels are typed without their values, which saves a tenth of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
import threading
from typing import Any, TypeVar, overload
import warnings

from dg_localization.interval.kernel_cache import CacheRefusedError, KernelCache, open_folder
from dg_localization.optional import install_hint

_import_error: Exception | None = None
try:
    import numba
except Exception as error:  # a numba too old for NumPy or Python raises more than ImportError
    numba = None
    _import_error = error

Function = TypeVar('Function', bound=Callable[..., Any])

COMPILED = numba is not None and not numba.config.DISABLE_JIT
"""Whether kernels are machine code in this process."""

WORK_PER_LOOK = 300_000 if COMPILED else 2_000
"""Approximate number of triples of points that a kernel may reduce, or of array entries that it
may visit, between two checks of the clock."""

WORK_OF_A_STEP = WORK_PER_LOOK // 30
"""The work that takes as long as a step with a few calls of NumPy."""


COMPILED_ANEW = 'Every process compiles the solver anew, for about two minutes'


class _Stopped(Exception):  # noqa: N818 (no error: it ends a block)
    """Ends a block of `until`."""


class _Watch(threading.local):
    """The stop function of the kernels of a thread, and the work since its last call."""

    stopped: Callable[[], bool] | None = None
    work = 0


_watch = _Watch()


@contextmanager
def until(stopped: Callable[[], bool]) -> Iterator[None]:
    """
    Leave a block early, even inside a kernel, when `stopped` returns true.

    Compiled kernels are never left; they return soon enough (`WORK_PER_LOOK`), and loops over them
    check the clock in between (`look_after`). Without numba one call may take seconds, and kernels
    marked `watched` check before they begin. Arrays may then be partly written and must not be
    used any more, and `stopped` must keep returning true.

    Parameters
    ----------
    stopped : callable
        Called without arguments.

    """
    previous = _watch.stopped, _watch.work
    _watch.stopped, _watch.work = stopped, 0
    try:
        yield
    except _Stopped:
        pass
    finally:
        _watch.stopped, _watch.work = previous


def look_after(work: int) -> None:
    """
    Leave a block of `until` if its time is over; check the clock once every `WORK_PER_LOOK`.

    Parameters
    ----------
    work : int
        Approximate number of array entries visited since the last call.

    """
    _watch.work += work
    if _watch.work < WORK_PER_LOOK:
        return
    _watch.work = 0
    if _watch.stopped is not None and _watch.stopped():
        raise _Stopped


def _watched(function: Function) -> Function:
    """Return `function` in Python as a kernel that a block of `until` can leave."""

    @wraps(function)
    def ask_first(*args: Any) -> Any:
        if _watch.stopped is not None and _watch.stopped():
            raise _Stopped
        return function(*args)

    return ask_first  # type: ignore[return-value]


@dataclass(frozen=True)
class CompileProgress:
    """
    The number of kernels compiled by this process so far, without kernels loaded from the cache.

    Attributes
    ----------
    compiled : int
        Kernels compiled, or being compiled.
    total : int
        Kernels in the modules imported so far.

    """

    compiled: int
    total: int


def compile_progress() -> CompileProgress:
    """Return the progress of compilation; any thread may call this while another one compiles."""
    compiled = sum(bool(dispatcher.stats.cache_misses) for dispatcher in _dispatchers)
    return CompileProgress(compiled, len(_dispatchers))


@contextmanager
def compiled_soon() -> Iterator[None]:
    """Compile with less optimization: 0.82 of the time, and kernels are as fast in the gates."""
    previous = numba.config.OPT
    numba.config.OPT = type(previous)(min(previous, 1))
    try:
        yield
    finally:
        numba.config.OPT = previous


def why_slow() -> str:
    """Return why kernels run in Python and what to do about it; empty if they are compiled."""
    if COMPILED:
        return ''
    slow = 'the solver runs in Python, more than 100 times slower than compiled'
    if numba is not None:
        return f'{slow}: NUMBA_DISABLE_JIT is set'
    if isinstance(_import_error, ModuleNotFoundError) and _import_error.name == 'numba':
        return f'{slow}: numba is not installed; {install_hint("numba")}'
    return f'{slow}: numba cannot be imported ({_import_error})'


def why_not_kept() -> str:
    """Return why compiled kernels are not kept for the next process; empty if they are."""
    return _cache_refusal


def cache_folder() -> Path | None:
    """Return the folder of compiled kernels; None if they are not kept."""
    return _folder


def _compile(function: Function, borrows: bool, inlined: bool) -> Function:
    """Return `function` as a lazily compiled numba kernel, kept on disk where possible."""
    # Every kernel sets these options, since it would inherit unset ones from its caller.
    options = {'nogil': True, 'error_model': 'numpy', 'forceinline': inlined}
    undocumented = {'_nrt': not borrows, 'no_cfunc_wrapper': True}
    options |= {name: value for name, value in undocumented.items() if _has_option(name)}
    dispatcher = numba.njit(**options)(function)
    of_types = dispatcher.get_call_template
    # Otherwise each constant argument would be a separate type with separate machine code.
    dispatcher.get_call_template = lambda arguments, named: of_types(
        tuple(map(numba.types.unliteral, arguments)), named
    )
    # Without a source file or a folder the kernel is compiled in every process.
    if _folder is not None:
        with suppress(AttributeError, OSError, RuntimeError):
            dispatcher._cache = KernelCache(function, _folder, _not_kept)
    _dispatchers.append(dispatcher)
    compiled: Function = dispatcher
    return compiled


def _not_kept(error: OSError) -> None:
    """Remember why machine code could not be written."""
    global _cache_refusal
    _cache_refusal = (
        f'compiled kernels cannot all be kept in {_folder}: {error}. {COMPILED_ANEW}; make room '
        'there, or set NUMBA_CACHE_DIR to another folder'
    )


def _has_option(name: str) -> bool:
    """Return whether numba has an option of compilation."""
    try:
        from numba.core.cpu import CPUTargetOptions
    except ImportError:
        return False
    return hasattr(CPUTargetOptions, name)


@overload
def kernel(function: Function) -> Function: ...


@overload
def kernel(
    *, borrows: bool = False, inlined: bool = False, watched: bool = False
) -> Callable[[Function], Function]: ...


def kernel(
    function: Function | None = None,
    *,
    borrows: bool = False,
    inlined: bool = False,
    watched: bool = False,
) -> Function | Callable[[Function], Function]:
    """
    Compile a function as a kernel; without numba, return the function itself.

    Parameters
    ----------
    function : callable
        The function, if the decorator is used without parentheses.
    borrows : bool, optional
        The kernel only borrows arrays: it neither makes nor returns any. Numba counts a reference
        to every array argument, even within a tuple, by two atomic operations, which take a third
        of the time of a contraction. Borrowed arrays need no count. Views are fine. A kernel that
        calls `np.empty` or the like does not compile; one that gets a new array from a kernel it
        calls would never free it.
    inlined : bool, optional
        The kernel borrows, and is inlined into its callers. For short kernels with many arguments:
        numba passes an array as ten numbers on the stack.
    watched : bool, optional
        The kernel takes milliseconds in Python and is called in a loop: in Python, `until` can end
        it. Compiled, it is an ordinary kernel.

    Returns
    -------
    callable
        The kernel.

    """
    if function is None:
        return partial(kernel, borrows=borrows, inlined=inlined, watched=watched)
    if COMPILED:
        return _compile(function, borrows or inlined, inlined)
    return _watched(function) if watched else function


_dispatchers: list[Any] = []
_folder: Path | None = None
_cache_refusal = ''
if COMPILED:
    try:
        _folder = open_folder()
    except CacheRefusedError as error:
        _cache_refusal = f'{error}. {COMPILED_ANEW}'
        warnings.warn(_cache_refusal, RuntimeWarning, stacklevel=2)
