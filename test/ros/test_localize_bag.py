# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `localize_bag` with one bag and with several."""

import math
import os
from pathlib import Path
import signal
import subprocess

from estimates import half_widths_of
from geometry_msgs.msg import Point, PointStamped
from nav_msgs.msg import Odometry
import numpy as np
from processes import PIPES, REPOSITORY, start, wait_for
import pytest
from rclpy.serialization import serialize_message
from small_bags import (
    ODD,
    ODD_MESSAGE,
    ODOMETRY,
    RANGE,
    TRIANGLE,
    counts,
    read,
    record_simulation,
    stamped,
    time_ns_of,
    write_parameters,
    write_table,
    write_triangles,
)

from dg_localization.fleet.rotations import quaternion_of_yaw
from dg_localization.ros.bags.offline import BagLocalizer, read_task
from dg_localization.simulation.moving_fleet import ROBOTS
from msg_adapters import Level, OdometryReading, PeersReading, adapter_for

ELEVATION, CLOUD = 'geometry_msgs/msg/PointStamped', 'sensor_msgs/msg/PointCloud2'


def test_other_measures_of_a_recording_are_read(recorder, localize):
    """The true depth of a is 1 m; up to 2.9 m is stated."""
    for step in range(11):
        message = PointStamped(point=Point(z=-1.0))
        recorder.write('/a/depth', step, stamped(message, time_ns_of(step)), ELEVATION)
        recorder.write_triangle([step])
    given = {'elevations__names': ['a'], 'elevations__a': [-2.9, 0.0]}
    code, report = localize(recorder.close(), elevation__topic='{observer}/depth', **given)
    assert code == 0 and report['accepted'] == 44 and not report['rejected']
    _, (*_, last) = read(localize.output, '/diagnostics')
    by_name = {status.name: status for status in last.statuses}
    assert by_name['localizer: input elevation a'].values['accepted'] == '11'
    assert by_name['localizer: fleet'].values['inputs_in_use'] == '4'


def test_other_measures_of_anchors_place_a_robot_on_the_map(recorder, localize, tmp_path):
    """A tag on a robot that circles hears the anchors; besides there is odometry only."""
    anchors = {'p': (-4.0, -3.0), 'q': (4.0, -4.0), 'r': (3.0, 4.0), 's': (-3.0, 3.0)}
    rng, error_m, unknown = np.random.default_rng(5), 0.05, np.full((3, 3), math.nan)
    # The points are the robot, the anchors and the tag.
    seconds, references, rows = np.array([2, 3, 4]), np.ones(3, int), ['stamp,robot,x,y,yaw']
    for step in range(60):
        stamp_s, angle = time_ns_of(step) * 1e-9, 0.05 * step
        x, y, yaw = math.cos(angle), math.sin(angle), angle + 0.5 * math.pi
        rows.append(f'{stamp_s:.3f},a,{x},{y},{yaw}')
        driven = OdometryReading(stamp_s, np.array([x, y, 0.0]), quaternion_of_yaw(yaw), 'odom')
        data = serialize_message(adapter_for(ODOMETRY).to_message(driven))
        recorder.write('/a/odom', step, data, ODOMETRY)
        tag_m = np.array([x - 0.4 * y - 0.1 * x, y + 0.4 * x - 0.1 * y])
        far_m = np.linalg.norm(np.array([*anchors.values()]) - tag_m, axis=1)
        differences_m = far_m[seconds - 1] - far_m[0] + rng.uniform(-error_m, error_m, 3)
        given = seconds, unknown[0], unknown, 'tag', references, differences_m
        data = serialize_message(adapter_for(CLOUD).to_message(PeersReading(stamp_s, *given)))
        recorder.write('/a/tag/peers', step, data, CLOUD)
    (tmp_path / 'truth.csv').write_text('\n'.join(rows))
    code, report = localize(
        recorder.close(),
        *('--truth', tmp_path / 'truth.csv'),
        **{f'anchors.{name}.position': place for name, place in anchors.items()},
        **{'robots': ['a'], 'max_speed': 1.0, 'covariance': 'enclosure'},
        **{'mounts.names': ['a/tag'], 'mounts.a.tag.position': [0.4, 0.1]},
        **{'anchors.names': [*anchors]},
        **{'range_difference.min_error': -error_m, 'range_difference.max_error': error_m},
    )
    assert code == 0 and report['truth']['held'] == report['truth']['compared'] > 20
    _, poses = read(localize.output, '/localizer/a/pose')
    assert half_widths_of(poses[-1])[:2].max() < 0.5 and poses[-1].frame_id == 'map'
    _, (*_, last) = read(localize.output, '/diagnostics')
    by_name = {status.name: status.values for status in last.statuses}
    heard = by_name['localizer: input range_difference a/tag->r-p']
    assert heard['topic'] == '/a/tag/peers' and int(heard['accepted']) > 50
    assert by_name['localizer: robot a']['heard'] == '4 of 4'
    assert 'problem' not in by_name['localizer: robot a']
    topics = {row['input']: row['topics'] for row in report['inputs']}
    assert topics['range_difference a/tag->r-p'] == ['/a/tag/peers']


def test_peers_in_one_message_give_the_same_answers_as_a_topic_each(localize, tmp_path):
    answers = []
    for name, peers in (('topics', False), ('messages', True)):
        bag = record_simulation(tmp_path / name, 3.0, peers=peers)
        assert localize(bag, robots=list(ROBOTS), max_speed=0.3, max_turn_rate=0.5)[0] == 0
        answers.append(read(localize.output, '/localizer/feasible_poses')[1])
    assert len(answers[0]) == 14 and len(answers[0][-1].positions_m) == len(ROBOTS)
    for one, other in zip(*answers, strict=True):
        # Ranges of topics are single numbers.
        np.testing.assert_allclose(one.positions_m, other.positions_m, atol=1e-4)


def test_the_outputs_are_those_of_the_node(localize, triangle_bag):
    code, report = localize(triangle_bag)
    assert code == 0 and counts(localize.output) == {
        '/localizer/feasible_poses': 10,
        '/localizer/markers': 10,
        **{f'/localizer/{robot}/feasible_poses': 10 for robot in 'abc'},
        **{f'/localizer/{robot}/pose': 0 for robot in 'abc'},
        # On the first answer, and every second.
        '/diagnostics': 3,
    }
    times_ns, values = read(localize.output, '/localizer/feasible_poses')
    assert times_ns == [time_ns_of(2 * k) for k in range(1, 11)]
    assert [v.stamp_s for v in values] == pytest.approx([t * 1e-9 for t in times_ns], abs=1e-6)
    assert {value.frame_id for value in values} == {'fleet'}
    placed = values[-1].positions_m.reshape(2, 3, 3)
    gaps = np.linalg.norm(placed[:, [0, 0, 1]] - placed[:, [1, 2, 2]], axis=-1)
    assert np.allclose(gaps, list(TRIANGLE.values()), atol=0.3)
    _, (*_, last) = read(localize.output, '/diagnostics')
    by_name = {status.name: status for status in last.statuses}
    assert by_name['localizer: fleet'].level is Level.WARN
    assert by_name['localizer: input range a->b'].values['accepted'] == '21'
    assert report['ticks'] == 10 and report['ending'] == '' and not report['contradictions']
    assert report['ticks_by_hypotheses'] == {'2': 10}
    assert report['ticks_by_verdict'] == {'covered': 10}
    assert report['median_enclosure_width_m']['a'] == 0.0
    assert 0.0 < report['median_enclosure_width_m']['b'] < 0.5
    assert (report['accepted'], report['rejected']) == (63, {})


def test_start_and_duration_choose_the_ticks(localize, triangle_bag):
    _, report = localize(triangle_bag, '--start', '0.5', '--duration', '0.7')
    times_ns, _ = read(localize.output, '/localizer/feasible_poses')
    assert times_ns == [time_ns_of(step) for step in (7, 9, 11)]
    # What was measured before the start is not known.
    assert report['start_s'] == 0.5 and report['accepted'] == 7 * 3
    assert report['end_s'] == pytest.approx(1.2)


def test_a_contradiction_is_reported_with_its_time(localize, recorder, capsys):
    recorder.write_triangle(range(10))
    recorder.write_triangle(range(10, 20), {**TRIANGLE, ('a', 'c'): 9.0})
    recorder.write_triangle(range(20, 41))
    code, report = localize(recorder.close())
    found = report['contradictions']
    # The wrong input contradicts itself while its eight newest readings are of both kinds.
    alone, together = [['range a->c']], [['range a->b', 'range a->c', 'range b->c']]
    assert [run['conflicts'] for run in found] == [alone, together, alone]
    assert found[0]['first_s'] == pytest.approx(1.0) and found[2]['last_s'] == pytest.approx(2.6)
    assert sum(run['ticks'] for run in found) == report['ticks_by_verdict']['infeasible'] == 9
    assert code == 0 and '| 1.0 to ' in capsys.readouterr().out


def test_rejected_measurements_are_counted_by_reason(localize, recorder, capsys):
    limits = {'min_range': 0.1, 'max_range': 30.0}
    wrong = {
        'nan': {'range_m': math.nan},
        'nothing_in_range': {'range_m': math.inf, **limits},
        'too_close': {'range_m': -math.inf},
        'above_max': {'range_m': 31.0, **limits},
        'below_min': {'range_m': 0.05, **limits},
        'too_old': {'range_m': 3.0, 'stamp_ns': time_ns_of(-600)},
        'future': {'range_m': 3.0, 'stamp_ns': time_ns_of(600)},
        'zero_stamp': {'range_m': 3.0, 'stamp_ns': 0},
    }
    recorder.write_triangle(range(11))
    for step in range(11):
        for reading in wrong.values():
            recorder.write_range('/b/range/a', step, **reading)
        recorder.write_range('/c/range/a', step, -1.0)
        recorder.write_range('/c/range/stranger', step, 2.0)
    code, report = localize(recorder.close())
    assert code == 0 and report['accepted'] == 33
    assert report['rejected'] == dict.fromkeys((*wrong, 'negative', 'unknown_robot'), 11)
    by_name = {one['input']: one for one in report['inputs']}
    assert by_name['range a->b']['accepted'] == 11
    assert by_name['range c->a']['topics'] == ['/c/range/a']
    assert by_name['range c->a']['rejected'] == {'negative': 11}
    assert '-1' in by_name['range c->a']['last_rejection']
    told = capsys.readouterr().out
    assert 'range -1.0 m is negative' in told and "'stranger' is not one of" in told
    assert 'inputs that reject readings: ' in told
    # The reasons of the node are there once.
    rows = [line for line in told.splitlines() if 'nothing acceptable received' in line]
    assert len(rows) == 3 and all('(5 ticks)' in row for row in rows)
    assert any(run['status'] == 'input range c->a' for run in report['said'])


def test_answers_are_for_the_time_of_the_odometry_as_those_of_the_node(localize, recorder):
    late_ns = 60_000_000
    for step in range(21):
        recorder.write_triangle([step])
        for robot in 'abc':
            data = stamped(Odometry(), time_ns_of(step) - late_ns, f'{robot}/odom')
            recorder.write(f'/{robot}/odom', step, data, ODOMETRY)
    assert localize(recorder.close())[0] == 0
    times_ns, values = read(localize.output, '/localizer/feasible_poses')
    assert len(times_ns) == 10
    assert [v.stamp_s for v in values] == pytest.approx(
        [(t - late_ns) * 1e-9 for t in times_ns], abs=1e-6
    )


def test_links_and_remappings_work_as_for_the_node(localize, recorder):
    for step in range(11):
        for (observer, target), range_m in TRIANGLE.items():
            recorder.write_range(f'/site/{observer}{target}', step, range_m)
    links = [f'{a}{b} {RANGE} {a} {b}' for a, b in TRIANGLE]
    ros_args = ('--ros-args', '-r', '__ns:=/site', '-p', 'reference_robot:=b')
    code, report = localize(recorder.close(), *ros_args, links=links)
    assert code == 0 and report['accepted'] == 33
    _, values = read(localize.output, '/site/localizer/feasible_poses')
    # The reference robot is at the origin.
    assert values[0].positions_m[1].tolist() == [0.0, 0.0, 0.0]
    _, (first, *_) = read(localize.output, '/diagnostics')
    assert first.statuses[0].name == 'site/localizer: fleet'


def test_what_is_missing_or_of_another_type_is_reported(localize, recorder):
    recorder.write_triangle(range(11))
    recorder.write('/odd', 0, ODD_MESSAGE, ODD)
    links = [f'/missing {RANGE} a b', f'/odd {RANGE} b a']
    code, report = localize(recorder.close(), links=links)
    assert code == 0 and report['accepted'] == 22
    assert report['notices'] == [
        '/missing of the links is not in the bag',
        f'/odd is passed over: the link says {RANGE}, the bag {ODD}',
        # A link gives this input another topic.
        'topics that are no input: 1 (/a/range/b)',
    ]
    _, (*_, last) = read(localize.output, '/diagnostics')
    said = {status.values.get('topic'): status.message for status in last.statuses}
    assert said['/missing'] == 'nothing received'


SHORT = "less than 0.2 s, one period of 'rate'"


@pytest.mark.parametrize(
    ('arguments', 'parameters', 'code', 'reason'),
    [
        ((), {'range__topic': ''}, 1, 'no topic of the bag is an input of a, b, c by'),
        (('--start', '2.0'), {}, 1, SHORT),
        (('--duration', '0.1'), {}, 1, SHORT),
        ((), {'max_sped': 1.0}, 2, "'max_sped' is unknown; did you mean 'max_speed'?"),
        (('--ros-args', '--no-such-argument'), {}, 2, '--no-such-argument'),
        (('--start', '-1'), {}, 2, "'-1' is not a number of at least 0 s"),
        (('--report', 'report.txt'), {}, 2, "'report.txt' must end in .json or .md"),
        (('--report', 'no/folder/report.md'), {}, 2, "there is no folder 'no/folder'"),
        (('--params', 'no.yaml'), {}, 2, "'no.yaml' is no file"),
        (('-o', 'config'), {}, 2, "'config' exists; name a folder that does not"),
    ],
)
def test_what_cannot_be_done_is_refused(
    localize, triangle_bag, arguments, parameters, code, reason, capsys
):
    try:
        found, _ = localize(triangle_bag, *arguments, **parameters)
    except SystemExit as ended:
        found = ended.code
    assert found == code and reason in capsys.readouterr().err
    assert not localize.output.exists()


def test_no_limit_depends_on_a_clock_of_the_machine():
    fleet = read_task(REPOSITORY / 'config/tiers_uwb.yaml', []).settings.fleet
    limits_s = fleet.solver.max_seconds, fleet.solver.tighten_seconds, fleet.max_conflict_seconds
    assert limits_s == (math.inf,) * 3
    assert fleet.solver.max_boxes == 2000 and fleet.max_conflict_solves == 200


def test_a_signal_leaves_a_readable_bag(tmp_path, recorder):
    recorder.write_triangle(range(4_000))
    output = tmp_path / 'out'
    paths = recorder.close(), '-o', output, '--params', write_parameters(tmp_path)
    process = start('localize_bag', *paths, **PIPES)
    (storage,) = wait_for(lambda: list(output.glob('*.mcap')))
    # Messages are written a megabyte at a time.
    wait_for(lambda: storage.stat().st_size > 100_000)
    process.send_signal(signal.SIGTERM)
    told, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert 'Traceback' not in errors and 'interrupted' in told
    times_ns, _ = read(output, '/localizer/feasible_poses')
    assert 0 < len(times_ns) < 2_000
    assert f'{len(times_ns)} ticks' in told


def test_answers_are_compared_with_a_table_of_the_truth(localize, triangle_bag, tmp_path, capsys):
    def places(stamp_s):
        # Robot c is elsewhere for a while, and at the end the place of the origin is unknown.
        a = {'a': (7.0, 5.0)} if stamp_s < 1.45 else {}
        return {**a, 'b': (10.0, 5.0), 'c': (7.0, 9.5 if 0.95 < stamp_s < 1.45 else 9.0)}

    table = write_table(tmp_path / 'truth.csv', places)
    code, report = localize(triangle_bag, '--truth', table, max_speed=0.0)
    truth = report['truth']
    # In the last answers the distance of b and c is compared.
    assert code == 0 and truth['compared'] == report['ticks'] == 10
    assert truth['held'] == 7 and truth['unlisted'] == 0
    (missed,) = truth['missed']
    assert missed['ticks'] == 3 and missed['robots'] == ['c']
    assert (missed['first_s'], missed['last_s']) == pytest.approx((1.0, 1.4))
    off_m = {'median': pytest.approx(0.0, abs=1e-3), 'percentile_95': pytest.approx(0.5, abs=1e-3)}
    assert truth['errors']['c']['point_m'] == off_m
    printed = capsys.readouterr().out
    assert 'The truth is inside a hypothesis in 7 of 10 answers.' in printed
    assert '| 1.0 to 1.4 s (3 ticks) | c  |' in printed
    assert '| c     | 0.00 m (0.50)' in printed


def test_a_picture_that_cannot_be_written_is_told(localize, triangle_bag, tmp_path, capsys):
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")
    path = tmp_path / 'picture.png'
    path.mkdir()
    code, report = localize(triangle_bag, '--plot', path)
    assert code == 1 and report['ticks'] == 10
    assert 'cannot be written' in capsys.readouterr().err


@pytest.mark.parametrize('stdout', ['pipe', '/dev/full'])
def test_no_answer_is_lost_with_the_terminal(tmp_path, triangle_bag, stdout):
    """The reader of the output is gone, or the disk is full."""
    output = tmp_path / 'out'
    reader, writer = os.pipe()
    os.close(reader)
    descriptor = writer if stdout == 'pipe' else os.open(stdout, os.O_WRONLY)
    paths = triangle_bag, '-o', output, '--params', write_parameters(tmp_path)
    process = start('localize_bag', *paths, stdout=descriptor, stderr=subprocess.PIPE)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == (0 if stdout == 'pipe' else 1)
    assert ('No space left on device' in errors) == (stdout != 'pipe')
    assert 'Traceback' not in errors and counts(output)['/localizer/feasible_poses'] == 10


def test_an_error_keeps_the_answers_before_it(localize, triangle_bag, monkeypatch):
    tick = BagLocalizer.tick

    def fails_late(self, time_ns, cancel):
        if time_ns > time_ns_of(10):
            raise MemoryError
        return tick(self, time_ns, cancel)

    monkeypatch.setattr(BagLocalizer, 'tick', fails_late)
    with pytest.raises(MemoryError):
        localize(triangle_bag)
    assert counts(localize.output)['/localizer/feasible_poses'] == 5


def test_the_report_says_when_the_budget_ended_the_search(localize, recorder, capsys):
    ranges_m = {**TRIANGLE, ('b', 'd'): 3.0, ('c', 'd'): 4.0}
    recorder.write_triangle(range(11), ranges_m)
    given = {'robots': ['a', 'b', 'c', 'd'], 'solver__max_boxes': 1}
    code, report = localize(recorder.close(), **given)
    assert code == 0 and report['max_boxes'] == 1
    assert report['ticks_by_verdict'] == {'out_of_budget': 5}
    assert 'The search of 5 ticks ended at solver.max_boxes, 1 boxes' in capsys.readouterr().out


def test_each_bag_is_localized_compared_and_drawn_as_alone(localize, tmp_path):
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")
    lengths = {'first': 11, 'second': 21}
    bags = [write_triangles(tmp_path / name, [range(n)]) for name, n in lengths.items()]
    picture = tmp_path / 'picture.png'
    # ROS arguments reach every process.
    given = '--truth', write_table(tmp_path / 'truth.csv'), '--ros-args', '-p', 'rate:=4.0'
    code, report = localize(bags, '--jobs', '1', '--plot', picture, *given)
    together, outcomes = localize.output, report['bags']
    assert code == 0 and [bag['name'] for bag in outcomes] == ['first', 'second']
    for bag, outcome in zip(bags, outcomes, strict=True):
        report = outcome['report']
        assert report['truth']['held'] == report['truth']['compared'] == report['ticks'] > 0
        assert report['rate_hz'] == 4.0
        assert (together / bag.name / 'picture.png').read_bytes().startswith(b'\x89PNG')
    assert localize(bags[0], *given) == (0, outcomes[0]['report'])
    assert counts(together / 'first/answers') == counts(localize.output)


def test_ctrl_c_leaves_bags_that_can_be_read(tmp_path):
    """A terminal sends its signal to all processes of the group."""
    bags = [write_triangles(tmp_path / name, [range(400)]) for name in ('first', 'second')]
    params = write_parameters(tmp_path, rate=100.0)
    paths = *bags, '-o', tmp_path / 'out', '--params', params, '--jobs', '2'
    process = start('localize_bag', *paths, stderr=subprocess.DEVNULL, start_new_session=True)
    answers = [tmp_path / 'out' / bag.name / 'answers' for bag in bags]
    wait_for(lambda: all(any(path.glob('*.mcap')) for path in answers))
    # One that is told to stop by the terminal and by the command would stop in the middle.
    threads = Path(f'/proc/{process.pid}/task').glob('*/children')
    started = [int(pid) for thread in threads for pid in thread.read_text().split()]
    assert len(started) == 2
    assert all(os.getpgid(pid) != process.pid for pid in started)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(timeout=60.0) == 130
    for path in answers:
        assert not path.exists() or (path / 'metadata.yaml').exists()


def test_a_bag_that_fails_leaves_the_others_theirs(localize, tmp_path):
    impossible = {('a', 'b'): 1.0, ('a', 'c'): 1.0, ('b', 'c'): 9.0}
    bag = write_triangles(tmp_path / 'first', [range(11), impossible])
    (tmp_path / 'broken.mcap').write_bytes(b'no bag')
    report = tmp_path / 'all.md'
    assert localize([bag, tmp_path / 'broken.mcap'], '--report', report) == (1, None)
    first, broken = report.read_text().splitlines()[-2:]
    assert first.startswith('| first ') and '| at its end ' in first and '| no placement' in first
    assert broken.startswith('| broken ') and 'broken.mcap' in broken


def test_two_bags_of_one_name_are_refused(triangle_bag, localize, capsys):
    assert localize([triangle_bag, triangle_bag]) == (2, None) and not localize.output.exists()
    assert "two bags are called 'bag'" in capsys.readouterr().err


def test_one_process_and_four_give_the_same_bytes(localize, tmp_path, monkeypatch):
    """The order of sets, which differs between processes, does not show either."""
    stretches = [range(10)], [range(10, 20), {**TRIANGLE, ('b', 'a'): 2.0, ('c', 'b'): 9.5}]
    bags = [write_triangles(tmp_path / name, *stretches) for name in ('first', 'second')]
    found = []
    for jobs, seed in ('1', '1'), ('4', '2'):
        monkeypatch.setenv('PYTHONHASHSEED', seed)
        code, report = localize(bags, '--jobs', jobs, max_outliers=2)
        assert code == 0 and report['bags'][0]['report']['contradictions']
        files = sorted(path for path in localize.output.rglob('*') if path.is_file())
        found.append({path.relative_to(localize.output): path.read_bytes() for path in files})
    assert len(found[0]) >= 6 and found[0] == found[1]
