# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Numba's cache of compiled functions, made to keep kernels in the folder of `kernel_cache`.

The import fails where numba lacks one of the private parts used: ``_CacheLocator``,
``CompileResultCacheImpl`` and ``FunctionCache`` of `numba.core.caching`, with the members that are
overridden here. `make_keeper` sets one more, ``_cache`` of a dispatcher.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
import hashlib
from pathlib import Path
from typing import Any

from numba.core import caching
from numba.core.dispatcher import Dispatcher

from dg_localization.interval.kernel_cache import (
    PACKAGE,
    Keeper,
    alone,
    fcntl,
    make_private,
    read_code,
)

for _owner, _names in (
    (
        caching._CacheLocator,
        ('ensure_cache_path', 'get_cache_path', 'get_source_stamp', 'get_disambiguator'),
    ),
    (caching._CacheLocator, ('from_function',)),
    (caching.CompileResultCacheImpl, ('_locator_classes',)),
    (caching.FunctionCache, ('_impl_class', 'load_overload', 'save_overload', 'flush')),
    (Dispatcher, ('enable_caching', 'stats')),
):
    for _name in _names:
        # An AttributeError here leaves the kernels to the cache that numba has itself.
        getattr(_owner, _name)


@cache
def _stamp(source: str) -> bytes:
    """Return what dates a kernel beyond the folder, which stands for this package only."""
    path = Path(source).resolve()
    return b'' if path.is_relative_to(PACKAGE.resolve()) else read_code(path)[0]


class _Locator(caching._CacheLocator):
    """Says where a function is kept, and what it was compiled from."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def from_function(self, function: Callable[..., Any], source: str) -> _Locator | None:
        """Take on a function; numba asks the class otherwise, which knows no folder."""
        self._py_file = source
        self._module = function.__module__
        return self if Path(source).is_file() else None

    def ensure_cache_path(self) -> None:
        make_private(self._folder)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> bytes:
        return _stamp(self._py_file)

    def get_disambiguator(self) -> str:
        # Numba takes the line number, which a comment changes.
        return hashlib.sha256(self._module.encode()).hexdigest()[:8]


class _Implementation(caching.CompileResultCacheImpl):
    """Keeps functions where our locator says."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._locator_classes = [_Locator(folder)]
        super().__init__(function)


class KernelCache(caching.FunctionCache):
    """
    Numba's cache of one function, which stands damage, full disks and other processes.

    Parameters
    ----------
    function : callable
        The function that is compiled.
    folder : Path
        Where machine code is kept.
    not_kept : callable
        Called with the error where machine code cannot be written there.

    """

    def __init__(
        self, function: Callable[..., Any], folder: Path, not_kept: Callable[[OSError], None]
    ) -> None:
        self._not_kept = not_kept
        self._writing = folder / 'writing'
        self._impl_class = lambda function: _Implementation(function, folder)
        super().__init__(function)

    def load_overload(self, *args: Any) -> Any:
        """Return machine code that is kept, None where there is none or where it is damaged."""
        try:
            return super().load_overload(*args)
        except Exception:  # unpickling damaged data raises almost anything
            with suppress(OSError), alone(self._writing):
                self.flush()
            return None

    def save_overload(self, *args: Any) -> None:
        """Keep machine code; what cannot be kept costs the next process time, no more."""
        try:
            # Numba reads the index, adds to it and writes it: no other process must meanwhile.
            with alone(self._writing):
                self._save_or_flush(*args)
        except OSError as error:
            self._not_kept(error)

    def _save_or_flush(self, *args: Any) -> None:
        try:
            super().save_overload(*args)
        except OSError:
            raise
        except Exception:  # the index is damaged
            self.flush()
            # Under load numba was seen to have no machine code left to write.
            with suppress(RuntimeError):
                super().save_overload(*args)


def make_keeper(folder: Path, not_kept: Callable[[OSError], None]) -> Keeper:
    """
    Return what makes a dispatcher keep its machine code in a folder.

    Parameters
    ----------
    folder : Path
        Where machine code is kept.
    not_kept : callable
        Called with the error where machine code cannot be written there, as on a full disk.

    Raises
    ------
    ImportError
        If this system has no file locks.

    """
    if fcntl is None:
        raise ImportError('this system has no file locks')

    def keep(dispatcher: Any, function: Callable[..., Any]) -> None:
        dispatcher._cache = KernelCache(function, folder, not_kept)

    return keep
