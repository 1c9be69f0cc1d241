# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `localize_bag`: small bags written here, and the real UWB recording."""

import errno
import json
import math
import os
from pathlib import Path
import re
import shlex
import signal
import sqlite3
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")

from mcap.writer import Writer as McapWriter  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.interfaces import (  # noqa: E402
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402
from uwb_recording import CONFIG  # noqa: E402
import zstandard  # noqa: E402

from dg_localization.fleet import Estimate  # noqa: E402
from dg_localization.fleet.window.forgetting import Forgotten  # noqa: E402
from dg_localization.ros.bags import (  # noqa: E402
    bag as bag_module,
    localize_bag as localize_bag_module,
    picture,
)
from dg_localization.ros.bags.offline import (  # noqa: E402
    BagLocalizer,
    Event,
    read_task,
    timeline,
)
from dg_localization.ros.bags.reading import BagMessage, Reading  # noqa: E402
from dg_localization.ros.bags.report import BagReport, Tally, as_markdown  # noqa: E402
from dg_localization.ros.executables import localize_bag  # noqa: E402
from msg_adapters import ElevationReading, Level, PeersReading, adapter_for  # noqa: E402

REPOSITORY = Path(__file__).parents[2]
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg('float64 x', 'strange_msgs/msg/Odd'))
TYPES = STORE.types
RANGE = 'sensor_msgs/msg/Range'
ODOMETRY = 'nav_msgs/msg/Odometry'
ELEVATION = 'geometry_msgs/msg/PointStamped'
POINT_CLOUD = 'sensor_msgs/msg/PointCloud2'
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
# Two sides and the hypotenuse of a right triangle.
TRIANGLE = {('a', 'b'): 3.0, ('a', 'c'): 4.0, ('b', 'c'): 5.0}
PARAMETERS = {'robots': ['a', 'b', 'c'], 'max_speed': 0.1}


def range_message(time_ns, range_m, frame_id=''):
    stamp = TYPES['builtin_interfaces/msg/Time'](*divmod(time_ns, 10**9))
    header = TYPES['std_msgs/msg/Header'](stamp, frame_id)
    return STORE.serialize_cdr(TYPES[RANGE](header, 0, 0.0, 0.0, 0.0, range_m, 0.0), RANGE)


def odometry_at_rest(time_ns, frame_id):
    def zeros(name, *fields):
        return TYPES[f'geometry_msgs/msg/{name}'](*fields or (0.0, 0.0, 0.0))

    stamp = TYPES['builtin_interfaces/msg/Time'](*divmod(time_ns, 10**9))
    pose = zeros('Pose', zeros('Point'), zeros('Quaternion', 0.0, 0.0, 0.0, 1.0))
    twist = zeros('Twist', zeros('Vector3'), zeros('Vector3'))
    message = TYPES[ODOMETRY](
        TYPES['std_msgs/msg/Header'](stamp, frame_id),
        '',
        zeros('PoseWithCovariance', pose, np.zeros(36)),
        zeros('TwistWithCovariance', twist, np.zeros(36)),
    )
    return STORE.serialize_cdr(message, ODOMETRY)


class Recorder:
    """Writes a bag; messages on a topic of their own are 0.1 s apart."""

    def __init__(self, path, plugin=StoragePlugin.MCAP):
        self.path = path
        self._writer = Writer(path, version=9, storage_plugin=plugin)
        self._writer.open()
        self._connections = {}

    def write(self, topic, step, data, type_name=RANGE):
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, type_name, typestore=STORE
            )
        self._writer.write(self._connections[topic], START_NS + step * PERIOD_NS, data)

    def write_triangle(self, steps, ranges_m=TRIANGLE):
        for step in steps:
            for (observer, target), range_m in ranges_m.items():
                data = range_message(START_NS + step * PERIOD_NS, range_m)
                self.write(f'/{observer}/range/{target}', step, data)

    def close(self):
        self._writer.close()
        return self.path


@pytest.fixture
def recorder(tmp_path):
    return Recorder(tmp_path / 'bag')


@pytest.fixture
def triangle_bag(recorder):
    recorder.write_triangle(range(21))
    return recorder.close()


@pytest.fixture
def localize(tmp_path):
    """Localize a bag with parameters; return the exit code, and the report if there is one."""
    number = iter(range(99))

    def run(bag, *arguments, **parameters):
        folder = tmp_path / f'run_{next(number)}'
        folder.mkdir()
        given = {**PARAMETERS, **{name.replace('__', '.'): v for name, v in parameters.items()}}
        params = folder / 'params.yaml'
        # JSON is YAML.
        params.write_text(json.dumps({'/**': {'ros__parameters': given}}))
        report, run.output = folder / 'report.json', folder / 'out'
        paths = ('-o', run.output, '--params', params, '--report', report)
        code = localize_bag([str(text) for text in (bag, *paths, *arguments)])
        return code, json.loads(report.read_text()) if report.exists() else None

    return run


def read(path, topic):
    """Return the log times in ns and the values of the messages on a topic."""
    with AnyReader([path], default_typestore=STORE) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        assert connections, topic
        type_name = connections[0].msgtype
        value_of = adapter_for(type_name).from_message
        messages = [
            (time_ns, value_of(reader.deserialize(data, type_name)))
            for _, time_ns, data in reader.messages(connections)
        ]
    return [time_ns for time_ns, _ in messages], [value for _, value in messages]


def counts(path):
    with AnyReader([path], default_typestore=STORE) as reader:
        return {name: info.msgcount for name, info in reader.topics.items()}


@pytest.mark.parametrize(
    'given', [{'elevation__topic': '{observer}/depth'}, {'links': [f'/a/depth {ELEVATION} a']}]
)
def test_elevations_of_a_recording_are_read(given, recorder, localize):
    """The true depth of a is 1 m, of anything up to 2.9 m."""
    for step in range(11):
        time_ns = START_NS + step * PERIOD_NS
        reading = ElevationReading(time_ns * 1e-9, -1.0)
        message = adapter_for(ELEVATION).to_message(reading)
        recorder.write('/a/depth', step, serialize_message(message), ELEVATION)
        recorder.write_triangle([step])
    code, report = localize(
        recorder.close(), elevations__names=['a'], elevations__a=[-2.9, 0.0], **given
    )
    assert code == 0 and not report['rejected']
    assert report['accepted'] == 44
    _, (*_, last) = read(localize.output, '/diagnostics')
    by_name = {status.name: status for status in last.statuses}
    assert by_name['localizer: input elevation a'].values['accepted'] == '11'
    assert by_name['localizer: fleet'].values['inputs_in_use'] == '4'


@pytest.mark.parametrize('duration', ['1.0', '1.5'])
def test_a_message_at_the_very_end_of_the_duration_is_no_damage(duration, triangle_bag, localize):
    code, report = localize(triangle_bag, '--start', '0.5', '--duration', duration)
    assert code == 0 and report['damage'] == []
    assert report['accepted'] == 3 * round(10 * float(duration))


def test_the_outputs_are_those_of_the_node(localize, triangle_bag):
    code, report = localize(triangle_bag)
    assert code == 0
    assert counts(localize.output) == {
        '/localizer/feasible_poses': 10,
        '/localizer/markers': 10,
        **{f'/localizer/{robot}/feasible_poses': 10 for robot in 'abc'},
        **{f'/localizer/{robot}/pose': 0 for robot in 'abc'},
        # On the first answer, and every second.
        '/diagnostics': 3,
    }
    times_ns, values = read(localize.output, '/localizer/feasible_poses')
    assert times_ns == [START_NS + 2 * k * PERIOD_NS for k in range(1, 11)]
    assert [v.stamp_s for v in values] == pytest.approx([t * 1e-9 for t in times_ns], abs=1e-6)
    assert {value.frame_id for value in values} == {'fleet'}
    placed = values[-1].positions_m.reshape(2, 3, 3)
    gaps = np.linalg.norm(placed[:, [0, 0, 1]] - placed[:, [1, 2, 2]], axis=-1)
    assert np.allclose(gaps, list(TRIANGLE.values()), atol=0.3)
    _, (*_, last) = read(localize.output, '/diagnostics')
    by_name = {status.name: status for status in last.statuses}
    assert by_name['localizer: fleet'].level is Level.WARN
    assert by_name['localizer: input range a->b'].values['accepted'] == '21'
    assert report['ticks'] == 10 and report['ending'] == ''
    assert report['ticks_by_hypotheses'] == {'2': 10}
    assert report['ticks_by_verdict'] == {'covered': 10}
    assert report['median_enclosure_width_m']['a'] == 0.0
    assert 0.0 < report['median_enclosure_width_m']['b'] < 0.5
    assert (report['accepted'], report['rejected']) == (63, {})
    assert report['contradictions'] == []


def test_one_hypothesis_has_poses(localize, triangle_bag):
    anchors = {'names': ['a', 'b', 'c']}
    places = {'a': [0.0, 0.0], 'b': [3.0, 0.0], 'c': [0.0, 4.0]}
    anchors |= {name: {'position': place} for name, place in places.items()}
    code, report = localize(triangle_bag, anchors=anchors)
    assert code == 0 and report['ticks_by_hypotheses'] == {'1': 10}
    _, poses = read(localize.output, '/localizer/c/pose')
    assert np.allclose([pose.position_xyz for pose in poses], [0.0, 4.0, 0.0])


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_two_runs_give_the_same_bytes(tmp_path, recorder, storage):
    recorder.write_triangle(range(10))
    recorder.write_triangle(range(10, 20), {**TRIANGLE, ('b', 'a'): 2.0, ('c', 'b'): 9.5})
    bag = recorder.close()
    params = tmp_path / 'params.yaml'
    given = {**PARAMETERS, 'max_outliers': 2}
    params.write_text(json.dumps({'/**': {'ros__parameters': given}}))
    contents = []
    for seed in ('1', '2'):
        folder = tmp_path / seed
        folder.mkdir()
        paths = ['-o', folder / 'out', '--params', params, '--report', folder / 'report.json']
        subprocess.run(
            [sys.executable, '-m', 'dg_localization.ros', 'localize_bag', bag, *paths]
            + ['--storage', storage, '--inputs'],
            cwd=REPOSITORY,
            check=True,
            capture_output=True,
            # The order of sets must not show.
            env={**os.environ, 'PYTHONHASHSEED': seed},
            timeout=120,
        )
        files = sorted(path for path in folder.rglob('*') if path.is_file())
        contents.append({path.relative_to(folder): path.read_bytes() for path in files})
    assert len(contents[0]) == 3
    assert contents[0] == contents[1]
    report = json.loads(contents[0][Path('report.json')])
    assert report['contradictions'], 'the bag is to contradict itself'


def test_outputs_are_offered_as_the_node_does(localize, triangle_bag):
    localize(triangle_bag)
    with AnyReader([localize.output]) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    (fleet,), (pose,) = offered['/localizer/feasible_poses'], offered['/localizer/a/pose']
    assert (fleet.durability.name, fleet.reliability.name) == ('TRANSIENT_LOCAL', 'RELIABLE')
    assert (pose.durability.name, pose.reliability.name) == ('VOLATILE', 'RELIABLE')


def test_inputs_are_copied_on_request(localize, triangle_bag):
    localize(triangle_bag, '--inputs', '--start', '0.95')
    assert read(localize.output, '/a/range/b')[0] == [
        START_NS + k * PERIOD_NS for k in range(10, 21)
    ]


def test_start_and_duration_choose_the_ticks(localize, triangle_bag):
    _, report = localize(triangle_bag, '--start', '0.5', '--duration', '0.7')
    times_ns, _ = read(localize.output, '/localizer/feasible_poses')
    assert times_ns == [START_NS + step * PERIOD_NS for step in (7, 9, 11)]
    assert report['start_s'] == 0.5 and report['end_s'] == pytest.approx(1.2)
    # What was measured before the start is not known.
    assert report['accepted'] == 7 * 3


def test_a_contradiction_is_reported_with_its_time(localize, recorder, capsys):
    recorder.write_triangle(range(10))
    recorder.write_triangle(range(10, 20), {('a', 'b'): 3.0, ('a', 'c'): 9.0, ('b', 'c'): 5.0})
    recorder.write_triangle(range(20, 41))
    code, report = localize(recorder.close())
    assert code == 0
    found = report['contradictions']
    # The wrong input contradicts itself while its eight newest readings are of both kinds.
    assert [run['conflicts'] for run in found] == [
        [['range a->c']],
        [['range a->b', 'range a->c', 'range b->c']],
        [['range a->c']],
    ]
    assert found[0]['first_s'] == pytest.approx(1.0) and found[2]['last_s'] == pytest.approx(2.6)
    assert sum(run['ticks'] for run in found) == report['ticks_by_verdict']['infeasible'] == 9
    assert '| 1.0 to ' in capsys.readouterr().out


def test_rejected_measurements_are_counted_by_reason(localize, recorder, capsys):
    recorder.write_triangle(range(11))
    for step in range(11):
        recorder.write('/b/range/a', step, range_message(0, 3.0))
        now_ns = START_NS + step * PERIOD_NS
        recorder.write('/c/range/a', step, range_message(now_ns, -1.0))
        recorder.write('/c/range/stranger', step, range_message(now_ns, 2.0))
    code, report = localize(recorder.close())
    assert code == 0 and report['accepted'] == 33
    assert report['rejected'] == {'negative': 11, 'unknown_robot': 11, 'zero_stamp': 11}
    by_name = {one['input']: one for one in report['inputs']}
    assert by_name['range a->b']['accepted'] == 11
    assert by_name['range c->a']['topics'] == ['/c/range/a']
    assert by_name['range c->a']['rejected'] == {'negative': 11}
    assert '-1' in by_name['range c->a']['last_rejection']
    told = capsys.readouterr().out
    assert 'range -1.0 m is negative' in told and "'stranger' is not one of" in told


def test_all_peers_of_a_robot_in_one_message_are_counted_once(localize, recorder):
    no_rays = np.full((2, 3), np.nan)
    for step in range(11):
        stamp_s = (START_NS + step * PERIOD_NS) * 1e-9
        for observer, peers, ranges_m in (('a', [1, 2], [3.0, 4.0]), ('b', [0, 2], [3.0, 5.0])):
            reading = PeersReading(stamp_s, np.array(peers), np.array(ranges_m), no_rays)
            data = serialize_message(adapter_for(POINT_CLOUD).to_message(reading))
            recorder.write(f'/{observer}/peers', step, data, POINT_CLOUD)
    code, report = localize(recorder.close())
    assert code == 0 and report['accepted'] == 44
    assert report['ticks_by_hypotheses'] == {'2': 5}
    by_name = {one['input']: one['accepted'] for one in report['inputs']}
    assert by_name['peers a'] == 22 and by_name['range a->b'] == 11


def test_answers_are_for_the_time_of_the_odometry_as_those_of_the_node(localize, recorder):
    late_ns = 60_000_000
    for step in range(21):
        recorder.write_triangle([step])
        for robot in 'abc':
            stamp_ns = START_NS + step * PERIOD_NS - late_ns
            data = odometry_at_rest(stamp_ns, f'{robot}/odom')
            recorder.write(f'/{robot}/odom', step, data, ODOMETRY)
    code, _ = localize(recorder.close())
    assert code == 0
    times_ns, values = read(localize.output, '/localizer/feasible_poses')
    assert len(times_ns) == 10
    assert [v.stamp_s for v in values] == pytest.approx(
        [(t - late_ns) * 1e-9 for t in times_ns], abs=1e-6
    )


def test_receive_times_replace_useless_stamps(localize, recorder):
    for step in range(11):
        for (observer, target), range_m in TRIANGLE.items():
            recorder.write(f'/{observer}/range/{target}', step, range_message(0, range_m))
    code, report = localize(recorder.close(), stamp_source='receive')
    assert code == 0 and report['accepted'] == 33 and report['rejected'] == {}


def test_links_and_remappings_work_as_for_the_node(localize, recorder):
    for step in range(11):
        for (observer, target), range_m in TRIANGLE.items():
            data = range_message(START_NS + step * PERIOD_NS, range_m)
            recorder.write(f'/site/{observer}{target}', step, data)
    links = [f'{a}{b} {RANGE} {a} {b}' for a, b in TRIANGLE]
    bag = recorder.close()
    ros_args = ('--ros-args', '-r', '__ns:=/site', '-p', 'reference_robot:=b')
    code, report = localize(bag, *ros_args, links=links)
    assert code == 0 and report['accepted'] == 33
    _, values = read(localize.output, '/site/localizer/feasible_poses')
    # The reference robot is at the origin.
    assert values[0].positions_m[1].tolist() == [0.0, 0.0, 0.0]
    _, (first, *_) = read(localize.output, '/diagnostics')
    assert first.statuses[0].name == 'site/localizer: fleet'


def test_what_is_missing_or_of_another_type_is_reported(localize, recorder):
    recorder.write_triangle(range(11))
    odd = STORE.serialize_cdr(TYPES['strange_msgs/msg/Odd'](1.0), 'strange_msgs/msg/Odd')
    recorder.write('/odd', 0, odd, 'strange_msgs/msg/Odd')
    links = [f'/missing {RANGE} a b', f'/odd {RANGE} b a']
    code, report = localize(recorder.close(), links=links)
    assert code == 0 and report['accepted'] == 22
    assert report['notices'] == [
        '/missing of the links is not in the bag',
        f'/odd is passed over: the link says {RANGE}, the bag strange_msgs/msg/Odd',
    ]
    _, (*_, last) = read(localize.output, '/diagnostics')
    missing = next(s for s in last.statuses if s.values.get('topic') == '/missing')
    assert missing.message == 'nothing received'


def test_types_that_are_not_installed_are_passed_over(localize, recorder):
    recorder.write_triangle(range(11))
    odd = STORE.serialize_cdr(TYPES['strange_msgs/msg/Odd'](1.0), 'strange_msgs/msg/Odd')
    recorder.write('/a/range/other', 0, odd, 'strange_msgs/msg/Odd')
    code, report = localize(recorder.close(), '--inputs')
    assert code == 0 and report['accepted'] == 33
    assert '/a/range/other' not in counts(localize.output)


def test_a_bag_without_inputs_is_refused(localize, triangle_bag, capsys):
    code, report = localize(triangle_bag, range__topic='/uwb/{observer}/{target}')
    assert (code, report) == (1, None)
    told = capsys.readouterr().err
    assert 'no topic of the bag is an input of this fleet: its points are a, b, c,' in told
    assert "'/uwb/{observer}/{target}'" in told and '/a/range/b' in told
    assert not localize.output.exists()


def test_a_bag_damaged_in_the_middle_gives_what_is_before(localize, tmp_path, capsys):
    recorder = Recorder(tmp_path / 'bag', StoragePlugin.SQLITE3)
    recorder.write_triangle(range(21))
    # One large message, whose pages the storage chains, holds the damage.
    recorder.write('/a/range/b', 21, range_message(START_NS, 3.0, 'x' * 40_000))
    recorder.write_triangle(range(22, 42))
    bag = recorder.close()
    (storage,) = bag.glob('*.db3')
    data = storage.read_bytes()
    page = (data.index(b'x' * 4000) // 4096 + 1) * 4096
    storage.write_bytes(data[:page] + bytes(8192) + data[page + 8192 :])
    code, report = localize(bag)
    assert code == 1 and report['ending'] == ''
    assert report['ticks'] == counts(localize.output)['/localizer/feasible_poses'] == 10
    assert any('what follows is not read' in text for text in report['damage'])
    assert 'The bag is damaged' in capsys.readouterr().out


@pytest.mark.parametrize('arguments', [('--start', '2.0'), ('--duration', '0.1')])
def test_less_than_a_tick_is_refused(localize, triangle_bag, arguments, capsys):
    assert localize(triangle_bag, *arguments) == (1, None)
    assert "there must be 0.2 s, one period of the parameter 'rate'" in capsys.readouterr().err
    assert not localize.output.exists()


@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        ({'max_sped': 1.0}, "parameter 'max_sped' is unknown; did you mean 'max_speed'?"),
        ({'dimension': 4}, "parameter 'dimension': 4 is not allowed, it must be an integer"),
        ({'rate': 'fast'}, "parameter 'rate': 'fast' is not allowed, it must be a number"),
        ({'links': ['/x']}, "parameter 'links': '/x' is not allowed"),
        ({'reference_robot': 'z'}, "'z'"),
    ],
)
def test_wrong_parameters_are_refused_as_by_the_node(
    localize, triangle_bag, parameters, reason, capsys
):
    assert localize(triangle_bag, **parameters) == (2, None)
    assert reason in capsys.readouterr().err
    assert not localize.output.exists()


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['--storage', 'zip'], "invalid choice: 'zip'"),
        (['--start', '-1'], "'-1' is not a number of at least 0 s"),
        (['--report', 'report.txt'], "'report.txt' must end in .json or .md"),
        (['--report', 'no/folder/report.md'], "there is no folder 'no/folder'"),
        (['--params', 'no.yaml'], "'no.yaml' is no file"),
        (['-o', 'config'], "'config' exists; name a folder that does not"),
    ],
)
def test_wrong_arguments_are_refused(localize, triangle_bag, arguments, reason, capsys):
    with pytest.raises(SystemExit) as ended:
        localize(triangle_bag, *arguments)
    assert ended.value.code == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize('arguments', [['-p'], ['--no-such-argument']])
def test_wrong_ros_arguments_are_refused(localize, triangle_bag, arguments, capsys):
    assert localize(triangle_bag, '--ros-args', *arguments) == (2, None)
    assert arguments[0] in capsys.readouterr().err


def test_without_rosbags_the_package_is_named(localize, triangle_bag, capsys, monkeypatch):
    monkeypatch.setattr(bag_module, 'find_spec', lambda name: None)
    assert localize(triangle_bag) == (1, None)
    assert 'pip install rosbags' in capsys.readouterr().err


def test_no_limit_depends_on_a_clock_of_the_machine():
    fleet = read_task(REPOSITORY / CONFIG, []).settings.fleet
    assert fleet.solver.max_seconds == fleet.max_conflict_seconds == float('inf')
    assert fleet.solver.tighten_seconds == float('inf')
    assert fleet.solver.max_boxes == 2000 and fleet.max_conflict_solves == 200


def test_messages_come_before_a_tick_at_the_same_time():
    messages = [BagMessage('/x', time_ns, b'') for time_ns in (0, 10**9, 2 * 10**9)]
    events = list(timeline(messages, 0, 2 * 10**9, rate_hz=2.0))
    times_s = [time_ns / 1e9 for time_ns, _, _ in events]
    assert times_s == [0.0, 0.5, 1.0, 1.0, 1.0, 1.5, 2.0, 2.0, 2.0]
    assert [event for _, event, _ in events[2:5]] == [Event.MESSAGE, Event.TICK, Event.DIAGNOSTICS]


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, '-m', 'dg_localization.ros', 'localize_bag', *map(str, arguments)],
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_a_readable_bag(tmp_path, recorder, number):
    recorder.write_triangle(range(10_000))
    params = tmp_path / 'params.yaml'
    params.write_text(json.dumps({'/**': {'ros__parameters': PARAMETERS}}))
    output = tmp_path / 'out'
    process = start(recorder.close(), '-o', output, '--params', params)
    (storage,) = wait_for(lambda: list(output.glob('*.mcap')))
    # Messages are written a megabyte at a time.
    wait_for(lambda: storage.stat().st_size > 100_000)
    process.send_signal(number)
    told, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert 'Traceback' not in errors and 'interrupted' in told
    times_ns, _ = read(output, '/localizer/feasible_poses')
    assert 0 < len(times_ns) < 5_000
    assert f'{len(times_ns)} ticks' in told


def test_compiling_is_shown_and_a_signal_ends_it(localize, triangle_bag, monkeypatch, capsys):
    def compile_for_minutes(report):
        report('compiling the solver: 1 of 9 kernels')
        signal.raise_signal(signal.SIGINT)
        raise AssertionError('it goes on')

    monkeypatch.setattr(localize_bag_module, 'warm_up', compile_for_minutes)
    assert localize(triangle_bag) == (130, None)
    told = capsys.readouterr().err
    assert 'compiling the solver: 1 of 9 kernels' in told
    assert 'interrupted; nothing is written' in told


def test_a_full_disk_is_named_with_what_was_written(localize, triangle_bag, monkeypatch, capsys):
    def full(writer, connection, time_ns, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Writer, 'write', full)
    assert localize(triangle_bag) == (1, None)
    told = capsys.readouterr().err
    assert f'{localize.output} cannot be written: No space left on device' in told


@pytest.mark.parametrize('kind', ['folder', 'yaml'])
def test_what_is_no_bag_is_told_what_one_is(localize, tmp_path, kind, capsys):
    path = tmp_path / 'no_bag.yaml'
    if kind == 'folder':
        path.mkdir()
    else:
        path.write_text('robots: []')
    assert localize(path) == (1, None)
    told = capsys.readouterr().err
    assert 'a bag is a folder with metadata.yaml, or a .db3 or .mcap file' in told
    assert 'reindex' not in told


def wait_for(condition, deadline_s=60.0):
    give_up_s = time.monotonic() + deadline_s
    while not (found := condition()):
        assert time.monotonic() < give_up_s
        time.sleep(0.02)
    return found


def test_a_report_for_a_person(tmp_path, triangle_bag, capsys):
    params, report = tmp_path / 'params.yaml', tmp_path / 'report.md'
    params.write_text(json.dumps({'/**': {'ros__parameters': PARAMETERS}}))
    paths = ('-o', tmp_path / 'out', '--params', params, '--report', report)
    assert localize_bag([str(text) for text in (triangle_bag, *paths)]) == 0
    text = report.read_text()
    assert '10 ticks at 5 Hz, from 0.0 to 2.0 s of the bag.' in text
    assert '| 2          | 10    |' in text
    assert '63 measurements were taken, 0 rejected.' in text
    told = capsys.readouterr().out
    assert told.startswith(text) and 'times real time' in told and 'real time' not in text


def test_unbounded_enclosures_are_reported(localize, recorder, capsys):
    recorder.write_triangle(range(11), {('a', 'b'): 3.0, ('b', 'c'): 5.0})
    _, report = localize(recorder.close())
    assert set(report['median_enclosure_width_m']) == set('abc')
    code, report = localize(recorder.path, robots=['a', 'b', 'c', 'd'])
    assert code == 0 and report['median_enclosure_width_m']['d'] is None
    assert '| d     | not bounded' in capsys.readouterr().out


def test_the_true_placement_is_in_every_answer(tmp_path, uwb_recording, capsys):
    paths = ('-o', tmp_path / 'out', '--params', REPOSITORY / CONFIG)
    truth = '--truth', '/vrpn_client_node/{robot}_cap/pose'
    assert localize_bag([str(text) for text in (uwb_recording.path, *paths, *truth)]) == 0
    _, scenes = read(tmp_path / 'out', '/localizer/markers')
    assert uwb_recording.check(scenes) == 75
    printed = capsys.readouterr().out
    assert '85 ticks at 5 Hz, from 0.0 to 17.2 s of the bag.' in printed
    assert 'The truth is inside a hypothesis in 85 of 85 answers.' in printed


def write_table(path, places, stamps_s):
    """Write a ground truth as a table; a place may be a function of the stamp."""
    rows = [
        f'{START_NS * 1e-9 + stamp_s:.3f},{robot},{x},{y}'
        for stamp_s in stamps_s
        for robot, (x, y) in places(stamp_s).items()
    ]
    path.write_text('\n'.join(['stamp,robot,x,y', *rows]) + '\n')
    return path


def test_answers_are_compared_with_a_table_of_the_truth(localize, triangle_bag, tmp_path, capsys):
    def places(stamp_s):
        # Robot c is elsewhere for a while, and nobody knows where at the end.
        c = {'c': (7.0, 9.0 if stamp_s < 0.95 else 9.5)} if stamp_s < 1.45 else {}
        return {'a': (7.0, 5.0), 'b': (10.0, 5.0), **c}

    table = write_table(tmp_path / 'truth.csv', places, np.arange(0.0, 2.2, 0.1))
    code, report = localize(triangle_bag, '--truth', table, max_speed=0.0)
    truth = report['truth']
    # In the last answers the distance of a and b is compared.
    assert code == 0 and truth['compared'] == report['ticks'] == 10
    assert truth['held'] == 7 and truth['unlisted'] == 0
    (missed,) = truth['missed']
    assert missed['ticks'] == 3 and missed['robots'] == ['c']
    assert (missed['first_s'], missed['last_s']) == pytest.approx((1.0, 1.4))
    assert truth['errors']['c']['point_m']['percentile_95'] == pytest.approx(0.5, abs=1e-3)
    assert truth['errors']['c']['point_m']['median'] == pytest.approx(0.0, abs=1e-3)
    printed = capsys.readouterr().out
    assert 'The truth is inside a hypothesis in 7 of 10 answers.' in printed
    assert '| 1.0 to 1.4 s (3 ticks) | c  |' in printed
    assert '| c     | 0.00 m (0.50)' in printed


def test_what_cannot_be_compared_is_said(localize, triangle_bag, tmp_path, capsys):
    table = write_table(tmp_path / 'truth.csv', lambda _: {'a': (0.0, 0.0)}, [1e6])
    code, report = localize(triangle_bag, '--truth', table)
    assert code == 0 and report['truth']['compared'] == 0
    printed = capsys.readouterr().out
    assert 'No answer has a ground truth at its time.' in printed
    assert 'There is no ground truth of b, c.' in printed
    others = write_table(tmp_path / 'others.csv', lambda _: {'A': (0.0, 0.0)}, [1e6])
    assert localize(triangle_bag, '--truth', others) == (2, None)
    assert 'is the truth of A; the robots are a, b, c' in capsys.readouterr().err
    code, _ = localize(triangle_bag, '--truth', '/nowhere/{robot}')
    assert code == 1
    assert 'no topic /nowhere/a or /nowhere/b or /nowhere/c' in capsys.readouterr().err
    assert not localize.output.exists()


def test_hypotheses_that_are_not_listed_are_not_called_wrong(localize, recorder, tmp_path, capsys):
    """Two triangles on one edge, and the truth is the hypothesis that is left out."""
    across = 2.0 * 3.0 * 4.0 / 5.0
    shape = {**TRIANGLE, ('b', 'd'): 3.0, ('c', 'd'): 4.0}
    recorder.write_triangle(range(11), {**shape, ('a', 'd'): across})
    places = {'a': (0.0, 0.0), 'b': (3.0, 0.0), 'c': (0.0, 4.0), 'd': (0.0, 0.0)}
    places['d'] = tuple(across / 5.0 * np.array([4.0, 3.0]))
    table = write_table(tmp_path / 'truth.csv', lambda _: places, np.arange(0.0, 1.2, 0.1))
    bag, robots = recorder.close(), list('abcd')
    _, report = localize(bag, '--truth', table, robots=robots, max_speed=0.0)
    assert report['truth']['held'] == report['truth']['compared'] == report['ticks']
    _, report = localize(bag, '--truth', table, robots=robots, max_speed=0.0, max_hypotheses=1)
    truth = report['truth']
    assert truth['held'] + truth['unlisted'] == report['ticks'] and not truth['missed']


def test_a_bag_is_drawn(localize, triangle_bag, tmp_path, capsys):
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")
    places = {'a': (7.0, 5.0), 'b': (10.0, 5.0), 'c': (7.0, 9.0)}
    table = write_table(tmp_path / 'truth.csv', lambda _: places, np.arange(0.0, 2.2, 0.1))
    path = tmp_path / 'picture.png'
    code, report = localize(triangle_bag, '--plot', path, '--truth', table)
    assert code == 0 and report['ticks'] == 10
    assert path.read_bytes().startswith(b'\x89PNG')
    path.unlink()
    path.mkdir()
    code, report = localize(triangle_bag, '--plot', path)
    assert code == 1 and report['ticks'] == 10
    assert 'picture.png cannot be written' in capsys.readouterr().err


def test_a_report_is_one_page(triangle_bag, tmp_path):
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")
    places = {'a': (7.0, 5.0), 'b': (10.0, 5.0), 'c': (7.0, 9.0)}
    table = write_table(tmp_path / 'truth.csv', lambda _: places, np.arange(0.0, 2.2, 0.1))
    params, page = tmp_path / 'params.yaml', tmp_path / 'answers.html'
    params.write_text(json.dumps({'/**': {'ros__parameters': PARAMETERS}}))
    arguments = [triangle_bag, '-o', tmp_path / 'out', '--params', params, '--report', page]
    assert localize_bag([str(one) for one in (*arguments, '--truth', table)]) == 0
    text = page.read_text()
    assert 'Of 10 answers 0 have one hypothesis' in text
    assert 'the truth is inside in 10 of 10 answers compared.' in text
    assert text.count('<svg') == 1 and '<td>range a-&gt;b</td>' in text
    # Nothing is loaded from elsewhere.
    assert not re.search(r'(src|href)="(?!#)', text.replace('xlink:href="#', ''))
    assert [tag for tag in ('<script', '<link', '@import') if tag in text] == []


def test_what_cannot_be_drawn_is_said_first(localize, triangle_bag, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        localize(triangle_bag, '--plot', tmp_path / 'picture.jpeg')
    assert "picture.jpeg' must end in .png or .svg or .pdf" in capsys.readouterr().err
    monkeypatch.setattr(picture, 'find_spec', lambda name: None)
    code, report = localize(triangle_bag, '--plot', tmp_path / 'picture.png')
    assert code == 1 and report is None and not localize.output.exists()
    assert '--report FILE.html need matplotlib' in capsys.readouterr().err


@pytest.mark.parametrize('streams', ['closed', 'broken'])
def test_without_a_terminal_no_answer_is_lost(tmp_path, triangle_bag, streams):
    params, output = tmp_path / 'params.yaml', tmp_path / 'out'
    params.write_text(json.dumps({'/**': {'ros__parameters': PARAMETERS}}))
    report = tmp_path / 'report.json'
    command = [sys.executable, '-m', 'dg_localization.ros', 'localize_bag', triangle_bag]
    command += ['-o', output, '--params', params, '--report', report]
    text = shlex.join(map(str, command))
    # A pipe whose reader is gone, or no file at all under the numbers of the streams.
    text += ' >&- 2>&-' if streams == 'closed' else ' > >(true) 2> >(true)'
    ended = subprocess.run(['bash', '-c', text], cwd=REPOSITORY, timeout=120, check=False)
    assert ended.returncode == 0
    assert json.loads(report.read_text())['ticks'] == 10
    assert counts(output)['/localizer/feasible_poses'] == 10


def test_a_full_disk_under_the_printed_report_keeps_the_answers(tmp_path, triangle_bag):
    params, output = tmp_path / 'params.yaml', tmp_path / 'out'
    params.write_text(json.dumps({'/**': {'ros__parameters': PARAMETERS}}))
    with open('/dev/full', 'w') as full:
        ended = subprocess.run(
            [sys.executable, '-m', 'dg_localization.ros', 'localize_bag', triangle_bag]
            + ['-o', output, '--params', params],
            cwd=REPOSITORY,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    assert ended.returncode == 1
    assert 'No space left on device' in ended.stderr and 'Traceback' not in ended.stderr
    assert counts(output)['/localizer/feasible_poses'] == 10


def test_an_error_keeps_the_answers_before_it(localize, triangle_bag, monkeypatch):
    tick = BagLocalizer.tick

    def fails_late(self, time_ns, cancel):
        if time_ns > START_NS + 10 * PERIOD_NS:
            raise MemoryError
        return tick(self, time_ns, cancel)

    monkeypatch.setattr(BagLocalizer, 'tick', fails_late)
    with pytest.raises(MemoryError):
        localize(triangle_bag)
    assert counts(localize.output)['/localizer/feasible_poses'] == 5


def test_a_damaged_first_message_is_counted_and_its_topic_is_read(localize, recorder):
    recorder.write('/b/range/a', 0, b'\x00\x01\x00\x00damaged')
    recorder.write_triangle(range(11))
    for step in range(1, 11):
        recorder.write('/b/range/a', step, range_message(START_NS + step * PERIOD_NS, 3.0))
    code, report = localize(recorder.close())
    assert code == 0 and report['accepted'] == 43 and report['damage'] == []
    assert sum(report['rejected'].values()) == 1


def test_a_topic_of_which_nothing_can_be_read_is_damage(localize, recorder, capsys):
    recorder.write_triangle(range(11))
    for step in range(11):
        recorder.write('/b/range/a', step, b'\x00\x01\x00\x00damaged')
    code, report = localize(recorder.close())
    assert code == 1 and report['accepted'] == 33 and report['ticks'] == 5
    assert '/b/range/a' in report['damage'][0]
    assert 'The bag is damaged:' in capsys.readouterr().out


def test_a_topic_of_another_type_than_its_name_says_is_reported(localize, recorder):
    recorder.write_triangle(range(11))
    odd = STORE.serialize_cdr(TYPES['strange_msgs/msg/Odd'](1.0), 'strange_msgs/msg/Odd')
    recorder.write('/b/range/a', 0, odd, 'strange_msgs/msg/Odd')
    code, report = localize(recorder.close())
    assert code == 0 and report['notices'] == [
        f'/b/range/a is passed over: its name says {RANGE}, the bag strange_msgs/msg/Odd'
    ]


@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_a_bag_without_messages_is_refused_with_a_sentence(localize, tmp_path, plugin, capsys):
    with Writer(tmp_path / 'bag', version=9, storage_plugin=plugin) as writer:
        writer.add_connection('/a/range/b', RANGE, typestore=STORE)
    assert localize(tmp_path / 'bag') == (1, None)
    assert 'it has no messages' in capsys.readouterr().err


@pytest.mark.parametrize('time_ns', [-1, START_NS + 10**18, 2**63 - 1])
def test_a_damaged_time_does_not_make_a_bag_of_centuries(localize, tmp_path, time_ns, capsys):
    recorder = Recorder(tmp_path / 'bag', StoragePlugin.SQLITE3)
    recorder.write_triangle(range(11))
    (storage,) = recorder.close().glob('*.db3')
    with sqlite3.connect(storage) as base:
        base.execute('UPDATE messages SET timestamp = ? WHERE id = 5', [time_ns])
    code, report = localize(recorder.path)
    assert code == 1 and report['ticks'] == 5
    assert 'receive times of 1 messages are no times of ROS' in capsys.readouterr().out


def test_the_report_says_when_the_budget_ended_the_search(localize, recorder, capsys):
    ranges_m = {
        ('a', 'b'): 3.0,
        ('a', 'c'): 4.0,
        ('b', 'c'): 5.0,
        ('b', 'd'): 3.0,
        ('c', 'd'): 4.0,
    }
    recorder.write_triangle(range(11), ranges_m)
    given = {'robots': ['a', 'b', 'c', 'd'], 'solver__max_boxes': 1}
    code, report = localize(recorder.close(), **given)
    assert code == 0 and report['max_boxes'] == 1
    assert report['ticks_by_verdict'] == {'out_of_budget': 5}
    told = capsys.readouterr().out
    assert 'The search of 5 ticks ended at solver.max_boxes, 1 boxes' in told


def test_one_long_answer_shows_signs_of_life(localize, triangle_bag, capsys, monkeypatch):
    tick = BagLocalizer.tick

    def slow_once(self, time_ns, cancel):
        if time_ns == START_NS + 4 * PERIOD_NS:
            time.sleep(0.5)
        return tick(self, time_ns, cancel)

    monkeypatch.setattr(BagLocalizer, 'tick', slow_once)
    monkeypatch.setattr(localize_bag_module, 'LINE_PERIOD_S', 0.2)
    code, _ = localize(triangle_bag)
    told = capsys.readouterr().err
    assert code == 0
    assert 'for the answer at 0.4 s' in told
    assert 'the slowest answer, at 0.4 s of the bag, took' in told


def test_the_report_says_what_was_forgotten_and_when():
    why = 'what r1 and the anchors measured more than 3 s ago contradicts what they measured since'
    forgotten = Forgotten(frozenset({('r1', 'a')}), 7.0, why)
    tally = Tally(('r1',))
    tally.add(Estimate(10.0, ('r1',), None, ''), 1.0)
    tally.add(Estimate(12.0, ('r1',), None, '', forgotten=(forgotten,)), 3.0)
    assert [(run.first_s, run.what) for run in tally.forgotten] == [(3.0, why)]
    report = BagReport('bag', 0.0, 3.0, 1.0, '', tally, [], {}, {}, {}, (), (), True, 1)
    text = as_markdown(report)
    assert why in text
    # One of a moment with what was before was found.
    assert 'No measurements of one moment were found to contradict each other.' in text


DAY_NS = 86_400 * 10**9


@pytest.mark.parametrize('step', [0, 15, 30], ids=['first', 'in the middle', 'last'])
@pytest.mark.parametrize('days', [-3, 3], ids=['early', 'late'])
def test_a_gap_of_days_is_named_and_skipped(localize, recorder, step, days, capsys):
    """One message was received days before or after all others, wherever it is in the file."""
    recorder.write_triangle(range(step))
    stray = step + days * DAY_NS // PERIOD_NS
    recorder.write('/a/range/b', stray, range_message(START_NS + step * PERIOD_NS, 3.0))
    recorder.write_triangle(range(step, 31))
    code, report = localize(recorder.close())
    assert 15 <= report['ticks'] <= 15 + 50 + 1
    (gap,) = report['gaps']
    assert gap['last_s'] - gap['first_s'] == pytest.approx(3 * 86_400, abs=60)
    told = capsys.readouterr().out
    assert 'Nothing was received from' in told and '3.0 days' in told
    # A time that goes back within the file is damage.
    in_order = step == 0 and days < 0
    assert any('receive times go back' in text for text in report['damage']) != in_order
    assert code == (0 if not report['damage'] else 1)


BROKEN = {
    'no storage': ('storage_identifier: mcap', 'storage_identifier: ""'),
    'a version to come': ('version: 9', 'version: 10'),
    'no number': ('version: 9', 'version: x'),
    'another file': ('bag.mcap', 'other.mcap'),
    'no YAML': ('rosbag2_bagfile_information:', '{{{'),
}


@pytest.mark.parametrize('change', BROKEN.values(), ids=BROKEN)
def test_a_bag_with_broken_metadata_is_read(localize, triangle_bag, change):
    path = triangle_bag / 'metadata.yaml'
    before = path.read_text()
    path.write_text(before.replace(*change))
    assert path.read_text() != before
    _, report = localize(triangle_bag)
    assert report['ticks'] == 10 and report['accepted'] == 63


def test_what_was_latched_before_the_start_counts(recorder):
    latched = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        QosTime(0, 0),
        QosTime(0, 0),
        QosLiveliness.AUTOMATIC,
        QosTime(0, 0),
        False,
    )
    with Writer(recorder.path.with_name('latched'), version=9) as writer:
        topics = {
            name: writer.add_connection(name, RANGE, typestore=STORE, offered_qos_profiles=qos)
            for name, qos in (('/latched', [latched]), ('/volatile', []))
        }
        for step in range(10):
            for name, range_m in (('/latched', 1.0 + step), ('/volatile', 1.0)):
                if name == '/volatile' or step in (1, 3, 7):
                    time_ns = START_NS + step * PERIOD_NS
                    writer.write(topics[name], time_ns, range_message(time_ns, range_m))
    bag = bag_module.Bag(recorder.path.with_name('latched'))
    read = list(Reading(bag).messages(0.5))
    assert [message.topic for message in read[:2]] == ['/latched', '/volatile']
    assert read[0].time_ns == bag.start_ns + 5 * PERIOD_NS
    assert len(read) == 1 + 5 + 1
    # The last one before the start, of 0.3 s.
    assert read[0].data == bytes(range_message(START_NS + 3 * PERIOD_NS, 4.0))


def test_topics_whose_definitions_cannot_be_parsed_are_passed_over(localize, tmp_path):
    """As those of service introspection, whose definition is that of a service."""
    with (tmp_path / 'bag.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start(profile='ros2')
        text = 'int32 x\n---\n=== bad ===\nint32 y'
        kinds = {
            '/a/range/b': (RANGE, STORE.generate_msgdef(RANGE, ros_version=2)[0]),
            # Some converters leave out the folder.
            '/a/range/c': ('sensor_msgs/Range', STORE.generate_msgdef(RANGE, ros_version=2)[0]),
            # A definition of a known type that is damaged.
            '/b/range/c': (RANGE, text),
            '/x/_service_event': ('std_srvs/srv/Trigger_Event', text),
        }
        for topic, (type_name, definition) in kinds.items():
            schema = writer.register_schema(type_name, 'ros2msg', definition.encode())
            channel = writer.register_channel(topic, 'cdr', schema)
            for step in range(11):
                time_ns = START_NS + step * PERIOD_NS
                pair = topic[1], topic[-1]
                data = bytes(range_message(time_ns, TRIANGLE.get(pair, 1.0)))
                writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()
    code, report = localize(tmp_path / 'bag.mcap')
    assert code == 0 and report['accepted'] == 33 and report['damage'] == []


@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_a_file_that_is_compressed_as_a_whole_is_read(localize, tmp_path, plugin):
    recorder = Recorder(tmp_path / 'bag', plugin)
    recorder.write_triangle(range(21))
    bag = recorder.close()
    (storage,) = (path for path in bag.iterdir() if path.suffix != '.yaml')
    packed = tmp_path / f'{storage.name}.zstd'
    packed.write_bytes(zstandard.compress(storage.read_bytes()))
    code, report = localize(packed)
    assert code == 0 and report['ticks'] == 10 and report['damage'] == []
    packed.write_bytes(packed.read_bytes()[:100])
    assert localize(packed) == (1, None)


def test_a_database_of_eloquent_is_read(localize, tmp_path):
    """It has neither profiles nor definitions, and Range has no variance."""
    recorder = Recorder(tmp_path / 'bag', StoragePlugin.SQLITE3)
    recorder.write_triangle(range(21))
    (storage,) = recorder.close().glob('*.db3')
    with sqlite3.connect(storage) as base:
        for table in ('schema', 'metadata', 'message_definitions'):
            base.execute(f'DROP TABLE {table}')
        for column in ('offered_qos_profiles', 'type_description_hash'):
            base.execute(f'ALTER TABLE topics DROP COLUMN {column}')
        base.execute('UPDATE messages SET data = substr(data, 1, length(data) - 4)')
    code, report = localize(storage)
    assert code == 0 and report['accepted'] == 63


def test_the_report_has_the_reasons_of_the_node_once(localize, recorder, capsys):
    recorder.write_triangle(range(11))
    for step in range(11):
        recorder.write('/b/range/a', step, range_message(START_NS + step * PERIOD_NS, math.nan))
    code, report = localize(recorder.close())
    printed = capsys.readouterr().out
    assert code == 0
    rows = [line for line in printed.splitlines() if 'nothing acceptable received' in line]
    assert len(rows) == 1 and '(5 ticks)' in rows[0]
    assert any(run['status'] == 'input range b->a' for run in report['said'])
