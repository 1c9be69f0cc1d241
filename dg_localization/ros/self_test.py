# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Test the installation: localize a simulated fleet over DDS and print figures: `self_test`."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
import os
import resource
import subprocess
import sys
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from dg_localization.fleet import solver_warnings, warm_up
from dg_localization.ros.spinning import own_arguments, rclpy_running
from msg_adapters import Status, adapter_for

USAGE = 'usage: self_test [--ros-args ...]'

ROBOTS = tuple(f'robot_{number}' for number in range(1, 7))
RATE_HZ, SENSOR_RATE_HZ = 5.0, 10.0
START_S, MEASURE_S = 30.0, 10.0
"""How long to wait for the first answer, and how long to count answers after it."""

PASSING_RATE, PASSING_HEARD = 0.9, 0.95
"""Smallest passing fractions of the answers and of the messages that should come."""

OLDEST_ANSWER_S, CLOCK_STEP_S = 0.5, 0.05
"""Largest passing age of an answer, and step of the system clock against the steady clock."""

to_statuses = adapter_for('diagnostic_msgs/msg/DiagnosticArray').from_message


@dataclass
class Observed:
    """
    What arrived from the localizer.

    Attributes
    ----------
    ages_s, arrivals_s : list of float
        Age of each answer with poses at its arrival, and when it arrived by the steady clock.
    heard : list of tuple
        Time of each diagnostics and how many readings were accepted by then, by input.
    fleet : str
        The newest message of the status of the fleet.

    """

    ages_s: list[float] = field(default_factory=list)
    arrivals_s: list[float] = field(default_factory=list)
    heard: list[tuple[float, dict[str, int]]] = field(default_factory=list)
    fleet: str = 'no diagnostics received'

    def keep_answer(self, message: PoseArray) -> None:
        """Keep the age and the arrival of an answer."""
        if message.poses:
            stamp = message.header.stamp
            self.ages_s.append(time.time() - stamp.sec - 1e-9 * stamp.nanosec)
            self.arrivals_s.append(time.monotonic())

    def keep_diagnostics(self, message: DiagnosticArray, node: str) -> None:
        """Keep what one localizer has accepted."""
        statuses = [one for one in to_statuses(message).statuses if one.name.startswith(node)]
        inputs = [one for one in statuses if one.name.startswith(f'{node}: input')]
        if inputs:
            self.heard.append((time.monotonic(), {one.name: _accepted(one) for one in inputs}))
        self.fleet = next((s.message for s in statuses if s.name.endswith(': fleet')), self.fleet)

    def rate_hz(self) -> float:
        """Return how often answers arrived from the first to the last."""
        if len(self.arrivals_s) < 2:
            return 0.0
        return (len(self.arrivals_s) - 1) / (self.arrivals_s[-1] - self.arrivals_s[0])

    def fraction_heard(self) -> float:
        """Return how many of the messages sent between the diagnostics were accepted."""
        if len(self.heard) < 2:
            return 0.0
        (start_s, first), (end_s, last) = self.heard[0], self.heard[-1]
        sent = SENSOR_RATE_HZ * (end_s - start_s) * len(first)
        return sum(last.get(name, 0) - count for name, count in first.items()) / sent


@dataclass(frozen=True)
class Check:
    """One line of the result: whether it passed, its name and its figure."""

    passed: bool
    name: str
    figure: str


def _accepted(status: Status) -> int:
    return int(status.values.get('accepted', '0'))


@contextmanager
def _running(name: str, namespace: str, **parameters: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run an executable of this package in a process of its own."""
    given = [part for key, value in parameters.items() for part in ('-p', f'{key}:={value}')]
    command = [sys.executable, '-m', 'dg_localization.ros', name, '--ros-args']
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            [*command, '-r', f'__ns:={namespace}', *given], stdout=log, stderr=log
        )
        try:
            yield process
        finally:
            process.terminate()
            process.wait()


def observe(namespace: str, is_over: Callable[[Observed], bool], timeout_s: float) -> Observed:
    """Return what the localizer in a namespace published until `is_over` or the timeout."""
    found, node = Observed(), Node('self_test')
    name = f'{namespace.lstrip("/")}/localizer'
    topic = f'{namespace}/localizer/feasible_poses'
    node.create_subscription(PoseArray, topic, found.keep_answer, 10)
    node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda message: found.keep_diagnostics(message, name), 10
    )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end_s = time.monotonic() + timeout_s
    while rclpy.ok() and time.monotonic() < end_s and not is_over(found):
        executor.spin_once(timeout_sec=0.1)
    node.destroy_node()
    return found


def measure() -> list[Check]:
    """Localize the simulated fleet in a namespace of its own and return what was measured."""
    namespace = f'/self_test_{os.getpid()}'
    clocks_s = time.time() - time.monotonic()
    simulated = {'rate': str(SENSOR_RATE_HZ)}
    localizing = {
        'robots': '[' + ', '.join(ROBOTS) + ']',
        'rate': str(RATE_HZ),
        'max_speed': '0.15',
        'max_turn_rate': '0.5',
        'range.min_error_relative': '-0.03',
        'range.max_error_relative': '0.03',
        'bearing.half_width': '0.03',
    }
    with ExitStack() as stack:
        stack.enter_context(_running('simulate_fleet', namespace, **simulated))
        stack.enter_context(_running('localizer', namespace, **localizing))
        first = observe(namespace, lambda found: bool(found.ages_s), START_S)
        if not first.ages_s:
            return [Check(False, 'answers', f'none in {START_S:.0f} s: {first.fleet}')]
        found = observe(namespace, lambda _: False, MEASURE_S)
    step_s = time.time() - time.monotonic() - clocks_s
    memory_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    return list(_checks(found, step_s, memory_mb))


def _checks(found: Observed, step_s: float, memory_mb: float) -> Iterator[Check]:
    """Yield the checks of what was observed."""
    rate_hz = found.rate_hz()
    yield Check(
        rate_hz >= PASSING_RATE * RATE_HZ,
        'answers',
        f'{rate_hz:.1f} a second of {RATE_HZ:g}; {found.fleet}',
    )
    age_s = sorted(found.ages_s)[len(found.ages_s) // 2] if found.ages_s else float('inf')
    yield Check(age_s <= OLDEST_ANSWER_S, 'delay', f'{age_s:.3f} s from measurement to answer')
    heard = found.fraction_heard()
    yield Check(heard >= PASSING_HEARD, 'messages', f'{100.0 * heard:.1f} % received')
    yield Check(
        abs(step_s) <= CLOCK_STEP_S, 'clock', f'moved by {step_s:.3f} s against the steady clock'
    )
    yield Check(True, 'memory', f'{memory_mb:.0f} MB at most in one process')


def main(args: Sequence[str]) -> int:
    """Print PASS or FAIL for each check; return 0 if all passed, else 1."""
    if {'-h', '--help'}.intersection(own_arguments(args)):
        print(USAGE)
        return 0
    began_s = time.monotonic()
    warm_up(lambda line: print(f'      {line}', file=sys.stderr, flush=True))
    slow = '; '.join(solver_warnings())
    checks = [
        Check(not slow, 'numba', slow or 'the solver is compiled'),
        Check(True, 'kernels', f'ready after {time.monotonic() - began_s:.1f} s'),
    ]
    with rclpy_running(args):
        checks += measure()
    for check in checks:
        print(f'{"PASS" if check.passed else "FAIL"}  {check.name:<9} {check.figure}')
    return 0 if all(check.passed for check in checks) else 1
