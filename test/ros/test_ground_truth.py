# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A ground truth that is damaged, cut off or half known: the report says so."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")

from ruamel.yaml import YAML  # noqa: E402
from test_localize_bag import (  # noqa: E402
    PARAMETERS,
    PERIOD_NS,
    START_NS,
    STORE,
    TRIANGLE,
    TYPES,
    Recorder,
)

from dg_localization.calibration.truth import TrueTrack  # noqa: E402
from dg_localization.fleet.rotations import (  # noqa: E402
    quaternion_of_euler,
    rotation_of_quaternion,
)
from dg_localization.ros.bags.ground_truth import read_truth_file  # noqa: E402
from dg_localization.ros.executables import UsageError, localize_bag  # noqa: E402

POSE = 'geometry_msgs/msg/PoseStamped'
PLACES = {'a': (0.0, 0.0), 'b': (3.0, 0.0), 'c': (0.0, 4.0)}
TRUTH = '--truth', '/{robot}/truth'


@pytest.fixture
def recorder(tmp_path):
    return Recorder(tmp_path / 'bag')


@pytest.fixture
def localize(tmp_path):
    """Localize a bag beside a truth; return the exit code and the report."""

    def run(bag, *arguments, **parameters):
        params, report = tmp_path / 'params.yaml', tmp_path / 'report.json'
        given = {'/**': {'ros__parameters': {**PARAMETERS, **parameters}}}
        params.write_text(json.dumps(given))
        output = tmp_path / f'answers_{len(list(tmp_path.iterdir()))}'
        paths = ('-o', output, '--params', params, '--report', report)
        code = localize_bag([str(text) for text in (bag, *paths, *arguments)])
        return code, json.loads(report.read_text())

    return run


def pose_message(time_ns, place):
    stamp = TYPES['builtin_interfaces/msg/Time'](*divmod(time_ns, 10**9))
    pose = TYPES['geometry_msgs/msg/Pose'](
        TYPES['geometry_msgs/msg/Point'](*place, 0.0),
        TYPES['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0),
    )
    return STORE.serialize_cdr(TYPES[POSE](TYPES['std_msgs/msg/Header'](stamp, ''), pose), POSE)


def write_truth(recording, robots, steps):
    for step in steps:
        for robot in robots:
            data = pose_message(START_NS + step * PERIOD_NS, PLACES[robot])
            recording.write(f'/{robot}/truth', step, data, POSE)


def joined(parts, bag):
    """Make one bag of two, as a recorder that splits does."""
    bag.mkdir()
    names, described = [], []
    for number, part in enumerate(parts):
        names.append(f'{bag.name}_{number}.mcap')
        shutil.copy(next(part.glob('*.mcap')), bag / names[-1])
        text = (part / 'metadata.yaml').read_text()
        described.append(YAML(typ='safe').load(text)['rosbag2_bagfile_information'])
    whole, other = described
    ends_ns = [
        one['starting_time']['nanoseconds_since_epoch'] + one['duration']['nanoseconds']
        for one in described
    ]
    whole |= {'relative_file_paths': names, 'files': []}
    whole['message_count'] += other['message_count']
    whole['duration']['nanoseconds'] = max(ends_ns) - START_NS
    counts = {
        topic['topic_metadata']['name']: topic['message_count']
        for topic in other['topics_with_message_count']
    }
    for topic in whole['topics_with_message_count']:
        topic['message_count'] += counts[topic['topic_metadata']['name']]
    with (bag / 'metadata.yaml').open('w') as file:
        YAML().dump({'rosbag2_bagfile_information': whole}, file)
    return bag


def test_a_truth_that_ends_at_a_disorder_of_its_own_is_told(tmp_path, localize, capsys):
    """One pose comes 1.5 s after those that follow it in the file; the ranges are in order."""
    parts = [Recorder(tmp_path / 'part_0'), Recorder(tmp_path / 'part_1')]
    for part, steps in zip(parts, (range(10), range(10, 31)), strict=True):
        part.write_triangle(steps)
        write_truth(part, 'ab', steps)
    write_truth(parts[0], 'c', [25])
    write_truth(parts[1], 'c', [26])
    bag = joined([part.close() for part in parts], tmp_path / 'bag')
    code, report = localize(bag, *TRUTH, max_speed=0.0)
    assert code == 1 and report['ending'] == '' and report['accepted'] == 93
    (damage,) = report['damage']
    assert damage.startswith('the ground truth ends at 2.5 s: ')
    assert 'comes after one of' in damage
    assert f'- {damage}' in capsys.readouterr().out


def test_what_cannot_be_read_of_a_truth_is_told(recorder, localize, capsys):
    recorder.write_triangle(range(21))
    write_truth(recorder, 'a', range(21))
    write_truth(recorder, 'b', range(20))
    recorder.write('/b/truth', 20, b'\x00\x01\x00\x00damaged', POSE)
    for step in range(21):
        recorder.write('/c/truth', step, b'\x00\x01\x00\x00damaged', POSE)
    code, report = localize(recorder.close(), *TRUTH)
    assert code == 1 and report['truth']['without_truth'] == ['c']
    (damage,) = report['damage']
    assert damage.startswith('/c/truth is passed over')
    assert damage in report['notices']
    count = '1 messages of the ground truth could not be read'
    assert count in report['notices'] and count in capsys.readouterr().out


def test_a_truth_without_a_message_is_told(recorder, localize):
    recorder.write_triangle(range(21))
    write_truth(recorder, 'ab', range(21))
    recorder._writer.add_connection('/c/truth', POSE, typestore=STORE)
    code, report = localize(recorder.close(), *TRUTH)
    assert code == 0 and report['damage'] == []
    assert report['notices'] == ['/c/truth is passed over: it holds no message']


def test_a_whole_truth_needs_no_word(recorder, localize):
    recorder.write_triangle(range(21))
    write_truth(recorder, 'abc', range(21))
    code, report = localize(recorder.close(), *TRUTH, max_speed=0.0)
    assert code == 0 and report['damage'] == report['notices'] == []
    assert report['truth']['held'] == report['truth']['compared'] == report['ticks'] == 10


def test_contradictions_do_not_hold_the_truth(recorder, localize, capsys):
    recorder.write_triangle(range(10))
    recorder.write_triangle(range(10, 20), {**TRIANGLE, ('a', 'c'): 9.0})
    write_truth(recorder, 'abc', range(20))
    code, report = localize(recorder.close(), *TRUTH, max_speed=0.0)
    truth, n_empty = report['truth'], report['ticks_by_verdict']['infeasible']
    assert code == 0 and n_empty > 0
    assert (truth['compared'], truth['infeasible']) == (report['ticks'], n_empty)
    assert truth['held'] == report['ticks'] - n_empty and truth['missed'] == []
    assert f'{n_empty} answers have no placement at all' in capsys.readouterr().out


def track(path, robot='a'):
    rows = read_truth_file(path, [robot], 3)[robot]
    return TrueTrack(*map(np.array, zip(*rows, strict=True)))


def test_in_space_a_yaw_alone_is_no_orientation(tmp_path):
    path = tmp_path / 'truth.csv'
    path.write_text('stamp,robot,x,y,z,yaw\n1.0,a,2.0,3.0,4.0,0.5\n1.5,a,2.0,3.0,4.0,0.5\n')
    robot = track(path)
    assert robot.positions_at([1.2])[0] == pytest.approx([2.0, 3.0, 4.0])
    assert np.isnan(robot.rotations_at([1.0, 1.2])).all()
    assert np.isnan(robot.carrying([0.0, 0.5, 0.0]).positions_at([1.2])).all()
    ((_, _, turn), _) = read_truth_file(path, ['a'], 2)['a']
    assert turn == pytest.approx(quaternion_of_euler(0.0, 0.0, 0.5))


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_table_tells_orientations_by_quaternions(tmp_path, dimension):
    path, tilted = tmp_path / 'truth.csv', quaternion_of_euler(0.1, -0.2, 0.5)
    text = ','.join(f'{number:.9f}' for number in tilted)
    rows = [f'1.0,a,2.0,3.0,4.0,{text}', '2.0,a,2.0,3.0,4.0,,,,']
    path.write_text('\n'.join(['stamp,robot,x,y,z,qx,qy,qz,qw', *rows]))
    rows = read_truth_file(path, ['a'], dimension)['a']
    robot = TrueTrack(*map(np.array, zip(*rows, strict=True)))
    known, unknown = robot.rotations_at([1.0, 2.0])
    assert known == pytest.approx(rotation_of_quaternion(tilted), abs=1e-8)
    assert np.isnan(unknown).all()


@pytest.mark.parametrize(
    ('table', 'wanted'),
    [
        ('stamp,robot,x,y,z,qx,qy,qz\n1.0,a,2.0,3.0,4.0,0,0,0\n', 'has no column qw'),
        ('stamp,robot,x,y,z,qx,qy,qz,qw\n1.0,a,2.0,3.0,4.0,0,0,0,inf\n', 'line 2: no position'),
        ('stamp,x,y,z,robot\n1.0,2.0,3.0,4.0\n', 'line 2: it names no robot'),
        ('stamp,x,y,z,robot\n1.0,2.0,3.0,4.0,\n', 'line 2: it names no robot'),
    ],
)
def test_what_is_wrong_in_a_table_is_named(tmp_path, table, wanted):
    path = tmp_path / 'truth.csv'
    path.write_text(table)
    with pytest.raises(UsageError, match=wanted):
        read_truth_file(path, ['a'], 3)


def test_the_report_says_that_a_table_tells_no_orientation_in_space(
    recorder, localize, tmp_path, capsys
):
    recorder.write_triangle(range(21))
    bag, path = recorder.close(), tmp_path / 'truth.csv'
    row = f'{START_NS * 1e-9:.3f},a,0.0,0.0,0.0,0.0'
    path.write_text(f'stamp,robot,x,y,z,yaw\n{row}\n')
    _, report = localize(bag, '--truth', path)
    assert report['notices'] == []
    _, report = localize(bag, '--truth', path, dimension=3)
    (notice,) = report['notices']
    assert 'truth.csv tells no orientation in space' in notice and 'qx, qy, qz and qw' in notice
    assert notice in capsys.readouterr().out
