# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The floating-point environment that bounds rely on: round to nearest, gradual underflow.

Both are settings of a thread, and every library in the process may change them: importing Codac
makes the thread round upward, and libraries built with ``-ffast-math`` flush subnormal numbers to
zero. The outward steps of `rounding` are not sound then. A thread inherits the settings of its
parent: the pool of a search is made inside the guard.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
import sys

# Variables, so that the sums below are not folded at compile time.
_one = 1.0
_half_unit = 2.0**-53
_quarter_unit = 2.0**-54
_least_normal = 2.0**-1022

_DEFAULT = ctypes.c_void_p(-1)
"""FE_DFL_ENV, as the C libraries of Linux define it."""

_ENVIRONMENT_BYTES = 256
"""More than the size of a fenv_t on any platform."""

_REFUSAL = (
    'this thread does not round to nearest, or flushes underflow to zero, and could not be told '
    'otherwise: no bound would be a proof'
)
_CHANGED = (
    'how the processor rounds was changed during the call, perhaps by a callback or an import: '
    'its bounds are no proofs'
)


def is_default() -> bool:
    """Return whether this thread rounds to nearest and keeps numbers that underflow."""
    return (
        _one + _half_unit == _one
        and -_one - _half_unit == -_one
        and _one - _quarter_unit == _one
        and 0.5 * _least_normal > 0.0
        and 2.0 * (0.5 * _least_normal) == _least_normal
    )


@contextmanager
def default_environment() -> Iterator[None]:
    """
    Use the default environment in a block or function, and restore the environment afterwards.

    Raises
    ------
    RuntimeError
        If the environment is different and cannot be changed, or is changed during the call, for
        example by a callback.

    """
    found = None
    if not is_default():
        if sys.platform != 'linux':
            raise RuntimeError(_REFUSAL)
        library = ctypes.CDLL(None)
        found = ctypes.create_string_buffer(_ENVIRONMENT_BYTES)
        library.fegetenv(found)
        library.fesetenv(_DEFAULT)
    try:
        if not is_default():
            raise RuntimeError(_REFUSAL)
        yield
        if not is_default():
            raise RuntimeError(_CHANGED)
    finally:
        if found is not None:
            library.fesetenv(found)
