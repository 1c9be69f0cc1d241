# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Placements of large pieces, and reviews of patches that are given up."""

from benchmarks.large import fleet
from dg_localization import SolverOptions, Verdict, solve


def test_a_thousand_points_have_a_proved_placement():
    problem, positions = fleet(1000, 10, 0.03, 0)
    result = solve(problem, SolverOptions(max_boxes=10**9, max_seconds=60.0))
    assert result.verdict is Verdict.COVERED
    largest = max(result.pieces, key=lambda piece: len(piece.points))
    (hypothesis,) = largest.hypotheses
    assert hypothesis.proved
    # Other coordinates than the truth, in all of its bounds.
    members = list(largest.points)
    known = problem.pairs.restricted(members)
    first, second = known.pairs.T
    squared = ((hypothesis.positions[first] - hypothesis.positions[second]) ** 2).sum(axis=1)
    assert ((known.lower <= squared) & (squared <= known.upper)).all()
