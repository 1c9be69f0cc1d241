# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Minimal conflicts and corrections, on sets whose answer is known."""

from itertools import combinations

from hypothesis import given, settings, strategies as st
import pytest

from dg_localization.fleet import LinkKind
from dg_localization.fleet.contradictions.conflicts import Effort, Limits, explain
from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind

SEEN = tuple(Suspect(SuspectKind.OBSERVATION, f'r{i}', 's', (LinkKind.RANGE,)) for i in range(8))
EVERYTHING = frozenset(SEEN)
ALONE = {one: frozenset([one]) for one in SEEN}
AMPLE = (10_000, 60.0)

conflict_sets = st.lists(
    st.frozensets(st.sampled_from(SEEN), min_size=1, max_size=4), min_size=1, max_size=4
)
efforts = st.lists(st.sampled_from(Effort), min_size=4, max_size=4)
parts = st.lists(st.frozensets(st.sampled_from(SEEN), min_size=1), max_size=3)


def contradiction_of(conflicts, efforts=(Effort.BRIEF,) * 4):
    """Return an oracle that sees each conflict from some effort on."""

    def contradicts(observations, effort):
        return any(
            conflict <= observations and effort >= least
            for conflict, least in zip(conflicts, efforts, strict=False)
        )

    return contradicts


def explained(conflicts, max_outliers, *, efforts=(Effort.BRIEF,) * 4, regions=()):
    limits = Limits(max_outliers, *AMPLE)
    return explain(EVERYTHING, regions, (ALONE,), contradiction_of(conflicts, efforts), limits)


def hitting(conflicts, named, most):
    """Return all minimal sets of up to `most` suspects that are part of every conflict."""
    sets = [frozenset(s) for size in range(most + 1) for s in combinations(named, size)]
    covered = {s: frozenset().union(*(named[one] for one in s)) for s in sets}
    hit = [s for s in sets if all(covered[s] & conflict for conflict in conflicts)]
    return {s for s in hit if not any(other < s for other in hit)}


@settings(derandomize=False)
@given(conflicts=conflict_sets, max_outliers=st.integers(0, 3), regions=parts, efforts=efforts)
def test_all_minimal_corrections(conflicts, max_outliers, regions, efforts):
    explanation = explained(conflicts, max_outliers, efforts=efforts, regions=regions)
    assert not explanation.stopped and not explanation.among
    assert explanation.conflicts
    for found in explanation.conflicts:
        assert any(conflict <= found for conflict in conflicts)
    expected = hitting(conflicts, ALONE, max_outliers) if max_outliers else set()
    assert set(explanation.corrections) == expected


@pytest.mark.parametrize('most', [2, 3])
def test_more_tolerance_gives_at_least_what_less_does(most):
    conflicts = [frozenset(SEEN[:3]), frozenset(SEEN[3:6]), frozenset(SEEN[1:5])]
    less = explained(conflicts, most - 1)
    for solves in range(0, 400, 7):
        limited = Limits(most, solves, 60.0)
        more = explain(EVERYTHING, (), (ALONE,), contradiction_of(conflicts), limited)
        if more.searched >= most - 1:
            assert set(less.corrections) <= set(more.corrections)
