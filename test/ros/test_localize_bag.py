# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `localize_bag`: small bags written here, and the real UWB recording."""

import json
import math
import os
from pathlib import Path
import re
import signal
import subprocess

import numpy as np
import pytest

pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")

from nav_msgs.msg import Odometry  # noqa: E402
from processes import PIPES, start, wait_for  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from small_bags import (  # noqa: E402
    ODD,
    ODD_MESSAGE,
    ODOMETRY,
    PERIOD_NS,
    RANGE,
    START_NS,
    TRIANGLE,
    counts,
    range_message,
    read,
    stamped,
    write_parameters,
    write_table,
)
from uwb_recording import CONFIG  # noqa: E402

from dg_localization.ros.bags.offline import BagLocalizer, read_task  # noqa: E402
from dg_localization.ros.executables import localize_bag  # noqa: E402
from msg_adapters import ElevationReading, Level, adapter_for  # noqa: E402

REPOSITORY = Path(__file__).parents[2]
ELEVATION = 'geometry_msgs/msg/PointStamped'


def test_elevations_of_a_recording_are_read(recorder, localize):
    """The true depth of a is 1 m; up to 2.9 m is stated."""
    for step in range(11):
        time_ns = START_NS + step * PERIOD_NS
        reading = ElevationReading(time_ns * 1e-9, -1.0)
        message = adapter_for(ELEVATION).to_message(reading)
        recorder.write('/a/depth', step, serialize_message(message), ELEVATION)
        recorder.write_triangle([step])
    given = {'elevations__names': ['a'], 'elevations__a': [-2.9, 0.0]}
    code, report = localize(recorder.close(), elevation__topic='{observer}/depth', **given)
    assert code == 0 and not report['rejected']
    assert report['accepted'] == 44
    _, (*_, last) = read(localize.output, '/diagnostics')
    by_name = {status.name: status for status in last.statuses}
    assert by_name['localizer: input elevation a'].values['accepted'] == '11'
    assert by_name['localizer: fleet'].values['inputs_in_use'] == '4'


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


def test_start_and_duration_choose_the_ticks(localize, triangle_bag):
    _, report = localize(triangle_bag, '--start', '0.5', '--duration', '0.7')
    times_ns, _ = read(localize.output, '/localizer/feasible_poses')
    assert times_ns == [START_NS + step * PERIOD_NS for step in (7, 9, 11)]
    assert report['start_s'] == 0.5 and report['end_s'] == pytest.approx(1.2)
    # What was measured before the start is not known.
    assert report['accepted'] == 7 * 3


def test_a_contradiction_is_reported_with_its_time(localize, recorder, capsys):
    recorder.write_triangle(range(10))
    recorder.write_triangle(range(10, 20), {**TRIANGLE, ('a', 'c'): 9.0})
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


def test_answers_are_for_the_time_of_the_odometry_as_those_of_the_node(localize, recorder):
    late_ns = 60_000_000
    for step in range(21):
        recorder.write_triangle([step])
        for robot in 'abc':
            stamp_ns = START_NS + step * PERIOD_NS - late_ns
            data = stamped(Odometry(), stamp_ns, f'{robot}/odom')
            recorder.write(f'/{robot}/odom', step, data, ODOMETRY)
    code, _ = localize(recorder.close())
    assert code == 0
    times_ns, values = read(localize.output, '/localizer/feasible_poses')
    assert len(times_ns) == 10
    assert [v.stamp_s for v in values] == pytest.approx(
        [(t - late_ns) * 1e-9 for t in times_ns], abs=1e-6
    )


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
    recorder.write('/odd', 0, ODD_MESSAGE, ODD)
    links = [f'/missing {RANGE} a b', f'/odd {RANGE} b a']
    code, report = localize(recorder.close(), links=links)
    assert code == 0 and report['accepted'] == 22
    assert report['notices'] == [
        '/missing of the links is not in the bag',
        f'/odd is passed over: the link says {RANGE}, the bag {ODD}',
    ]
    _, (*_, last) = read(localize.output, '/diagnostics')
    missing = next(s for s in last.statuses if s.values.get('topic') == '/missing')
    assert missing.message == 'nothing received'


UNHEARD = {'range__topic': '/uwb/{observer}/{target}'}
SHORT = "there must be 0.2 s, one period of 'rate'"


@pytest.mark.parametrize(
    ('arguments', 'parameters', 'code', 'reason'),
    [
        ((), UNHEARD, 1, 'no topic of the bag is an input of a, b, c by'),
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
    fleet = read_task(REPOSITORY / CONFIG, []).settings.fleet
    assert fleet.solver.max_seconds == fleet.max_conflict_seconds == float('inf')
    assert fleet.solver.tighten_seconds == float('inf')
    assert fleet.solver.max_boxes == 2000 and fleet.max_conflict_solves == 200


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_a_readable_bag(tmp_path, recorder, number):
    recorder.write_triangle(range(4_000))
    output = tmp_path / 'out'
    paths = recorder.close(), '-o', output, '--params', write_parameters(tmp_path)
    process = start('localize_bag', *paths, **PIPES)
    (storage,) = wait_for(lambda: list(output.glob('*.mcap')))
    # Messages are written a megabyte at a time.
    wait_for(lambda: storage.stat().st_size > 100_000)
    process.send_signal(number)
    told, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert 'Traceback' not in errors and 'interrupted' in told
    times_ns, _ = read(output, '/localizer/feasible_poses')
    assert 0 < len(times_ns) < 2_000
    assert f'{len(times_ns)} ticks' in told


def test_the_table_of_ranges_in_the_docs_is_localized(tmp_path, monkeypatch):
    page = (REPOSITORY / 'docs/bags.md').read_text(encoding='utf-8')
    (code,) = re.findall(r'```python\n(.*?)```', page, re.DOTALL)
    rows = [f'{10.0 + 0.1 * k},{o},{t},{d}' for k in range(20) for (o, t), d in TRIANGLE.items()]
    monkeypatch.chdir(tmp_path)
    Path('ranges.csv').write_text('\n'.join(['stamp,observer,target,range', *rows]))
    Path('my_bag.yaml').write_text("/**: {ros__parameters: {robots: ['a', 'b', 'c']}}")
    exec(compile(code, 'bags.md', 'exec'), {})
    paths = 'my_bag', '-o', 'answers', '--params', 'my_bag.yaml', '--report', 'report.json'
    assert localize_bag(list(paths)) == 0
    report = json.loads(Path('report.json').read_text())
    assert report['ticks_by_hypotheses'] == {'2': report['ticks']}


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
    assert truth['errors']['c']['point_m']['percentile_95'] == pytest.approx(0.5, abs=1e-3)
    assert truth['errors']['c']['point_m']['median'] == pytest.approx(0.0, abs=1e-3)
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
    assert 'Traceback' not in errors
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


def test_the_report_says_when_the_budget_ended_the_search(localize, recorder, capsys):
    ranges_m = {**TRIANGLE, ('b', 'd'): 3.0, ('c', 'd'): 4.0}
    recorder.write_triangle(range(11), ranges_m)
    given = {'robots': ['a', 'b', 'c', 'd'], 'solver__max_boxes': 1}
    code, report = localize(recorder.close(), **given)
    assert code == 0 and report['max_boxes'] == 1
    assert report['ticks_by_verdict'] == {'out_of_budget': 5}
    told = capsys.readouterr().out
    assert 'The search of 5 ticks ended at solver.max_boxes, 1 boxes' in told


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
