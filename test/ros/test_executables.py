# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executables: their start, arguments and end; what `fleet_status` and `self_test` show."""

from dataclasses import replace
import signal
import sys

from diagnostic_msgs.msg import DiagnosticArray
from plain_python import run_python
from processes import PIPES, Listener, start
import pytest

from dg_localization.ros import executables
from dg_localization.ros.executables import self_test, stop_request
from dg_localization.ros.fleet_status import FleetStatusNode, screen
from dg_localization.ros.self_test import Observed
from msg_adapters import Diagnostics, Level, Status, adapter_for

# Sends the signal to itself when rclpy is asked for, in the middle of the imports.
CODE = """
import os, sys
from dg_localization.ros import executables
class Interrupter:
    def find_spec(self, name, path, target=None):
        if name == 'rclpy':
            print('importing')
            os.kill(os.getpid(), int(sys.argv[2]))
sys.meta_path.insert(0, Interrupter())
sys.exit(getattr(executables, sys.argv[1])())
"""


@pytest.mark.parametrize(
    ('name', 'number', 'code'),
    [
        ('localizer', 2, 0),
        ('localizer', 15, 0),
        ('localizer', 1, 0),
        ('simulate_fleet', 15, 0),
        ('replay', 1, 0),
        ('localize_bag', 2, 130),
        ('fit_bounds', 15, 130),
    ],
)
def test_signal_during_the_imports_ends_the_process_cleanly(name, number, code):
    done = run_python(CODE, name, str(number))
    assert (done.returncode, done.stdout, done.stderr) == (code, 'importing\n', '')


def test_a_closed_terminal_is_told_twice_and_ends_nothing_by_force():
    with stop_request() as stop:
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert stop.is_set()


def test_what_nohup_has_ignored_stays_ignored():
    former = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_request() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert not stop.is_set()
    finally:
        signal.signal(signal.SIGHUP, former)


def run(*arguments):
    """Run an executable in a process; return its exit code, and what it printed and told."""
    process = start(*arguments, **PIPES)
    printed, told = process.communicate(timeout=60.0)
    return process.returncode, printed, told


NODES = ('localizer', 'simulate_fleet')
ALL = (*NODES, 'replay', 'localize_bag', 'fit_bounds')


@pytest.mark.parametrize('name', ALL)
def test_help_is_printed_and_wrong_arguments_are_named(name, capsys):
    with pytest.raises(SystemExit) as ended:
        sys.exit(getattr(executables, name)(['--help']))
    printed, told = capsys.readouterr()
    assert (ended.value.code, told) == (0, '') and f'usage: {name} ' in printed
    wrong = {"wrong ROS arguments: ['--no-such-one']": ('--ros-args', '--no-such-one')}
    if name in NODES:
        wrong["'--params-file' is no argument of this"] = ('--params-file', 'fleet.yaml')
    for wanted, arguments in wrong.items():
        with pytest.raises(SystemExit) as ended:
            sys.exit(getattr(executables, name)([*arguments]))
        printed, told = capsys.readouterr()
        assert (ended.value.code, printed) == (2, '')
        assert wanted in told and 'Traceback' not in told


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('rate: 0.0', "parameter 'rate': 0.0 is not allowed, it must be a number >= 0.01"),
        ('use_sim_time: 5', "'use_sim_time' to '5' of type 'INTEGER', expecting type 'BOOL'"),
        ("robots: ['a', 1]", 'Sequence should be of same type'),
        (None, 'Error opening YAML file'),
    ],
)
def test_wrong_parameters_end_the_localizer_with_a_message(tmp_path, capfd, text, wanted):
    file = tmp_path / 'parameters.yaml'
    if text is not None:
        file.write_text(f'/**:\n  ros__parameters:\n    {text}\n')
    given = '--ros-args', '--params-file', str(file), '-p', "robots:=['a', 'b']"
    with pytest.raises(SystemExit) as ended:
        sys.exit(executables.localizer(given))
    told = capfd.readouterr().err
    assert ended.value.code == 2 and wanted in told and 'Traceback' not in told


def test_what_is_no_executable_is_named():
    code, _, told = run('localiser')
    assert code == 2
    assert "'localiser' is no executable; there are localizer, simulate_fleet" in told


def test_a_machine_on_which_ros_cannot_start_is_no_wrong_argument(monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', '/proc/nowhere')
    code, _, told = run('localizer', '--ros-args', '-p', "robots:=['a', 'b']")
    assert code == 1 and told.startswith('ROS cannot start: ')
    assert '/proc/nowhere' in told and 'set ROS_LOG_DIR' in told


to_message = adapter_for('diagnostic_msgs/msg/DiagnosticArray').to_message

POSE = {
    'position_m': '-1234.56 1234.56 -12.34',
    'yaw_deg': '-178 +- 180',
    'typical_m': '10.15',
    'guaranteed_m': '1210.41',
    'heard': '15 of 16',
}
FLEET = (
    Status(
        Level.WARN,
        'localizer: fleet',
        'ambiguous: 2 hypotheses',
        values={
            'hypotheses': '2',
            'hypothesis_numbers': '7 4',
            'frame': 'origin at a, x towards long_name',
            'inputs': '4',
            'inputs_in_use': '3',
            'rate_hz': '5.00',
            'would_fix': f'range a - d would fix the hinge at b; {"drive c " * 20}',
        },
    ),
    Status(Level.OK, 'localizer: robot a', 'localized', values={'position_m': '1.00 2.00'}),
    Status(Level.WARN, 'localizer: robot b', '', values=POSE | {'problem': 'ambiguous'}),
    Status(
        Level.ERROR, 'localizer: robot c', '', values={'problem': 'no placement: ' + 'x ' * 50}
    ),
    Status(Level.OK, 'localizer: input range a->b', 'in use'),
    Status(Level.WARN, 'localizer: input range b->c', 'stale'),
)


@pytest.mark.parametrize('name', ['b', 'a_robot_with_a_long_name'])
def test_the_screen_has_all_of_the_fleet_in_80_columns(name):
    fleet = [replace(one, name=one.name.replace('robot b', f'robot {name}')) for one in FLEET]
    lines = list(screen('localizer', fleet, 0.5))
    assert max(map(len, lines)) <= 80
    text = ' '.join(' '.join(lines).split())
    for status in fleet:
        if 'robot' in status.name:
            _, _, robot = status.name.partition('robot ')
            assert robot in text and ' '.join(status.values.get('problem', '').split()) in text
    assert lines[0] == 'localizer: WARN: ambiguous: 2 hypotheses'
    for part in (
        'origin at a, x towards long_name, 3 of 4 inputs in use, 5.00 answers/s, poses of',
        'poses of hypothesis 7 of 2',
        f'{name} WARN -1234.56 1234.56 -12.34 -178 +- 180 10.15 1210.41 15 of 16',
        'input range b->c: stale next: range a - d would fix the hinge at b next: drive c drive c',
    ):
        assert part in text
    assert 'a->b' not in text and 'WARN: ambiguous' in text and text.count('ambiguous') == 1


def test_a_silent_or_unknown_localizer_is_named_and_a_plane_has_no_z():
    assert 'SILENT for 7 s' in next(screen('localizer', FLEET, 7.0))
    (line,) = screen('localizer', (), 60.0)
    assert line.startswith('localizer: no diagnostics received; is it running')
    assert 'z m' in '\n'.join(screen('localizer', FLEET, 0.0))
    assert 'z m' not in '\n'.join(screen('localizer', FLEET[:2], 0.0))


def test_the_node_shows_its_localizer_and_no_other(node):
    shown: list[str] = []
    named = ['--ros-args', '-p', 'localizer:=/localizer']
    status_node = FleetStatusNode(shown.append, context=node.context, cli_args=named)
    publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    other = Status(Level.ERROR, 'other: fleet', 'not mine')

    def send():
        publisher.publish(to_message(Diagnostics(1.0, FLEET)))
        publisher.publish(to_message(Diagnostics(1.0, (other,))))

    node.create_timer(0.1, send)
    listener = Listener(node, {}, status_node)
    assert listener.spin_until(lambda: any('ambiguous' in text for text in shown))
    assert 'localizer: WARN: ambiguous: 2 hypotheses' in shown[-1]
    assert not any('not mine' in text for text in shown)


CHECKS = ('numba', 'kernels', 'answers', 'delay', 'messages', 'clock', 'memory')


def test_every_check_is_printed_with_its_figure(capsys, tmp_path, monkeypatch):
    # The clone that something else was installed from may be the working directory.
    (tmp_path / 'dg_localization').mkdir()
    (tmp_path / 'dg_localization/__init__.py').write_text("raise ImportError('not installed')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('dg_localization.ros.self_test.MEASURE_S', 4.0)
    code = self_test([])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == list(CHECKS)
    assert {line.split()[0] for line in lines} <= {'PASS', 'FAIL'}
    assert code == int(any(line.startswith('FAIL') for line in lines))
    # Whatever the load of this machine is, the localizer answers.
    assert 'a second of 5' in next(line for line in lines if 'answers' in line)


def test_messages_count_from_the_first_diagnostics():
    lost_half = Observed(heard=[(1.0, {'a': 10, 'b': 0}), (3.0, {'a': 20, 'b': 10, 'c': 9})])
    assert lost_half.fraction_heard() == pytest.approx(0.5)
    assert Observed().fraction_heard() == 0.0
