# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The truth beside the answers to a bag: as people have it, damaged, or half known."""

from collections import defaultdict
from dataclasses import replace
from types import SimpleNamespace

from estimates import placement_at
from geometry_msgs.msg import PoseStamped
import numpy as np
import pytest
from small_bags import PLACES, POSE, START_NS, TRIANGLE, stamped, time_ns_of

from dg_localization.calibration.truth import FleetTruth, TrueTrack
from dg_localization.fleet import Estimate, FixedFrame, FleetConfig, FrameKind, Group
from dg_localization.fleet.rotations import quaternion_of_euler
from dg_localization.ros.bags.truth import Poses, read_table
from dg_localization.ros.bags.truth_tally import TruthTally
from dg_localization.ros.executables import UsageError

TRUTH = '--truth', '/{robot}/truth'


def write_truth(recording, robots, steps):
    for step in steps:
        for robot in robots:
            message = PoseStamped()
            message.pose.position.x, message.pose.position.y = PLACES[robot]
            recording.write(f'/{robot}/truth', step, stamped(message, time_ns_of(step)), POSE)


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
    count = '1 messages of the ground truth could not be read'
    assert count in report['notices'] and count in capsys.readouterr().out


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


def test_answers_between_samples_that_are_far_apart_are_counted(recorder, localize, capsys):
    recorder.write_triangle(range(41))
    write_truth(recorder, 'abc', (*range(11), *range(31, 41)))
    code, report = localize(recorder.close(), *TRUTH)
    truth, printed = report['truth'], capsys.readouterr().out
    assert code == 0 and truth['held'] == truth['compared'] == 10
    assert '10 answers have no ground truth at their time' in printed
    assert 'more than 1 s apart' in printed


def read_truth_file(path, robots, dimension):
    poses: Poses = defaultdict(list)
    read_table(path, robots, dimension, poses)
    return poses


TILTED, QUATERNION = quaternion_of_euler(0.1, -0.2, 0.5), 'stamp,robot,x,y,z,qx,qy,qz,qw\n1,a,2,3,'
EUROC = '#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []'


@pytest.mark.parametrize(
    ('dimension', 'table', 'turn'),
    [
        (2, 'stamp,robot,x,y,yaw\n1,a,2,3,0.5\n', quaternion_of_euler(0.0, 0.0, 0.5)),
        (2, 'stamp,robot,x,y\n1,a,2,3\n', None),
        (2, 'stamp,robot,x,y,z\n1,a,2,3,\n', None),
        *((q, f'{QUATERNION}0,{",".join(map(str, TILTED))}\n', TILTED) for q in (2, 3)),
        *((q, f'{QUATERNION}0,,,,\n', None) for q in (2, 3)),
        (2, 'stamp,robot,x,y,p_std_x,t_max\n1,a,2,3,9,9\n', None),
        (2, f'{EUROC}\n1,2,3,0,{",".join(map(str, np.roll(TILTED, 1)))}\n', TILTED),
    ],
)
def test_a_table_tells_what_is_known(tmp_path, dimension, table, turn):
    path = tmp_path / 'truth.csv'
    path.write_text(table)
    ((_, place_m, found),) = read_truth_file(path, ['a'], dimension)['a']
    assert place_m.tolist() == [2.0, 3.0, 0.0]
    assert not np.isfinite(found).all() if turn is None else found == pytest.approx(turn)


@pytest.mark.parametrize(
    ('dimension', 'table', 'wanted'),
    [
        (3, 'stamp,robot,x,y,z,qx,qy,qz\n1.0,a,2.0,3.0,4.0,0,0,0\n', 'has no column qw'),
        (3, 'stamp,robot,x,y,z,qx,qy,qz,qw\n1.0,a,2.0,3.0,4.0,0,0,0,inf\n', 'line 2: no position'),
        (3, 'stamp,x,y,z,robot\n1.0,2.0,3.0,4.0,\n', 'line 2: it names no robot'),
        (3, 'stamp,robot,x,y\n1.0,a,2.0,3.0\n', 'has no column z'),
        (2, 'stamp,lat,lon,z,roll,pitch,yaw,v\n1,2,3,4,5,6,7,8\n', 'has no column x, y'),
        (2, 'stamp,robot,x,y\n1.0,a,2.0,3.0\n'.encode('utf-16'), 'no table in UTF-8'),
        (2, 'stamp,robot,x,y\n1.0,a,' + '9' * 200_000 + ',3.0\n', 'line 2: no position'),
        (2, 'stamp,robot,x,y\n1.0,A,2.0,3.0\n', 'is the truth of A; the robots are a'),
    ],
)
def test_what_is_wrong_in_a_table_is_named(tmp_path, dimension, table, wanted):
    path = tmp_path / 'truth.csv'
    path.write_bytes(table if isinstance(table, bytes) else table.encode())
    with pytest.raises(UsageError, match=wanted):
        read_truth_file(path, ['a'], dimension)


def test_the_report_says_that_a_table_tells_no_orientation_in_space(
    triangle_bag, localize, tmp_path, capsys
):
    path = tmp_path / 'truth.csv'
    row = f'{START_NS * 1e-9:.3f},a,0.0,0.0,0.0,0.0'
    path.write_text(f'stamp,robot,x,y,z,yaw\n{row}\n')
    _, report = localize(triangle_bag, '--truth', path)
    assert report['notices'] == []
    _, report = localize(triangle_bag, '--truth', path, dimension=3)
    (notice,) = report['notices']
    assert 'truth.csv: no orientation in space' in notice and 'qx, qy, qz and qw' in notice
    assert notice in capsys.readouterr().out


ROWS = [(START_NS // 10**9 + step / 10, robot) for step in range(21) for robot in 'abc']
TABLES = {
    'blanks after commas': ('truth.csv', 'stamp, robot, x, y', '{t:.3f}, {r}, {x}, {y}'),
    'units, an index': ('truth.csv', ',stamp [s],robot,x [m],y [m]', '7,{t:.3f},{r},{x},{y}'),
    'semicolons': ('truth.csv', 'stamp;robot;x;y', '{t:.3f};{r};{x};{y}'),
    'capitals': ('TRUTH.CSV', 'Time,Robot,X,Y', '{t:.3f},{r},{x},{y}'),
    'nanoseconds': ('truth.csv', 'timestamp,robot,x,y', '{t:.1f}e9,{r},{x},{y}'),
    'milliseconds': ('truth.csv', 'stamp,robot,x,y', '{t:.1f}e3,{r},{x},{y}'),
    'blanks': ('truth.txt', '# stamp robot x y', '{t:.3f} {r} {x} {y}'),
}


@pytest.mark.parametrize('name', TABLES)
def test_tables_as_people_have_them_are_read(triangle_bag, localize, tmp_path, name):
    file, header, row = TABLES[name]
    rows = [row.format(t=t, r=r, x=PLACES[r][0], y=PLACES[r][1]) for t, r in ROWS]
    (tmp_path / file).write_text('\n'.join([header, *rows]))
    code, report = localize(triangle_bag, '--truth', tmp_path / file)
    assert code == 0 and report['truth']['compared'] == report['ticks'] == 10
    unit = [text for text in report['notices'] if 'in seconds' in text]
    assert len(unit) == name.endswith('seconds') and all(name in text for text in unit)


def test_trajectories_of_tum_are_read_one_of_each_robot(triangle_bag, localize, tmp_path):
    for robot, (x, y) in PLACES.items():
        rows = [f'{t:.3f} {x} {y} 0 0 0 0 1' for t, r in ROWS if r == robot]
        (tmp_path / f'{robot}.tum').write_text('\n'.join(['# a remark', '#', *rows]))
    code, report = localize(triangle_bag, '--truth', tmp_path / '{robot}.tum')
    assert code == 0 and report['truth']['compared'] == 10
    assert localize(triangle_bag, '--truth', tmp_path / 'a.tum') == (2, None)


def test_times_that_do_not_meet_are_explained(triangle_bag, localize, tmp_path, capsys):
    path = tmp_path / 'truth.csv'
    zero = [f'{(t - START_NS // 10**9):.3f},{r},0,0' for t, r in ROWS]
    other = [f'{t + 3600.0:.3f},{r},0,0' for t, r in ROWS]
    for rows, hint in ((zero, 'counted from zero'), (other, 's apart')):
        path.write_text('\n'.join(['stamp,robot,x,y', *rows]))
        _, report = localize(triangle_bag, '--truth', path)
        assert report['truth']['compared'] == 0
        printed = capsys.readouterr().out
        assert 'must be in seconds' in printed and hint in printed
        assert f'{START_NS / 10**9 + 0.2:.3f} to' in printed


ROBOTS = ('r1', 'r2', 'r3', 'r4')
TRUE_PLACES = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0), 'r3': (10.0, 0.0), 'r4': (10.0, 3.0)}
ANCHORS = FixedFrame(FrameKind.ANCHORS, ('anchor',))
OWN = FixedFrame(FrameKind.ROBOTS, ('r3', 'r4'))


def placement(places):
    return placement_at([places.get(robot, (np.nan, np.nan)) for robot in ROBOTS])


def tallied(of_fleet, of_group):
    """Return the tally of one answer with a group apart, of five hypotheses."""
    tracks = {name: TrueTrack.at_rest((*place, 0.0)) for name, place in TRUE_PLACES.items()}
    tally = TruthTally(FleetTruth(FleetConfig(robots=ROBOTS), tracks))
    group = Group(('r3', 'r4'), OWN, (placement(of_group),), 5)
    made = Estimate(0.5, ROBOTS, None, '', (placement(of_fleet),), 1, frame=ANCHORS)
    tally.add(replace(made, groups=(group,)), SimpleNamespace(stamp_s=0.5), 0.5)
    return tally


RIGHT, WRONG = {'r1': (0.0, 0.0), 'r2': (4.0, 0.0)}, {'r1': (0.0, 0.0), 'r2': (7.0, 7.0)}
GROUP_RIGHT = {'r3': (0.0, 0.0), 'r4': (3.0, 0.0)}
GROUP_WRONG = {'r3': (0.0, 0.0), 'r4': (2.0, 2.0)}


def test_a_miss_is_told_though_another_answer_is_not_listed_whole():
    tally = tallied(WRONG, GROUP_RIGHT)
    assert [*tally.counts.values()] == [1, 0, 0, 0, 0]
    assert [miss['robots'] for miss in tally.misses] == [('r2',)]
    tally = tallied(RIGHT, GROUP_WRONG)
    assert [*tally.counts.values()] == [1, 0, 0, 1, 0] and not tally.misses
    tally = tallied(RIGHT, GROUP_RIGHT)
    assert [*tally.counts.values()] == [1, 1, 0, 0, 0] and not tally.misses
