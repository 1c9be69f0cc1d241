# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The loop of the search, with steps of a few lines: no part of a box is ever forgotten."""

from types import SimpleNamespace

import numpy as np
import pytest
from solver_cases import box_of

from dg_localization import SolverOptions
from dg_localization.solver.box import LOWER, UPPER, Status, cut_at
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.search.branch_and_prune import pave
from dg_localization.solver.search.budget import Budget

PAIR = 0, 1
PROBES = np.linspace(0.0, 16.0, 161)


def whole():
    lower, upper = np.zeros((2, 2)), np.zeros((2, 2))
    upper[PAIR] = upper[PAIR[::-1]] = 16.0
    return box_of(lower, upper)


def halved(pruned):
    low, high = pruned.box[: UPPER + 1, *PAIR]
    middle = 0.5 * (low + high)
    return cut_at(pruned.box, PAIR, middle, middle) if high - low > 1.0 else []


def held(boxes):
    return np.any([(b[LOWER, *PAIR] <= PROBES) & (PROBES <= b[UPPER, *PAIR]) for b in boxes], 0)


def search(status_of, budget=None):
    budget = budget or Budget(SolverOptions())
    return pave(
        [whole()], lambda box: Pruned(status_of(box), box, np.zeros((2, 2))), halved, budget
    )


def test_kept_boxes_cover_everything_that_is_not_empty():
    cover = search(lambda box: Status.EMPTY if box[LOWER, *PAIR] >= 8.0 else Status.CONTRACTED)
    assert held(cover.kept)[PROBES <= 8.0].all() and not cover.pending
    assert (cover.empty, cover.split, len(cover.kept)) == (1, 8, 8)
    assert cover.processed == 17


@pytest.mark.parametrize('most', [1, 2, 5, 30])
def test_what_a_limit_leaves_open_is_pending(most):
    cover = search(lambda box: Status.CONTRACTED, Budget(SolverOptions(max_boxes=most)))
    assert cover.processed == most
    assert held([*cover.kept, *cover.pending]).all()


def test_an_unfinished_box_is_pending_and_not_counted():
    budget = Budget(SolverOptions(max_boxes=5))
    asked = []

    def status_of(box):
        asked.append(box)
        return Status.UNFINISHED if len(asked) == 3 else Status.CONTRACTED

    budget.is_over = lambda: len(asked) == 3
    cover = search(status_of, budget)
    assert cover.processed == 2 and held(cover.pending).all()


def test_cancelling_leaves_everything_pending():
    cancelled = SimpleNamespace(is_set=lambda: True)
    cover = search(lambda box: Status.CONTRACTED, Budget(SolverOptions(), cancelled))
    assert cover.processed == 0 and held(cover.pending).all()
