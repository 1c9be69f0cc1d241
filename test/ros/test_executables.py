# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executables before they have imported what they run."""

import signal
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization.ros.executables import stop_request  # noqa: E402

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


@pytest.mark.parametrize('number', [2, 15, 1], ids=['SIGINT', 'SIGTERM', 'SIGHUP'])
@pytest.mark.parametrize(
    ('name', 'code'),
    [
        ('localizer', 0),
        ('simulate_fleet', 0),
        ('replay', 0),
        ('localize_bag', 130),
        ('fit_bounds', 130),
    ],
)
def test_signal_during_the_imports_ends_the_process_cleanly(name, code, number):
    done = subprocess.run(
        [sys.executable, '-c', CODE, name, str(number)],
        capture_output=True,
        text=True,
        timeout=60.0,
    )
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
    return subprocess.run(
        [sys.executable, '-m', 'dg_localization.ros', *arguments],
        capture_output=True,
        text=True,
        timeout=60.0,
    )


def test_executable_that_is_not_there_is_named_with_those_that_are():
    done = run('localiser')
    assert done.returncode == 2
    assert "'localiser' is no executable; there are localizer, simulate_fleet" in done.stderr


@pytest.mark.parametrize(
    'name',
    ['localizer', 'simulate_fleet', 'replay', 'localize_bag', 'fit_bounds'],
)
def test_unknown_ros_argument_is_named_by_every_executable(name):
    done = run(name, '--ros-args', '--no-such-argument')
    assert (done.returncode, done.stderr) == (
        2,
        "wrong ROS arguments: ['--no-such-argument']\n",
    )


def test_a_file_of_parameters_that_is_not_there_is_a_wrong_argument():
    done = run('localizer', '--ros-args', '--params-file', 'nowhere.yaml')
    assert done.returncode == 2 and 'nowhere.yaml' in done.stderr


def test_a_machine_on_which_ros_cannot_start_is_no_wrong_argument(monkeypatch):
    monkeypatch.setenv('ROS_LOG_DIR', '/proc/nowhere')
    done = run('localizer', '--ros-args', '-p', "robots:=['a', 'b']")
    assert done.returncode == 1 and done.stderr.startswith('ROS cannot start: ')
    assert '/proc/nowhere' in done.stderr and 'set ROS_LOG_DIR' in done.stderr


@pytest.mark.parametrize('name', ['localizer', 'simulate_fleet', 'replay', 'localize_bag'])
def test_every_executable_says_how_it_is_used(name):
    done = run(name, '--help')
    assert (done.returncode, done.stderr) == (0, '')
    assert f'usage: {name} ' in done.stdout


@pytest.mark.parametrize('name', ['localizer', 'simulate_fleet'])
def test_arguments_that_are_none_of_ros_are_named(name):
    done = run(name, '--params-file', 'fleet.yaml')
    assert (done.returncode, done.stdout) == (2, '')
    assert f"'--params-file' is no argument of this node; usage: {name} --ros-args" in done.stderr
