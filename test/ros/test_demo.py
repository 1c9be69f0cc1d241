# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The demonstration: how it compares, what it prints and draws, and the whole of it once."""

from contextlib import contextmanager
import os
import re
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization.ros import executables  # noqa: E402
from dg_localization.ros.demo import compare as demo_compare, run as demo_run  # noqa: E402
from dg_localization.ros.demo.processes import Executable  # noqa: E402
from dg_localization.ros.demo.spectator import Spectator  # noqa: E402
from dg_localization.ros.simulation.messages import quaternions  # noqa: E402
from dg_localization.ros.spinning import rclpy_running  # noqa: E402
from dg_localization.simulation.moving_fleet import ROBOTS, FleetMotion  # noqa: E402
from msg_adapters import Diagnostics, Level, Status, adapter_for  # noqa: E402


@pytest.fixture
def truth():
    state = FleetMotion().state(5.0)
    return demo_compare.Truth(100.0, state.positions_m, state.yaws_rad)


@pytest.fixture
def compared(truth):
    """An answer of the true placement and its mirror image."""
    frame = 'origin at robot_2, x towards robot_3'
    seen = truth.in_frame(frame)
    positions_m = np.stack([seen.positions_m, seen.positions_m * [1.0, -1.0]])
    boxes_m = np.stack([positions_m - 0.2, positions_m + 0.2], axis=2)
    yaws_rad = np.full((2, len(ROBOTS)), np.nan)
    return demo_compare.Compared(
        demo_compare.Answer(100.0, positions_m, yaws_rad, boxes_m), seen, frame
    )


def distances(positions_m):
    return np.linalg.norm(positions_m[:, None] - positions_m[None], axis=-1)


def test_the_truth_is_turned_into_a_frame_of_two_robots(truth):
    seen = truth.in_frame('origin at robot_2, x towards robot_1')
    np.testing.assert_allclose(seen.positions_m[1], 0.0)
    assert seen.positions_m[0, 0] > 0.0
    assert seen.positions_m[0, 1] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(distances(seen.positions_m), distances(truth.positions_m))


def test_the_truth_is_turned_into_the_body_frame_of_a_robot(truth):
    seen = truth.in_frame('body frame of robot_4')
    np.testing.assert_allclose(seen.positions_m[3], 0.0)
    assert seen.yaws_rad[3] == 0.0
    np.testing.assert_allclose(distances(seen.positions_m), distances(truth.positions_m))


def test_the_truth_is_turned_into_an_odometry_frame(truth):
    then = FleetMotion().state(4.9)
    then = demo_compare.Truth(99.9, then.positions_m, then.yaws_rad)
    stated = demo_compare.StatedPose('robot_3', 99.9, np.array([5.0, -2.0]), 0.7)
    frame = demo_compare.frame_of('robot_3/odom')
    assert demo_compare.robot_of_odometry_frame(frame) == 'robot_3'
    assert demo_compare.frame_of('robot_3/base_link') == 'body frame of robot_3'
    assert demo_compare.frame_of('fleet') == ''
    assert demo_compare.robot_of_odometry_frame('body frame of robot_3') is None
    seen = then.in_odometry_frame(stated, then)
    np.testing.assert_allclose(seen.positions_m[2], stated.position_m)
    assert seen.yaws_rad[2] == pytest.approx(0.7)
    later = truth.in_odometry_frame(stated, then)
    np.testing.assert_allclose(distances(later.positions_m), distances(truth.positions_m))
    # A robot sees another at the same bearing in every frame.
    bearings = [
        np.arctan2(*(one.positions_m[0] - one.positions_m[2])[::-1]) - one.yaws_rad[2]
        for one in (truth, later)
    ]
    assert np.cos(bearings[1] - bearings[0]) == pytest.approx(1.0)


def test_a_frame_it_does_not_know_is_an_error(truth):
    with pytest.raises(demo_compare.DemoError, match='describes its frame as'):
        truth.in_frame('somewhere')


def test_only_the_hypothesis_with_the_truth_holds_it(compared):
    assert compared.held_by.tolist() == [0]
    outside = demo_compare.Answer(
        100.0,
        compared.answer.positions_m,
        compared.answer.yaws_rad,
        compared.answer.enclosures_m + [0.0, 0.3],
    )
    assert len(demo_compare.Compared(outside, compared.truth, compared.frame).held_by) == 0


def test_the_table_points_to_the_truth(compared):
    lines = demo_compare.table(compared).splitlines()
    first, second = (line for line in lines if line[2:8].strip() in ('1', '2'))
    assert first.startswith('->') and first.count('*') == len(ROBOTS)
    assert second.startswith('  ') and second.count('*') == 2  # those that define the axis
    assert max(map(len, lines)) <= 100


def test_headings_are_in_the_table_when_known(compared):
    answer = compared.answer
    yaws_rad = np.full_like(answer.yaws_rad, np.pi / 2)
    yaws_rad[0, 5] = np.nan
    known = demo_compare.Answer(100.0, answer.positions_m, yaws_rad, answer.enclosures_m)
    text = demo_compare.table(demo_compare.Compared(known, compared.truth, compared.frame))
    assert text.count('90.0\N{DEGREE SIGN}') == 11
    assert text.count('?') == 1


def test_mirror_images_are_counted_as_such(compared):
    answer = compared.answer
    assert demo_compare.count_text(answer) == '1 hypothesis and its mirror image'
    alone = demo_compare.Answer(
        100.0, answer.positions_m[:1], answer.yaws_rad[:1], answer.enclosures_m[:1]
    )
    assert demo_compare.count_text(alone) == '1 hypothesis'


def test_the_progress_of_a_phase_is_told(compared):
    answer = compared.answer
    yaws_rad = np.zeros_like(answer.yaws_rad[:1])
    yaws_rad[0, 5] = np.nan
    alone = demo_compare.Answer(103.5, answer.positions_m[:1], yaws_rad, answer.enclosures_m[:1])
    later = demo_compare.Compared(alone, compared.truth, compared.frame)
    text = demo_compare.progress([compared, later, later])
    assert text == (
        'hypotheses: 2 at first, 1 at last (one after 3.5 s); headings of 5 of 6 robots are known.'
    )


def test_the_truth_is_interpolated_across_the_turn():
    zeros = np.zeros((6, 2))
    before = demo_compare.Truth(1.0, zeros, np.full(6, np.pi - 0.1))
    after = demo_compare.Truth(2.0, zeros + 1.0, np.full(6, -np.pi + 0.1))
    middle = demo_compare.truth_at([before, after], 1.5)
    np.testing.assert_allclose(middle.positions_m, 0.5)
    np.testing.assert_allclose(np.cos(middle.yaws_rad), -1.0)
    assert demo_compare.truth_at([before, after], 2.5) is None
    assert demo_compare.truth_at([before, after], 0.5) is None


def test_yaws_survive_quaternions_and_zero_is_unknown():
    yaws_rad = np.array([-3.0, -0.5, 0.0, 2.0])
    np.testing.assert_allclose(demo_compare.yaws_of(quaternions(yaws_rad)), yaws_rad)
    assert np.isnan(demo_compare.yaws_of(np.zeros((1, 4)))).all()


def test_a_process_that_ends_early_is_reported_with_what_it_wrote():
    executable = Executable('simulate_fleet', '--ros-args', '-p', 'rate:=-1')
    executable.wait(60)
    with pytest.raises(
        demo_compare.DemoError, match="(?s)simulate_fleet ended with exit code 2.*'rate'"
    ):
        executable.check()
    with pytest.raises(demo_compare.DemoError):
        executable.end()


@pytest.fixture
def spectator():
    with rclpy_running([]):
        node = Spectator()
        yield node
        node.destroy_node()


def tell(spectator, stamp_s, verdict):
    """Hand over the diagnostics of an answer."""
    values = {'stamp_s': f'{stamp_s:.3f}', 'verdict': verdict}
    status = Status(Level.OK, 'localizer: fleet', '', values=values)
    adapter = adapter_for('diagnostic_msgs/msg/DiagnosticArray')
    spectator._on_diagnostics(adapter.to_message(Diagnostics(stamp_s, (status,))))


def test_contradictions_are_counted_after_the_first_answer(spectator, compared):
    tell(spectator, 90.0, 'infeasible')
    spectator.compared.append(compared)
    spectator.begin()
    assert spectator.compared == []
    for stamp_s, verdict in (
        (99.0, 'infeasible'),
        (100.0, 'covered'),
        (100.2, 'infeasible'),
        (100.2, 'infeasible'),
        (100.4, 'none'),
        (100.6, 'infeasible'),
    ):
        tell(spectator, stamp_s, verdict)
    assert spectator.contradictions == {100.2, 100.6}


def test_an_answer_without_any_placement_does_not_hold_the_truth(compared):
    scenario = demo_compare.Scenario('Ranges', 8.0, {}, compared=[compared])
    assert scenario.always_held
    assert 'no placement' not in demo_compare.summary(scenario)
    scenario.contradictions = {100.2, 100.6}
    assert not scenario.always_held
    assert (
        'At least 2 more answers have no placement: the measurements contradict each other.'
        in demo_compare.summary(scenario)
    )


def test_a_phase_without_an_answer_in_its_time_is_a_sentence(monkeypatch, compared):
    """The first answer comes, and none after it."""
    spectator = SimpleNamespace(
        compared=[],
        contradictions=set(),
        status='contradiction: all is wrong',
        begin=lambda: spectator.compared.clear(),
        destroy_node=lambda: None,
    )

    def spin_until(spectator, executables, done, limit_s, line):
        if limit_s == demo_run.FIRST_ANSWER_S:
            spectator.compared.append(compared)
        return limit_s

    @contextmanager
    def nothing_runs(*executables):
        yield

    monkeypatch.setattr(demo_run, 'Spectator', lambda: spectator)
    monkeypatch.setattr(demo_run, 'Executable', lambda *arguments: None)
    monkeypatch.setattr(demo_run, 'running', nothing_runs)
    monkeypatch.setattr(demo_run, '_spin_until', spin_until)
    with pytest.raises(demo_compare.DemoError, match='no answer within 0.1 s: contradiction: all'):
        demo_run.run(demo_compare.Scenario('Ranges', 0.1, {}))


@pytest.mark.parametrize('seconds', ['0', '-1', 'nan', 'inf', 'long'])
def test_a_length_that_is_none_is_refused(seconds, capsys):
    with pytest.raises(SystemExit, match='2'):
        demo_run.main([f'--seconds={seconds}'])
    told = capsys.readouterr().err
    assert f"argument --seconds: '{seconds}' is not a number above 0 s" in told


@pytest.mark.parametrize(
    ('name', 'wanted'), [('absent/demo.png', 'there is no folder'), ('demo.gif', 'must end in')]
)
def test_a_picture_that_cannot_be_drawn_is_refused_first(tmp_path, name, wanted, capsys):
    with pytest.raises(SystemExit, match='2'):
        demo_run.main(['--picture', str(tmp_path / name)])
    assert 'argument --picture' in (told := capsys.readouterr().err) and wanted in told


def test_a_picture_that_cannot_be_written_is_a_sentence(tmp_path, monkeypatch):
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")

    def full_disk(scenarios, path):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(demo_run, 'phases', lambda seconds: [])
    monkeypatch.setattr(demo_run, 'draw', full_disk)
    with pytest.raises(executables.ExecutableError, match='demo.png cannot be written: No space'):
        demo_run.demonstrate(1.0, tmp_path / 'demo.png')


def test_the_whole_demonstration(tmp_path, capsys, monkeypatch):
    # The demonstration takes a domain of its own; the tests after it stay in theirs.
    monkeypatch.setenv('ROS_DOMAIN_ID', os.environ['ROS_DOMAIN_ID'])
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")
    picture = tmp_path / 'demo.png'
    code = executables.demo(['--seconds', '3', '--picture', str(picture)])
    told = capsys.readouterr()
    assert code == 0, told
    ranges, _, later = told.out.partition('The robots move:')
    moving, _, with_cameras = later.partition('With cameras:')
    assert '8 hypotheses and their mirror images' in ranges
    assert re.search(r'hypotheses: \d+ at first, \d+ at last', moving)
    assert '1 hypothesis' in with_cameras and 'mirror' not in with_cameras
    assert picture.read_bytes().startswith(b'\x89PNG')
