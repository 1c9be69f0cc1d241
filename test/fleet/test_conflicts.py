# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Minimal conflicts and corrections, on sets whose answer is known."""

from itertools import combinations
import threading

from hypothesis import given, settings, strategies as st
import pytest

from dg_localization.fleet import LinkKey, LinkKind
from dg_localization.fleet.conflicts import explain

LINKS = tuple(LinkKey(LinkKind.RANGE, f'r{i}', 's') for i in range(8))

conflict_sets = st.lists(
    st.frozensets(st.sampled_from(LINKS), min_size=1, max_size=4), min_size=1, max_size=4
)


def contradiction_of(conflicts):
    def is_contradiction(links, thorough):
        return any(conflict <= links for conflict in conflicts)

    return is_contradiction


def subsets(links, most):
    return [frozenset(s) for size in range(most + 1) for s in combinations(links, size)]


@settings(deadline=None)
@given(conflicts=conflict_sets, max_outliers=st.integers(0, 3))
def test_all_minimal_corrections_and_only_minimal_conflicts(conflicts, max_outliers):
    explanation = explain(LINKS, contradiction_of(conflicts), max_outliers, 10_000, 60.0)
    assert explanation.complete
    minimal = {frozenset(c) for c in conflicts if not any(o < c for o in conflicts)}
    found = {frozenset(c) for c in explanation.conflicts}
    assert found
    assert found <= minimal
    hitting = [
        s for s in subsets(LINKS, max_outliers) if all(s & conflict for conflict in conflicts)
    ]
    expected = {s for s in hitting if not any(other < s for other in hitting)}
    if max_outliers:
        assert set(explanation.corrections) == expected
    else:
        assert explanation.corrections == ()


@settings(deadline=None)
@given(conflicts=conflict_sets)
def test_disjoint_conflicts_are_all_named_without_any_drop(conflicts):
    explanation = explain(LINKS, contradiction_of(conflicts), 0, 10_000, 60.0)
    named = frozenset().union(*explanation.conflicts)
    assert not contradiction_of(conflicts)(frozenset(LINKS) - named, True)


@pytest.mark.parametrize(('solves', 'seconds'), [(3, 60.0), (10_000, 0.0)])
def test_a_used_up_budget_is_reported(solves, seconds):
    explanation = explain(LINKS, contradiction_of([frozenset(LINKS[:4])]), 2, solves, seconds)
    assert not explanation.complete


def test_a_correction_is_only_taken_after_every_effort():
    # With little effort the pair looks harmless.
    def is_contradiction(links, thorough):
        return {LINKS[0], LINKS[1]} <= links and (thorough or len(links) > 2)

    explanation = explain(LINKS, is_contradiction, 1, 10_000, 60.0)
    assert set(explanation.corrections) == {frozenset({LINKS[0]}), frozenset({LINKS[1]})}


def test_a_cancelled_search_claims_nothing():
    cancel = threading.Event()

    def is_contradiction(links, thorough):
        cancel.set()
        return True

    explanation = explain(LINKS, is_contradiction, 1, 10_000, 60.0, cancel)
    assert not explanation.complete
    assert explanation.conflicts == ()
    assert explanation.corrections == ()
