"""Bounds do not depend on what other libraries made of the floating-point unit."""

import ctypes
import platform
import sys

import numpy as np
import pytest
from solver_cases import random_case

from dg_localization import solve
from dg_localization.solver.float_environment import default_environment, is_default

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


def test_the_default_is_recognized():
    assert is_default()


def test_another_mode_is_recognized_left_and_restored(other_mode):
    library, mode = other_mode
    assert not is_default()
    with default_environment():
        assert is_default()
    assert library.fegetround() == mode


def test_the_answer_is_the_same_to_the_bit(other_mode):
    library, mode = other_mode
    case = random_case(12)
    found = solve(case.problem, case.options)
    assert library.fegetround() == mode
    library.fesetround(0)
    expected = solve(case.problem, case.options)
    assert len(found.hypotheses) == len(expected.hypotheses) > 0
    for one, other in zip(found.hypotheses, expected.hypotheses, strict=True):
        assert np.array_equal(one.boxes, other.boxes)
        assert np.array_equal(one.positions, other.positions)


def test_the_mode_is_restored_after_an_error(other_mode):
    library, mode = other_mode
    with pytest.raises(KeyError), default_environment():
        raise KeyError
    assert library.fegetround() == mode
