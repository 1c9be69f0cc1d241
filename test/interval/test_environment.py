# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds do not depend on what other libraries made of the floating-point unit."""

import ctypes
import platform
import struct
import sys

import numpy as np
import pytest
from solver_cases import bounds, random_case

from dg_localization import Problem, SolverOptions, solve
from dg_localization.interval import environment as float_environment
from dg_localization.interval.environment import default_environment, is_default
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.place.unplaced_hypotheses import unplaced_hypotheses_of
from dg_localization.solver.search.search import POINTS_PER_WORKER, search

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


def small_problem():
    case = random_case(12)
    return case.problem, case.options


def large_problem():
    """Return one that several threads work on: a ring of squares, each with its diagonals."""
    n_points = 2 * POINTS_PER_WORKER
    angles = 2.0 * np.pi * (np.arange(n_points) // 2) / (n_points // 2)
    radii = np.where(np.arange(n_points) % 2, 10.0, 12.0)
    x, y = radii * np.cos(angles), radii * np.sin(angles)
    ranges = {}
    for i in range(n_points):
        for j in range(i + 1, min(i + 4, n_points)):
            squared = (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2
            ranges[i, j] = (0.98 * squared, 1.02 * squared)
    return Problem(*bounds(n_points, ranges)), SolverOptions(max_boxes=20)


@pytest.fixture
def request_problem(request):
    return request.param()


def test_the_default_is_recognized():
    assert is_default()


def test_another_mode_is_recognized_left_and_restored(other_mode):
    library, mode = other_mode
    assert not is_default()
    with default_environment():
        assert is_default()
    assert library.fegetround() == mode


@pytest.mark.parametrize('request_problem', [small_problem, large_problem], indirect=True)
def test_the_answer_is_the_same_to_the_bit(request_problem, other_mode):
    library, mode = other_mode
    problem, options = request_problem
    found = solve(problem, options)
    assert library.fegetround() == mode
    library.fesetround(0)
    expected = solve(problem, options)
    assert len(found.hypotheses) == len(expected.hypotheses) > 0
    for one, other in zip(found.hypotheses, expected.hypotheses, strict=True):
        assert np.array_equal(one.boxes, other.boxes)
        assert np.array_equal(one.positions, other.positions)


def test_what_is_sought_later_is_the_same_to_the_bit(other_mode):
    """Placements of patches are proved when somebody asks for them, perhaps in another mode."""
    library, mode = other_mode
    library.fesetround(0)
    case = random_case(12)
    cover, _ = search(case.problem, case.options)
    expected = hypotheses_of(case.problem, cover.kept)
    found = unplaced_hypotheses_of(case.problem, cover.kept)
    library.fesetround(mode)
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one.positions, other.positions)
        assert (one.proved, one.flexible) == (other.proved, other.flexible)
    assert library.fegetround() == mode


def test_the_mode_is_restored_after_an_error(other_mode):
    library, mode = other_mode
    with pytest.raises(KeyError), default_environment():
        raise KeyError
    assert library.fegetround() == mode


def test_a_callback_that_changes_the_mode_is_noticed(other_mode):
    library, mode = other_mode
    library.fesetround(0)
    problem, options = small_problem()
    with pytest.raises(RuntimeError, match='changed during the call'):
        solve(problem, options, progress=lambda _: library.fesetround(mode))


def test_what_cannot_be_changed_is_refused(monkeypatch):
    monkeypatch.setattr(float_environment, 'is_default', lambda: False)
    with pytest.raises(RuntimeError, match='could not be told otherwise'), default_environment():
        pass


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
