# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where kernels run in Python, they look at the clock often enough to end in time."""

from plain_python import run_python

# Ten points, all pairs measured: at first one call contracted the box without a look.
CODE = """
import numpy as np
from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.interval.kernels import COMPILED
assert not COMPILED
positions = np.random.default_rng(3).uniform(0.0, 10.0, (10, 2))
squared = ((positions[:, None] - positions) ** 2).sum(axis=2)
problem = Problem(0.98 * squared, 1.02 * squared, 2)
class Cancel:
    def __init__(self, at):
        self.at, self.looks = at, 0
    def is_set(self):
        self.looks += 1
        return self.looks > self.at
whole = Cancel(10**9)
found = solve(problem, cancel=whole)
assert found.verdict is Verdict.COVERED and found.statistics.processed == 1
assert whole.looks > 45, whole.looks
# The last few looks come after the search.
for at in range(1, whole.looks - 5, whole.looks // 5):
    part = Cancel(at)
    left = solve(problem, cancel=part)
    assert left.verdict is Verdict.OUT_OF_BUDGET and left.statistics.processed == 0, at
    assert part.looks <= at + 3, (at, part.looks)
    (hypothesis,) = left.hypotheses
    outside = ~((hypothesis.lower <= squared) & (squared <= hypothesis.upper))
    assert not outside[~np.eye(10, dtype=bool)].any()
again = solve(problem)
assert np.array_equal(again.hypotheses[0].boxes, found.hypotheses[0].boxes)
"""


def test_looks_within_one_box():
    done = run_python(CODE, NUMBA_DISABLE_JIT='1')
    assert done.returncode == 0, done.stderr
