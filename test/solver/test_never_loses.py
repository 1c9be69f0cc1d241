# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The promise of the solver: no placement that agrees with the measurements is ever lost.

What the answers claim is looked up in every tenth of them.

DG_PROPERTY_PROBLEMS sets how many random fleets are tried and DG_PROPERTY_SEED the first one;
``DG_PROPERTY_PROBLEMS=1000000 pytest -n 2 test/solver/test_never_loses.py`` is the long run.
"""

import os

from joined_cases import check_counts, chunks, first_and_last, missing
import pytest
from solver_cases import random_case
from test_result import check_claims

from dg_localization.interval.kernels import COMPILED

CLAIMS_EVERY = 10
PROBLEMS = int(os.environ.get('DG_PROPERTY_PROBLEMS', '6000'))


def check(seed):
    """Solve the problem of a seed; tell whether its truth is in the answer."""
    try:
        case = random_case(seed)
        result = case.solve()
        check_counts(result)
        if seed % CLAIMS_EVERY == 0:
            check_claims(case.problem, result)
    except Exception as error:
        error.add_note(f'This was seed {seed}.')
        raise
    return not missing(result, case.positions)


# In plain Python kernels warn of what compiled ones do not.
@pytest.mark.filterwarnings('error' if COMPILED else 'default')
@pytest.mark.parametrize('seeds', chunks(PROBLEMS, 500), ids=first_and_last)
def test_no_truth_is_lost(seeds):
    lost = [seed for seed in seeds if not check(seed)]
    assert not lost, f'the truth is in no hypothesis of the problems with seeds {lost}'
