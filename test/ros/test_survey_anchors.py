# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `survey_anchors`: nodes at rest, here and in a gymnasium."""

from itertools import combinations
import json
import math

import numpy as np
import pytest
import yaml

from dg_localization.ros.executables import survey_anchors

PLACES = {'n1': (0.0, 0.0), 'n2': (4.0, 0.0), 'n3': (4.0, 3.0), 'n4': (0.0, 3.0)}


@pytest.fixture
def survey(tmp_path, capsys):
    """Survey by some ranges; return the exit code, the anchors, and what was said."""

    def run(ranges, *arguments):
        table = tmp_path / 'ranges.csv'
        rows = [f'{a};{b};{range_m}' for a, b, range_m in ranges]
        table.write_text('\n'.join(['from;to;range', *rows]))
        code = survey_anchors([str(table), *map(str, arguments)])
        printed = capsys.readouterr()
        found = yaml.safe_load(printed.out) if printed.out else None
        anchors = found['/**']['ros__parameters']['anchors'] if found else None
        return code, anchors, printed.out + printed.err

    return run


ALL_PAIRS = tuple(combinations(PLACES, 2))


def true_ranges(pairs=ALL_PAIRS):
    return [(a, b, math.dist(PLACES[a], PLACES[b]) + 0.02) for a, b in pairs]


def anchored(*names):
    return [part for name in names for part in ('--anchor', name, *PLACES[name])]


def check(anchors, places):
    for name, place in places.items():
        off_m = math.dist(anchors[name]['position'], place)
        assert off_m <= anchors[name]['bound'], name


def test_every_node_is_within_its_bound(survey):
    known = anchored('n1', 'n2', 'n3')
    code, anchors, _ = survey(true_ranges(), '--error', '-0.03', '0.03', *known)
    assert code == 0 and set(anchors['names']) == set(PLACES)
    check(anchors, PLACES)
    assert anchors['n1']['bound'] == 0.0 and anchors['n4']['bound'] < 0.2


def test_without_known_nodes_the_first_two_make_the_axes_and_the_mirror_is_told(survey):
    code, anchors, told = survey(true_ranges(), '--error', '-0.03', '0.03')
    assert code == 0 and anchors['n1']['position'] == [0.0, 0.0]
    assert anchors['n2']['position'][1] == 0.0
    assert 'The mirror image agrees as well' in told


def test_what_is_missing_is_told(survey):
    chain = (('n1', 'n2'), ('n2', 'n3'), ('n3', 'n1'), ('n3', 'n4'))
    known = anchored('n1', 'n2', 'n3')
    code, _, told = survey(true_ranges(chain), '--error', '-0.03', '0.03', *known)
    assert code == 1 and 'what is missing' in told and 'n4' in told
    wrong = [*true_ranges(), ('n2', 'n4', 9.0)]
    code, anchors, told = survey(wrong, '--error', '-0.03', '0.03', *known)
    assert code == 1 and anchors is None and 'these contradict each other' in told
    _, anchors, told = survey(wrong, '--error', '-0.03', '0.03', *known, '--outliers', '1')
    assert 'Left out: ' in told and set(anchors['names']) == set(PLACES)


@pytest.mark.parametrize(
    ('ranges', 'arguments', 'wanted'),
    [
        ([('n1', 'n2', 'far')], ['--error', '0', '1'], 'line 2: could not convert'),
        ([('n1', 'n2', 1.0)], ['--error', '1', '0'], 'min_error'),
        ([('n1', 'n2', 1.0)], ['--error', '0', '1', '--anchor', 'n1', 'x'], '--anchor: could'),
    ],
)
def test_wrong_usage_is_a_sentence(survey, ranges, arguments, wanted):
    code, anchors, told = survey(ranges, *arguments)
    assert (code, anchors) == (2, None) and wanted in told and 'Traceback' not in told


def test_the_nodes_of_a_gymnasium_are_within_their_bounds(survey, shared):
    path = shared / 'data/dwm1001/campus_sport_rich_samples_medians.json'
    network = json.loads(path.read_text())
    places = dict(zip(network['names'], network['places_m'], strict=True))
    known = [part for name in network['names'][:3] for part in ('--anchor', name, *places[name])]
    code, anchors, _ = survey(network['readings'], '--error', '-0.45', '-0.1', *known)
    assert code == 0
    check(anchors, places)
    assert np.median([anchors[name]['bound'] for name in network['names'][3:]]) < 0.6
