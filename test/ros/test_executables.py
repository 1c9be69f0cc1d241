# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executables before they have imported what they run."""

import signal
import sys

from plain_python import run_python
from processes import PIPES, start
import pytest

from dg_localization.ros import executables
from dg_localization.ros.executables import stop_request

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
def test_the_help_is_printed(name):
    code, printed, told = run(name, '--help')
    assert (code, told) == (0, '') and f'usage: {name} ' in printed


@pytest.mark.parametrize('name', ALL)
def test_wrong_arguments_are_named(name, capsys):
    wrong = {"wrong ROS arguments: ['--no-such-one']": ('--ros-args', '--no-such-one')}
    if name in NODES:
        wrong["'--params-file' is no argument of this"] = ('--params-file', 'fleet.yaml')
    for wanted, arguments in wrong.items():
        with pytest.raises(SystemExit) as ended:
            sys.exit(getattr(executables, name)([*arguments]))
        printed, told = capsys.readouterr()
        assert (ended.value.code, printed) == (2, '')
        assert wanted in told and 'Traceback' not in told


def test_what_is_no_executable_is_named():
    code, _, told = run('localiser')
    assert code == 2
    assert "'localiser' is no executable; there are localizer, simulate_fleet" in told


def test_a_machine_on_which_ros_cannot_start_is_no_wrong_argument(monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', '/proc/nowhere')
    code, _, told = run('localizer', '--ros-args', '-p', "robots:=['a', 'b']")
    assert code == 1 and told.startswith('ROS cannot start: ')
    assert '/proc/nowhere' in told and 'set ROS_LOG_DIR' in told
