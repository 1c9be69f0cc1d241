# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The answers to the beginning of each recording, so that a change of numbers shows in review.

Where motion capture tells the truth, it is in every answer. No limit of time is used. Where the
new answers are meant, DG_WRITE_GOLDEN=1 writes them.
"""

import json
import os

import convert_lias
import convert_mrclam
import numpy as np
from processes import REPOSITORY
import pytest
from recorder import Recorder
from small_bags import read, write_parameters

from benchmarks import beside
from dg_localization.ros.executables import localize_bag

GOLDEN = REPOSITORY / 'test/golden/answers.json'
# Stamps of 0 count as not filled in.
START_S = 1_000_000.0
SHOWN, NEAR_M = 8, 0.01
TRUTHS = {
    'tiers': '/vrpn_client_node/{robot}_cap/pose',
    'mrclam': '/{robot}/truth',
    'lias': '/{robot}/truth',
}
# Least and greatest error of a range, in m and as a fraction.
TABLES = {
    'plaza1': (-1.0, 1.5, 0.03, 0.1),
    'labyrinth': (-0.5, 0.5, 0.0, 0.0),
    **dict.fromkeys(('rcv2', 'rcv5', 'rcv6'), (-0.4, 0.4, 0.0, 0.0)),
}


def record(recording, bag):
    """Write a recording of one robot among anchors as a bag, with its parameters."""
    recorder = Recorder()
    for second, anchor, range_m in recording.ranges:
        recorder.add_range('robot', anchor, range_m, START_S + second, START_S + second)
    for second, *place_m, yaw in recording.odometry:
        recorder.add_odometry('robot', place_m, yaw, START_S + second)
    recorder.write(bag)
    places = {name: place_m.tolist() for name, place_m in recording.anchors.items()}
    fields = ('min_error', 'max_error', 'min_error_relative', 'max_error_relative')
    fleet = {
        'robots': ['robot'],
        'dimension': recording.dimension,
        'anchors': {'names': list(places), **{n: {'position': p} for n, p in places.items()}},
        'range': dict(zip(fields, TABLES[recording.name], strict=True)),
        'max_outliers': 1,
        'max_speed': 2.0,
        'rate': 2.0,
    }
    return bag, write_parameters(bag.parent, **fleet), 25


def bag_of(name, shared, bag):
    """Return the bag of a recording, its parameters, and how many seconds of it are read."""
    if name == 'tiers':
        return shared / 'data/tiers_uwb/rosbag2_shortbag', REPOSITORY / 'config/tiers_uwb.yaml', 17
    if name == 'mrclam':
        assert convert_mrclam.convert(shared / 'data/mrclam/excerpt_D7_t800_822', bag) == 1
        return bag, bag.with_suffix('.yaml'), 10
    if name == 'lias':
        table = shared / 'data/lias_uwb/UWB_static_exp_8_14_pos1_deg_120.csv'
        assert convert_lias.convert(shared / 'data/lias_uwb/geometry.json', table, bag) == 3
        return bag, bag.with_suffix('.yaml'), 10
    return record(beside.read(shared / 'data', name), bag)


@pytest.mark.parametrize('name', ['tiers', 'mrclam', 'lias', *TABLES])
def test_the_answers_are_those_of_before(name, shared, tmp_path):
    bag, params, seconds = bag_of(name, shared, tmp_path / name)
    report = tmp_path / 'report.json'
    paths = ('-o', tmp_path / 'out', '--params', params, '--report', report)
    truth = ('--truth', TRUTHS[name]) if name in TRUTHS else ()
    assert localize_bag([str(a) for a in (bag, *paths, '--duration', seconds, *truth)]) == 0
    tree = json.loads(report.read_text())
    assert not truth or tree['truth']['held'] == tree['truth']['compared'] >= 9
    _, answers = read(tmp_path / 'out', '/localizer/feasible_poses')
    found = {
        'hypotheses': tree['ticks_by_hypotheses'],
        'widths_m': tree['median_enclosure_width_m'],
        'poses_m': [
            np.round(one.positions_m, 3).tolist() for one in answers[:: len(answers) // SHOWN]
        ],
    }
    golden = json.loads(GOLDEN.read_text()) if GOLDEN.exists() else {}
    if os.environ.get('DG_WRITE_GOLDEN') == '1':
        GOLDEN.write_text(json.dumps({**golden, name: found}, indent=1, sort_keys=True) + '\n')
        return
    before = golden[name]
    assert found['hypotheses'] == before['hypotheses']
    assert found['widths_m'] == pytest.approx(before['widths_m'], abs=NEAR_M)
    for new, old in zip(found['poses_m'], before['poses_m'], strict=True):
        np.testing.assert_allclose(new, old, rtol=0.0, atol=NEAR_M)
