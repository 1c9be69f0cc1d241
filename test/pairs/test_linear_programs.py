# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Multipliers of a few unknowns: those of the linear program."""

import numpy as np
import pytest

from dg_localization.pairs.linear_programs import find_multipliers, set_up_programs

linprog = pytest.importorskip('scipy.optimize').linprog


def random_rows(seed):
    """Return rows that some point within the unit box meets."""
    rng = np.random.default_rng(seed)
    rows, unknowns = rng.integers(1, 40), rng.integers(1, 10)
    slopes = rng.normal(size=(rows, unknowns)) * (rng.random((rows, unknowns)) < 0.7)
    middle = slopes @ rng.uniform(-1.0, 1.0, unknowns)
    half = rng.uniform(0.0, 1.0, (2, rows)) * rng.choice([0.1, 1.0, 10.0])
    return slopes, np.stack([middle - half[0], middle + half[1]], axis=1)


def bound_by(programs, slopes, bounds, unknown, sign):
    """Return the bound that the multipliers prove, in plain arithmetic."""
    rest = np.zeros(slopes.shape[1])
    rest[unknown] = sign
    total = 0.0
    for row, factor in zip(programs.active, programs.multipliers, strict=True):
        if row < len(slopes):
            rest -= factor * slopes[row]
            total += factor * bounds[row, 1 if factor > 0.0 else 0]
    return total + np.abs(rest).sum()


@pytest.mark.parametrize('seed', range(60))
def test_bounds_are_those_of_the_linear_program(seed):
    slopes, bounds = random_rows(seed)
    unknowns = slopes.shape[1]
    programs = set_up_programs(slopes, bounds, np.arange(unknowns))
    for unknown in range(unknowns):
        for sign in (1.0, -1.0):
            find_multipliers(programs, unknown, sign)
            found = bound_by(programs, slopes, bounds, unknown, sign)
            costs = np.zeros(unknowns)
            costs[unknown] = -sign
            best = -linprog(
                costs,
                np.concatenate([slopes, -slopes]),
                np.concatenate([bounds[:, 1], -bounds[:, 0]]),
                bounds=(-1.0, 1.0),
            ).fun
            assert best - 1e-6 <= found <= best + 1e-3


def test_programs_of_chosen_unknowns_leave_the_others_out():
    slopes, bounds = np.array([[1.0, 5.0, 1.0]]), np.array([[-0.5, 0.5]])
    programs = set_up_programs(slopes, bounds, np.array([0, 2]))
    find_multipliers(programs, 0, 1.0)
    assert programs.slopes.tolist() == [[1.0], [1.0]]
    assert bound_by(programs, slopes[:, [0, 2]], bounds, 0, 1.0) == pytest.approx(1.0)
