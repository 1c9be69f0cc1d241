# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds do not depend on what other libraries made of the floating-point unit."""

import ctypes
import platform
import struct
import sys

import pytest
from solver_cases import assert_same, braced_grid

from dg_localization import SolverOptions, solve
from dg_localization.interval.environment import default_environment, is_default

# FE_DOWNWARD, FE_UPWARD, FE_TOWARDZERO.
MODES = {'x86_64': (0x400, 0x800, 0xC00), 'aarch64': (0x800000, 0x400000, 0xC00000)}

pytestmark = pytest.mark.skipif(
    sys.platform != 'linux' or platform.machine() not in MODES,
    reason='the numbers of the rounding modes are not known here',
)


@pytest.fixture(params=range(3), ids=['down', 'up', 'to zero'])
def other_mode(request):
    library = ctypes.CDLL(None)
    mode = MODES[platform.machine()][request.param]
    before = library.fegetround()
    assert library.fesetround(mode) == 0
    yield library, mode
    library.fesetround(before)


def test_another_mode_is_recognized_left_and_restored(other_mode):
    library, mode = other_mode
    assert not is_default()
    with default_environment():
        assert is_default()
    assert library.fegetround() == mode
    with pytest.raises(KeyError), default_environment():
        raise KeyError
    assert library.fegetround() == mode


@pytest.mark.parametrize('size', [(2, 4), (8, 9)], ids=['one piece', 'patches'])
def test_the_answer_is_the_same_to_the_bit(size, other_mode):
    library, mode = other_mode
    problem, options = braced_grid(*size, 0.01)[0], SolverOptions(max_boxes=20)
    found = solve(problem, options)
    assert library.fegetround() == mode
    library.fesetround(0)
    expected = solve(problem, options)
    assert found.hypotheses
    assert_same(found, expected)


def test_a_callback_that_changes_the_mode_is_noticed(other_mode):
    library, mode = other_mode
    library.fesetround(0)
    with pytest.raises(RuntimeError, match='changed during the call'):
        solve(braced_grid(2, 4, 0.01)[0], progress=lambda _: library.fesetround(mode))


@pytest.mark.skipif(platform.machine() != 'x86_64', reason='the place of MXCSR is not known here')
def test_flushing_of_underflow_is_recognized_left_and_restored():
    library, saved = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    library.fegetenv(saved)
    flushing = ctypes.create_string_buffer(saved.raw, 256)
    (settings,) = struct.unpack_from('I', saved, 28)
    struct.pack_into('I', flushing, 28, settings | 0x8040)
    library.fesetenv(flushing)
    try:
        assert not is_default()
        with default_environment():
            assert is_default()
        assert not is_default()
    finally:
        library.fesetenv(saved)
