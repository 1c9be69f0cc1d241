# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The gates notice what is worse, and what is lost; mutations are of code that is there."""

import math
from pathlib import Path

import pytest

pytest.importorskip('scipy', reason='the benchmarks need scipy')

from benchmarks.gates import NONE, Limit, report  # noqa: E402
from benchmarks.mutations.table import MUTATIONS  # noqa: E402

REPOSITORY = Path(__file__).parents[1]

LIMITS = {'lost': NONE, 'ms': Limit(times=1.5, more=0.2), 'width': Limit(most=2.25)}
BEFORE = {'a': {'lost': 0.0, 'ms': 10.0, 'width': 1.9}}


@pytest.mark.parametrize(
    ('figures', 'holds'),
    [
        ({'lost': 0.0, 'ms': 15.0, 'width': 2.2}, True),
        ({'lost': 0.0, 'ms': 15.3, 'width': 2.2}, False),
        ({'lost': 1.0, 'ms': 10.0, 'width': 2.2}, False),
        ({'lost': 0.0, 'ms': 10.0, 'width': 2.3}, False),
        ({'lost': 0.0, 'ms': 10.0, 'width': math.nan}, False),
    ],
)
def test_a_gate_holds_or_is_broken(figures, holds, capsys):
    assert report('gate', {'a': figures}, LIMITS, BEFORE) == holds
    assert ('BROKEN' in capsys.readouterr().out) != holds


def test_rows_without_an_earlier_state_have_absolute_limits_only():
    assert report('gate', {'b': {'lost': 0.0, 'ms': 99.0, 'width': 2.2}}, LIMITS, BEFORE)


def test_every_mutation_is_of_text_that_occurs_once():
    """Where code moves, the table of what tests notice moves with it."""
    for mutation in MUTATIONS:
        assert (REPOSITORY / mutation.path).read_text().count(mutation.old) == 1, mutation.name
        for test in mutation.tests:
            path, _, name = test.partition('::')
            defined = f'def {name.partition("[")[0]}(' if name else 'def test_'
            assert defined in (REPOSITORY / path).read_text(), test
