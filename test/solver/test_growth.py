# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid pieces in space, placed point by point: what is found, and that nothing is lost."""

from joined_cases import FIRST_SEED, PROBLEMS, grown_case, missing
import pytest
from test_pieces_never_lose import first_and_last

from dg_localization import Verdict, solve
from dg_localization.solver.assemble import growing as solver

CHUNK = 100
GROWN_PROBLEMS = max(1, PROBLEMS // 10)
END = FIRST_SEED + GROWN_PROBLEMS
CHUNKS = [range(seed, min(seed + CHUNK, END)) for seed in range(FIRST_SEED, END, CHUNK)]


@pytest.fixture
def grows_everything(monkeypatch):
    """Place point by point whatever is in space, however small or well held it is."""
    monkeypatch.setattr(solver, 'LEAST_GROWN', 5)
    monkeypatch.setattr(solver, 'ONE_BOX_SHARE', 0.0)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('seeds', CHUNKS, ids=first_and_last)
@pytest.mark.usefixtures('grows_everything')
def test_no_truth_is_lost(seeds):
    for seed in seeds:
        case = grown_case(seed)
        result = solve(case.problem, case.options)
        assert result.verdict is not Verdict.INFEASIBLE, seed
        assert not missing(result, case.positions, case.squared), seed
        done = result.statistics
        boxes = sum(len(h.boxes) for piece in result.pieces for h in piece.hypotheses)
        assert done.processed == done.empty + done.split + done.kept, seed
        assert done.kept + done.pending == boxes, seed
