# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executables `fit_bounds` and `survey_anchors`, by simulated and by real ranges."""

from itertools import combinations
import json
import math
from pathlib import Path
import re

import numpy as np
import pytest
from recorder import Recorder
from small_bags import SIMULATED_TRUTH, record_simulation, write_parameters
import yaml

from dg_localization.fleet import LinkKind
from dg_localization.ros.bags.offline import read_task
from dg_localization.ros.executables import fit_bounds, localize_bag, survey_anchors
from dg_localization.simulation.moving_fleet import LANDMARKS_M, ROBOTS

CONFIG = Path(__file__).parents[2] / 'config/tiers_uwb.yaml'
START_S = 1_700_000_000
FLEET = {
    'robots': list(ROBOTS),
    'max_speed': 0.25,
    'max_turn_rate': 0.5,
    'range': {'min_error_relative': -0.2, 'max_error_relative': 0.2},
    'bearing': {'half_width': 0.3},
}
POSITIONS = {name: {'position': list(place)} for name, place in LANDMARKS_M.items()}
BEACONS = {'names': list(LANDMARKS_M), **POSITIONS}


def parameters_in(text):
    return yaml.safe_load(text)['/**']['ros__parameters'] if text else {}


@pytest.fixture
def learn(tmp_path, capsys):
    """Run `fit_bounds`; return the exit code, what it printed, and the parameters in it."""
    params = write_parameters(tmp_path, **FLEET, anchors=BEACONS)

    def run(bag, *arguments, file=params):
        capsys.readouterr()
        code = fit_bounds([str(bag), '--params', str(file), *map(str, arguments)])
        run.output, run.errors = capsys.readouterr()
        run.told = ' '.join(run.output.replace('\n#', ' ').split())
        return code, parameters_in(run.output)

    run.params = params
    return run


@pytest.fixture
def told(tmp_path, learn):
    """Let the node read what was learned after what was stated; return what it tells the fleet."""

    def read():
        bounds = tmp_path / 'bounds.yaml'
        bounds.write_text(learn.output)
        arguments = ['--ros-args', '--params-file', str(bounds)]
        return read_task(learn.params, arguments).settings

    return read


def bounds_of(settings, observer, target, kind=LinkKind.RANGE):
    """Return the bounds of what one point measures of another."""
    of_all = settings.fleet.sensor_bounds
    for link in settings.links:
        ends = link.key.observer, link.key.target or target
        if link.key.kind in (kind, LinkKind.PEERS) and ends == (observer, target):
            return link.bounds_within(of_all)
    return of_all


def test_bounds_of_a_simulated_fleet_are_found(tmp_path, learn):
    bag = record_simulation(
        tmp_path / 'bag', landmarks=True, odometry=True, error=0.04, bearing_error=0.05
    )
    code, found = learn(bag, '--truth', SIMULATED_TRUTH, '--per', 'all', '--margin', '0')
    assert code == 0
    assert found['range']['min_error'] == found['range']['max_error'] == 0.0
    assert -0.0418 <= found['range']['min_error_relative'] <= -0.035
    assert 0.035 <= found['range']['max_error_relative'] <= 0.0401
    assert 0.045 <= found['bearing']['half_width'] <= 0.051
    assert abs(found['range']['expected_error']) < 0.05
    assert abs(found['bearing']['expected_error']) < 0.01
    odometry = found['odometry']
    # It is simulated with 0.05 per m and per rad, step by step.
    assert 0.0 < odometry['translation_per_m'] + odometry['constant_translation'] < 0.1
    assert 0.0 < odometry['rotation_per_rad'] + odometry['constant_rotation'] < 0.1
    assert 'links' not in found and 'robot_odometry' not in found
    assert 'all: 5400 readings' in learn.output
    assert 'Odometry of robot_1' in learn.output


def test_what_is_printed_is_what_the_node_takes(tmp_path, learn, told):
    """The ranges of one pair are 0.5 m too long; one robot goes farther than its odometry says."""

    def spoiled(topic, message):
        if topic == 'robot_1/range/robot_2':
            message.range += 0.5
        if topic == 'robot_2/odom':
            message.pose.pose.position.x *= 0.8
            message.pose.pose.position.y *= 0.8
        return message

    bag = record_simulation(tmp_path / 'bag', seconds=40.0, change=spoiled, odometry=True)
    code, found = learn(bag, '--truth', SIMULATED_TRUTH, '--keep', '1')
    assert code == 0
    settings = told()
    fleet = settings.fleet
    apart = bounds_of(settings, 'robot_1', 'robot_2').range_error
    other = bounds_of(settings, *ROBOTS[1:3]).range_error
    assert apart.expected_error_m == pytest.approx(0.5, abs=0.1)
    assert other.expected_error_m == pytest.approx(0.0, abs=0.1)
    assert apart.max_error_m + 8.0 * apart.max_error_relative > 0.5
    assert other.max_error_m + 8.0 * other.max_error_relative < 0.4
    rays = bounds_of(settings, 'robot_1', 'robot_2', LinkKind.BEARING)
    assert rays.bearing_half_width_rad <= 0.025
    assert len(found['links']) == 9 + 18
    error, learned = fleet.odometry_error, found['odometry']
    assert error.translation_per_m == learned['translation_per_m']
    assert error.rotation_per_rad == learned['rotation_per_rad']
    # It is simulated to 5 %.
    for robot, scale in zip(ROBOTS[:3], (1.0, 1.25, 1.0), strict=True):
        assert fleet.odometry_error_of(robot).translation_scale == pytest.approx(scale, rel=0.06)


def state(learn, **fleet):
    """Write the parameters of three robots with ranges to 0.1 m."""
    ranging = {'min_error': -0.1, 'max_error': 0.1, **EXACT}
    stated = {'robots': ['r1', 'r2', 'r3'], 'range': ranging, **fleet}
    write_parameters(learn.params.parent, **stated)


EXACT = {'min_error_relative': 0.0, 'max_error_relative': 0.0}
WIDE_LINK = '/r1/range/r3 sensor_msgs/msg/Range r1 r3 max_error=2.0'
OTHER_LINK = '/r1/range/r2 sensor_msgs/msg/Range r1 r2'
BARO_LINK = '/baro geometry_msgs/msg/PointStamped r1 min_error=-2.0 max_error=3.0'
PLACES_M = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0), 'r3': (0.0, 5.0)}


def record_three(bag, n_biased=200, truth=(), n_good=200):
    """Write 200 ranges of r1 to r2, later ones 5 m too long; and to r3, all 1.5 m too long."""
    recorder, rng = Recorder(), np.random.default_rng(0)
    for count, stamp_s in enumerate(START_S + np.arange(0.0, 20.0, 0.1)):
        noise_m = rng.uniform(-0.02, 0.02, 2)
        range_m = 4.0 if count < n_good else 9.0
        recorder.add_range('r1', 'r2', range_m + noise_m[0], stamp_s, stamp_s)
        if count < n_biased:
            recorder.add_range('r1', 'r3', 6.5 + noise_m[1], stamp_s, stamp_s)
        for robot in truth:
            recorder.add_truth(robot, PLACES_M[robot], 0.0, stamp_s)
    recorder.write(bag)
    return bag


def test_without_truth_bounds_are_widened_where_readings_scatter_more(tmp_path, learn, told):
    state(learn, range={'min_error': -0.01, 'max_error': 0.01, **EXACT})
    code, _ = learn(record_three(tmp_path / 'bag'))
    assert code == 0 and 'widened' in learn.output
    bounds = bounds_of(told(), 'r1', 'r2').range_error
    assert 0.03 < bounds.max_error_m - bounds.min_error_m < 0.1


def test_what_is_damaged_of_a_bag_is_told(tmp_path, learn):
    state(learn)
    (storage,) = record_three(tmp_path / 'bag').glob('*.mcap')
    storage.write_bytes(storage.read_bytes()[: storage.stat().st_size // 2])
    code, _ = learn(tmp_path / 'bag')
    assert code == 1 and 'what follows is not read' in learn.errors


def test_bounds_of_the_first_half_are_judged_on_the_second(tmp_path, learn):
    state(learn)
    bag = record_three(tmp_path / 'bag', n_biased=0, truth=PLACES_M, n_good=120)
    code, _ = learn(bag, '--truth', '/{robot}/truth')
    assert code == 0
    (share,) = set(re.findall(r'first half alone, (\S+) % of the second excluded', learn.told))
    # The last 80 of its 100 readings.
    assert float(share) == pytest.approx(80.0, abs=2.0)


def test_peers_get_the_bounds_of_their_observer(tmp_path, learn, told):
    bag = record_simulation(tmp_path / 'bag', peers=True)
    code, found = learn(bag, '--truth', SIMULATED_TRUTH)
    assert code == 0
    assert {text.split()[1] for text in found['links']} == {'sensor_msgs/msg/PointCloud2'}
    settings = told()
    for target in (*ROBOTS[1:], *LANDMARKS_M):
        assert bounds_of(settings, 'robot_1', target).range_error.max_error_relative < 0.05
        rays = bounds_of(settings, 'robot_1', target, LinkKind.BEARING)
        assert rays.bearing_half_width_rad < 0.03


@pytest.mark.parametrize('per', ['link', 'sensor', 'all'])
@pytest.mark.parametrize('n_biased, truth', [(200, ()), (10, ()), (0, ()), (200, ('r1', 'r2'))])
def test_a_link_without_truth_keeps_all_of_the_bounds_that_it_states(
    tmp_path, learn, told, per, n_biased, truth
):
    """This includes the least error, which the link takes from the bounds of all ranges."""
    state(learn, links=[WIDE_LINK, OTHER_LINK, BARO_LINK])
    bag = record_three(tmp_path / 'bag', n_biased, truth)
    code, _ = learn(bag, '--per', per, *(('--truth', '/{robot}/truth') if truth else ()))
    assert code == 0
    settings = told()
    biased, other = (bounds_of(settings, 'r1', target).range_error for target in ('r3', 'r2'))
    assert (biased.min_error_m, biased.max_error_m) == (-0.1, 2.0)
    assert (biased.min_error_relative, biased.max_error_relative) == (0.0, 0.0)
    if truth:
        assert -0.05 < other.min_error_m + 4.0 * other.min_error_relative < 0.0
    else:
        assert (other.min_error_m, other.max_error_m) == (-0.1, 0.1)
    nothing = '/r1/range/r3 has no range to learn from' in learn.told
    assert nothing == (n_biased == 0 or bool(truth))
    assert ('not a bias of a pair' in learn.told) == (not truth)
    assert BARO_LINK in learn.output


@pytest.mark.parametrize(
    ('observer', 'target', 'late_s', 'reason'),
    [
        ('r1', 'r2', 0.0, 'zero_stamp'),
        ('r1', 'r2', 1000.0, 'too_old'),
        ('r1', 'r2', -3600.0, 'future'),
        ('r1', 'stranger', 0.0, 'unknown_robot'),
    ],
)
def test_nothing_is_learned_of_what_the_localizer_rejects(
    tmp_path, learn, observer, target, late_s, reason
):
    state(learn, links=['/r1/range/r2 sensor_msgs/msg/Range r1 r2'])
    recorder, rng = Recorder(), np.random.default_rng(0)
    for stamp_s in START_S + np.arange(0.0, 10.0, 0.1):
        recorder.add_range('r1', 'r2', 4.0 + rng.uniform(-0.02, 0.02), stamp_s, stamp_s)
    recorder.write(tmp_path / 'clean')
    learn(tmp_path / 'clean')
    expected = learn.output.replace('clean', 'bag')
    for stamp_s in START_S + np.arange(2.0, 4.0, 0.1):
        # A stamp that is not filled in is zero whatever the time of arrival.
        measured_s = 0.0 if reason == 'zero_stamp' else stamp_s - late_s
        recorder.add_range(observer, target, rng.uniform(1.0, 9.0), measured_s, stamp_s)
    recorder.write(tmp_path / 'bag')
    code, _ = learn(tmp_path / 'bag')
    assert code == 0 and learn.output == expected
    assert f'nothing is learned from 20 rejected messages (20 {reason})' in learn.errors


@pytest.mark.parametrize('per', ['link', 'all'])
def test_odometry_is_learned_between_restarts_where_the_truth_is_known(tmp_path, learn, told, per):
    """That of r1, which counts 0.8 m for 1 m, starts anew elsewhere once; r2 has no truth."""
    recorder = Recorder()
    for step, stamp_s in enumerate(START_S + np.arange(0.0, 60.0, 0.1)):
        yaw, jump_m = 0.2 * (stamp_s - START_S), 20.0 if step >= 300 else 0.0
        place_m = 1.5 * np.array([math.sin(yaw), 1.0 - math.cos(yaw)])
        recorder.add_truth('r1', place_m, yaw, stamp_s)
        recorder.add_odometry('r1', 0.8 * place_m + jump_m, yaw, stamp_s)
        recorder.add_odometry('r2', place_m, yaw, stamp_s)
    recorder.write(tmp_path / 'bag')
    stated = {'translation_per_m': 0.07, 'max_gap': 0.3, 'latency': 0.2}
    state(learn, odometry=stated, robot_odometry={'r1': {'max_gap': 0.4}})
    stated = read_task(learn.params, []).settings.fleet.odometry_error
    code, _ = learn(tmp_path / 'bag', '--truth', '/{robot}/truth', '--per', per)
    assert code == 0
    fleet = told().fleet
    learned = fleet.odometry_error_of('r1')
    assert learned.translation_scale == pytest.approx(1.25, abs=1e-3)
    assert learned.translation_per_m + learned.constant_m < 1e-3
    # What is not learned stays as stated.
    assert (learned.max_gap_s, learned.latency_s) == (0.4, 0.2)
    assert fleet.odometry_error_of('r2') == stated
    assert 'Odometry of r1 started anew 1 times' in learn.told
    assert 'Nothing was learned about the odometry of r2, r3: it is as' in learn.told


def test_errors_of_sensors_on_a_robot_are_seen_from_where_they_are(tmp_path, learn):
    """On a circle, a tag that is also a camera and looks left; they err by 0.1 m and 0.02 rad."""
    recorder, arm_m, beacon_m = Recorder(), np.array([0.5, 0.3]), np.array([6.0, 1.0])
    for stamp_s in START_S + np.arange(0.0, 20.0, 0.1):
        yaw = 0.4 * (stamp_s - START_S)
        place_m = 2.0 * np.array([math.cos(yaw), math.sin(yaw)])
        forward, left = np.array([math.cos(yaw), math.sin(yaw)]), [-math.sin(yaw), math.cos(yaw)]
        way_m = beacon_m - (place_m + arm_m[0] * forward + arm_m[1] * np.array(left))
        bearing_rad = math.atan2(way_m[1], way_m[0]) - yaw - math.pi / 2.0 + 0.02
        recorder.add_truth('a', place_m, yaw, stamp_s)
        recorder.add_range('a/tag', 'beacon', float(np.hypot(*way_m)) + 0.1, stamp_s, stamp_s)
        recorder.add_bearing('a/tag', 'beacon', bearing_rad, stamp_s, stamp_s)
    recorder.write(tmp_path / 'bag')
    mounts = {'tag': {'position': arm_m.tolist(), 'rotation': [0.0, 0.0, math.pi / 2.0]}}
    fleet = {
        'robots': ['a'],
        'mounts': {'names': ['a/tag'], 'a': mounts},
        'anchors': {'names': ['beacon'], 'beacon': {'position': beacon_m.tolist()}},
    }
    write_parameters(tmp_path, **fleet)
    truth = '--truth', '/{robot}/truth'
    code, found = learn(tmp_path / 'bag', *truth, '--per', 'all', '--margin', '0')
    assert code == 0
    assert 0.099 < found['range']['min_error'] <= found['range']['max_error'] < 0.101
    assert found['bearing']['expected_error'] == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize(
    ('arguments', 'wanted'),
    [
        (['/mocap/{robot}'], 'no topic /mocap/robot_1 or .* in the bag; it has'),
        (['/robot_1/range/robot_2'], 'is sensor_msgs/msg/Range; a ground truth is'),
        (['nowhere.csv'], "'nowhere.csv' is no file"),
        ([SIMULATED_TRUTH, 'x.csv'], 'name topics or files'),
        # Its stamps are those of another clock.
        ([SIMULATED_TRUTH], "check 'stamp_source'"),
    ],
)
def test_a_truth_that_cannot_be_used_is_a_sentence(tmp_path, learn, arguments, wanted):
    def late(topic, message):
        if topic == SIMULATED_TRUTH[1:]:
            message.header.stamp.sec += 1000
        return message

    bag = record_simulation(tmp_path / 'bag', seconds=2.0, change=late)
    code, found = learn(bag, '--truth', *arguments)
    assert code in (1, 2) and not found
    assert re.search(wanted, learn.errors), learn.errors
    assert 'Traceback' not in learn.errors


def test_bounds_per_pair_halve_the_widths_of_the_real_recording(tmp_path, shared, learn):
    bag = shared / 'data/tiers_uwb/rosbag2_shortbag'
    truth = '/vrpn_client_node/{robot}_cap/pose'
    code, found = learn(bag, '--truth', truth, '--keep', '0.98', file=CONFIG)
    assert code == 0
    assert len(found['links']) == 6
    bounds = tmp_path / 'bounds.yaml'
    bounds.write_text(learn.output)
    widths = []
    for name, more in (('stated', ()), ('learned', ('--ros-args', '--params-file', bounds))):
        report = tmp_path / f'{name}.json'
        arguments = (bag, '-o', tmp_path / name, '--params', CONFIG)
        assert localize_bag([str(a) for a in (*arguments, '--report', report, *more)]) == 0
        widths.append(json.loads(report.read_text())['median_enclosure_width_m'])
    for robot in ('turtlebot3', 'turtlebot4', 'turtlebot5'):
        assert widths[1][robot] < 0.6 * widths[0][robot]


def test_stamps_that_are_early_and_a_gross_reading_are_named(tmp_path, learn):
    count = 0

    def spoiled(topic, message):
        nonlocal count
        if topic == 'robot_1/range/robot_2':
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            sec, nanosec = divmod(stamp_ns - 150_000_000, 10**9)
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        if topic == 'robot_1/range/robot_3':
            count += 1
            message.range += 5.0 if count == 50 else 0.0
        return message

    values = {'cameras': False, 'speed': 1.0, 'error': 0.005, 'seconds': 40.0}
    bag = record_simulation(tmp_path / 'bag', change=spoiled, **values)
    code, found = learn(bag, '--truth', SIMULATED_TRUTH, '--keep', '1')
    text = learn.told
    assert code == 0
    (early,) = re.findall(r'Stamps of range (\S+) are (\S+) s early', text)
    assert early[0] == 'robot_1->robot_2'
    assert float(early[1]) == pytest.approx(0.15, abs=0.03)
    (link,) = [link for link in found['links'] if 'stamp_offset' in link]
    assert link.split()[2:4] == list(ROBOTS[:2])
    assert float(link.partition('stamp_offset=')[2]) == pytest.approx(0.15, abs=0.03)
    one = r'one reading, range robot_1->robot_3 at [\d.]+ s, off by (\S+) m, sets a bound'
    groups = dict(re.findall(r'Ranges, (\S+): (.*?excluded)\.', text))
    assert float(*re.findall(one, groups['robot_1->robot_3'])) == pytest.approx(5.0, abs=0.1)
    assert re.search(one, groups['all']) and 'sets' not in groups['robot_1->robot_2']
    gross = 'The stated bounds of range robot_1->robot_3 are broken'
    broken = re.findall(rf'{gross} from .*? s: (\S+)', text)
    assert broken == ['1']
    assert 'window_outliers' not in text
    learn(bag, '--truth', SIMULATED_TRUTH, '--keep', '0.99')
    assert 'window_outliers: 1' in learn.told


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
        return code, parameters_in(printed.out).get('anchors'), printed.out + printed.err

    return run


ALL_PAIRS = tuple(combinations(PLACES, 2))


def true_ranges(pairs=ALL_PAIRS):
    return [(a, b, math.dist(PLACES[a], PLACES[b]) + 0.02) for a, b in pairs]


def test_without_known_nodes_the_first_two_make_the_axes_and_the_mirror_is_told(survey):
    code, anchors, told = survey(true_ranges(), '--error', '-0.03', '0.03')
    assert code == 0 and anchors['n1']['position'] == [0.0, 0.0]
    assert anchors['n2']['position'][1] == 0.0
    assert 'The mirror image agrees as well' in told


def test_what_is_missing_is_told(survey):
    chain = (('n1', 'n2'), ('n2', 'n3'), ('n3', 'n1'), ('n3', 'n4'))
    error = '--error', '-0.03', '0.03'
    known = [part for name in ('n1', 'n2', 'n3') for part in ('--anchor', name, *PLACES[name])]
    code, _, told = survey(true_ranges(chain), *error, *known)
    assert code == 1 and 'what is missing' in told and 'n4' in told
    wrong = [*true_ranges(), ('n2', 'n4', 9.0)]
    code, anchors, told = survey(wrong, *error, *known)
    assert code == 1 and anchors is None and 'these contradict each other' in told
    code, anchors, told = survey(wrong, *error, *known, '--outliers', '1')
    assert 'Left out: ' in told and set(anchors['names']) == set(PLACES)
    # By its other ranges n4 is on either side of n1 and n3; its bound holds both places.
    assert code == 1 and anchors['n4']['bound'] > 4.7


@pytest.mark.parametrize(
    ('ranges', 'arguments', 'wanted'),
    [
        ([('n1', 'n2', 'far')], ['--error', '0', '1'], 'line 2: could not convert'),
        ([('n1', 'n2', 1.0)], ['--error', '1', '0'], 'min_error'),
        ([('n1', '2', 1.0)], ['--error', '0', '1'], "'2' cannot be the name of an anchor"),
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
    for name, place in places.items():
        off_m = math.dist(anchors[name]['position'], place)
        assert off_m <= anchors[name]['bound'], name
    assert all(anchors[name]['bound'] == 0.0 for name in network['names'][:3])
    assert np.median([anchors[name]['bound'] for name in network['names'][3:]]) < 0.6
