# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The promise of the solver: no placement that agrees with the measurements is ever lost.

DG_PROPERTY_PROBLEMS sets how many random fleets are tried and DG_PROPERTY_SEED the first one;
``DG_PROPERTY_PROBLEMS=1000000 pytest -n 2 test/solver/test_never_loses.py`` is the long run.
"""

import os

from joined_cases import holds
import pytest
from solver_cases import random_case

PROBLEMS = int(os.environ.get('DG_PROPERTY_PROBLEMS', '10000'))
FIRST_SEED = int(os.environ.get('DG_PROPERTY_SEED', '0'))
CHUNK = 500

END = FIRST_SEED + PROBLEMS
CHUNKS = [range(seed, min(seed + CHUNK, END)) for seed in range(FIRST_SEED, END, CHUNK)]


def check(seed):
    """Solve the problem of a seed; tell whether its truth is in the answer."""
    try:
        case = random_case(seed)
        result = case.solve()
    except Exception as error:
        error.add_note(f'This was seed {seed}.')
        raise
    done = result.statistics
    assert done.processed == done.empty + done.split + done.kept, f'seed {seed}: {done}'
    return holds(result, case.positions, case.squared)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seeds', CHUNKS, ids=lambda seeds: f'{seeds[0]}-{seeds[-1]}')
def test_no_truth_is_lost(seeds):
    lost = [seed for seed in seeds if not check(seed)]
    assert not lost, f'the truth is in no hypothesis of the problems with seeds {lost}'
