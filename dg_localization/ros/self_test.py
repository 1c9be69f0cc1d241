# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Test the installation: localize a simulated fleet over DDS and print figures: `self_test`."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
import os
import resource
from statistics import median
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
import rclpy
from rclpy.node import Node

from dg_localization.fleet import solver_warnings, warm_up
from dg_localization.ros.executables import print_line, print_result
from dg_localization.ros.spinning import own_arguments, rclpy_running
from msg_adapters import adapter_for

RATE_HZ, SENSOR_RATE_HZ = 5.0, 10.0
START_S, MEASURE_S = 30.0, 10.0
"""Time to wait for the first answer, and time to count answers after it."""

PASSING_RATE, PASSING_HEARD = 0.9, 0.95
"""Least passing fractions of the expected answers and of the sent messages."""

OLDEST_ANSWER_S, CLOCK_STEP_S = 0.5, 0.05
"""Largest passing age of an answer, and step of the system clock against the steady clock."""

SIMULATED = {'rate': SENSOR_RATE_HZ}
LOCALIZING = {
    'robots': '[robot_1, robot_2, robot_3, robot_4, robot_5, robot_6]',
    'rate': RATE_HZ,
    'max_speed': 0.15,
    'max_turn_rate': 0.5,
    'range.min_error_relative': -0.03,
    'range.max_error_relative': 0.03,
    'bearing.half_width': 0.03,
}

to_statuses = adapter_for('diagnostic_msgs/msg/DiagnosticArray').from_message

Check = tuple[bool, str, str]
"""One line of the result: whether it passed, its name and its value."""


@dataclass
class Observed:
    """
    The messages of the localizer: the time and age of each answer, and its diagnostics.

    `heard` holds times of diagnostics with the number of accepted readings of each input.
    """

    answers_s: list[tuple[float, float]] = field(default_factory=list)
    heard: list[tuple[float, dict[str, int]]] = field(default_factory=list)
    fleet: str = 'no diagnostics received'

    def keep_answer(self, message: PoseArray) -> None:
        """Record the arrival and the age of an answer."""
        if message.poses:
            stamp = message.header.stamp
            age_s = time.time() - stamp.sec - 1e-9 * stamp.nanosec
            self.answers_s.append((time.monotonic(), age_s))

    def keep_diagnostics(self, message: DiagnosticArray, node: str) -> None:
        """Record the numbers of accepted readings of one localizer."""
        statuses = [one for one in to_statuses(message).statuses if one.name.startswith(node)]
        inputs = {
            one.name: int(one.values.get('accepted', '0'))
            for one in statuses
            if one.name.startswith(f'{node}: input')
        }
        if inputs:
            self.heard.append((time.monotonic(), inputs))
        self.fleet = next((s.message for s in statuses if s.name.endswith(': fleet')), self.fleet)

    def fraction_heard(self) -> float:
        """Return the fraction of accepted messages between the first and the last diagnostics."""
        if len(self.heard) < 2:
            return 0.0
        (start_s, first), (end_s, last) = self.heard[0], self.heard[-1]
        sent = SENSOR_RATE_HZ * (end_s - start_s) * len(first)
        return sum(last.get(name, 0) - count for name, count in first.items()) / sent

    def checks(self) -> Iterator[Check]:
        """Yield the checks of the answers, their ages and the messages."""
        (first_s, _), (last_s, _) = self.answers_s[0], self.answers_s[-1]
        rate_hz = (len(self.answers_s) - 1) / max(last_s - first_s, 1e-9)
        figure = f'{rate_hz:.1f} a second of {RATE_HZ:g}; {self.fleet}'
        yield rate_hz >= PASSING_RATE * RATE_HZ, 'answers', figure
        age_s = median(age_s for _, age_s in self.answers_s)
        yield age_s <= OLDEST_ANSWER_S, 'delay', f'{age_s:.3f} s from measurement to answer'
        heard = self.fraction_heard()
        yield heard >= PASSING_HEARD, 'messages', f'{100.0 * heard:.1f} % received'


def _observe(namespace: str) -> Observed:
    """Return the messages of the localizer in a namespace, from its first answer on."""
    found, node = Observed(), Node('self_test')
    name = f'{namespace.lstrip("/")}/localizer'
    topic = f'{namespace}/localizer/feasible_poses'
    node.create_subscription(PoseArray, topic, found.keep_answer, 10)
    node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda message: found.keep_diagnostics(message, name), 10
    )
    end_s = time.monotonic() + START_S
    while rclpy.ok() and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.1)
        if len(found.answers_s) == 1:
            found.heard.clear()
            end_s = found.answers_s[0][0] + MEASURE_S
    node.destroy_node()
    return found


def measure() -> list[Check]:
    """Localize the simulated fleet in a separate namespace and return the checks."""
    namespace = f'/self_test_{os.getpid()}'
    clocks_s = time.time() - time.monotonic()
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))}
    with ExitStack() as stack:
        for name, values in (('simulate_fleet', SIMULATED), ('localizer', LOCALIZING)):
            # Test the installed package, not a clone in the working directory.
            command = [sys.executable, '-P', '-m', 'dg_localization.ros', name, '--ros-args']
            command += ['-r', f'__ns:={namespace}']
            command += [
                part for key, value in values.items() for part in ('-p', f'{key}:={value}')
            ]
            nowhere = subprocess.DEVNULL
            process = subprocess.Popen(command, stdout=nowhere, stderr=nowhere, env=environment)
            stack.enter_context(process)
            stack.callback(process.terminate)
        found = _observe(namespace)
    if not found.answers_s:
        return [(False, 'answers', f'none in {START_S:.0f} s: {found.fleet}')]
    step_s = time.time() - time.monotonic() - clocks_s
    memory_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    moved = f'moved by {step_s:.3f} s against the steady clock'
    return [
        *found.checks(),
        (abs(step_s) <= CLOCK_STEP_S, 'clock', moved),
        (True, 'memory', f'{memory_mb:.0f} MB at most in one process'),
    ]


def main(args: Sequence[str]) -> int:
    """Print PASS or FAIL for each check; return 0 if all passed, else 1."""
    if {'-h', '--help'}.intersection(own_arguments(args)):
        print('usage: self_test [--ros-args ...]')
        return 0
    began_s = time.monotonic()
    warm_up(print_line)
    slow = '; '.join(solver_warnings())
    checks: list[Check] = [
        (not slow, 'numba', slow or 'the solver is compiled'),
        (True, 'kernels', f'ready after {time.monotonic() - began_s:.1f} s'),
    ]
    with rclpy_running(args):
        checks += measure()
    for passed, name, figure in checks:
        print_result(f'{"PASS" if passed else "FAIL"}  {name:<9} {figure}')
    return int(not all(passed for passed, *_ in checks))
