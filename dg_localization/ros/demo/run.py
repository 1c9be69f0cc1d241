# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The demonstration: `simulate_fleet` and `localizer` as two processes, looked at as a user would.

First the robots measure ranges only. Then they drive loops and publish odometry: mirror images
disappear and headings appear. At last they see each other. In each phase every feasible placement
that arrives on the topics of the localizer is compared with the simulated truth; the last ones are
printed and drawn. The exit code is 1 when the truth was in no hypothesis of some answer, or some
answer was that the measurements contradict each other.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
import os
from pathlib import Path
import sys
import time

import rclpy

from dg_localization.optional import install_hint
from dg_localization.ros.bags.picture import PICTURES
from dg_localization.ros.bags.writer import writing
from dg_localization.ros.demo.compare import DemoError, Scenario, count_text, summary
from dg_localization.ros.demo.picture import draw
from dg_localization.ros.demo.processes import Executable, find_config, running
from dg_localization.ros.demo.spectator import Spectator
from dg_localization.ros.domain import claim_domain
from dg_localization.ros.spinning import rclpy_running
from dg_localization.ros.terminal import number, path_ending_in, print_line

# Without compiled kernels in its cache the localizer compiles them before its first answer: some
# minutes, and several times as long on a machine that is busy. The line shows how far it has come.
FIRST_ANSWER_S = 1800.0

MOVING = 4.0
"""Robots that move take so many times as long: nine ranges leave 16 hypotheses to be ruled out."""


class ProgressLine:
    """One line that is written again and again; where it cannot be, every few seconds."""

    PERIOD_S = 5.0

    def __init__(self) -> None:
        self._start_s = time.monotonic()
        self._live = sys.stdout.isatty()
        self._printed_s = 0.0
        self._width = 0

    def show(self, share: float, text: str, *, last: bool = False) -> None:
        """Show how much is done, from 0 to 1, and a text."""
        now_s = time.monotonic()
        if not (self._live or last or now_s - self._printed_s >= self.PERIOD_S):
            return
        self._printed_s = now_s
        filled = round(20 * min(1.0, share))
        bar = '#' * filled + '.' * (20 - filled)
        line = f'  [{bar}] {now_s - self._start_s:5.1f} s  {text}'
        padded = line.ljust(self._width)
        self._width = len(line)
        if self._live:
            print(f'\r{padded}', end='\n' if last else '', flush=True)
        else:
            print(line, flush=True)


def phases(seconds: float) -> list[Scenario]:
    """
    Return what the demonstration shows.

    Parameters
    ----------
    seconds : float
        Length of a phase; robots that move take `MOVING` times as long.

    """
    speed_m_s = 0.5
    moving = {
        'cameras': False,
        'path': 'loops',
        'speed': speed_m_s,
        'odometry': True,
        # Two processors have to do for the simulator, the node and this process.
        'peers': True,
        'rate': 5.0,
        'odometry_rate': 10.0,
    }
    # The bounds are those of the simulator, which has next to no constant errors. Sixteen
    # hypotheses share the time for what is remembered.
    odometry = {
        'max_speed': 1.2 * speed_m_s,
        'max_turn_rate': 1.5,
        'odometry.translation_per_m': 0.05,
        'odometry.rotation_per_m': 0.0,
        'odometry.rotation_per_rad': 0.05,
        'odometry.constant_translation': 0.002,
        'odometry.constant_rotation': 0.002,
        'rate': 2.0,
        'memory.max_seconds': 1.0,
    }
    return [
        Scenario('Ranges', seconds, {'cameras': False}),
        Scenario('The robots move', MOVING * seconds, moving, odometry),
        Scenario('With cameras', seconds, {'cameras': True}),
    ]


def run(scenario: Scenario) -> None:
    """
    Run a phase and fill in what came out of it.

    Parameters
    ----------
    scenario : Scenario
        What to run.

    Raises
    ------
    DemoError
        If a process ends or no answer comes.

    """
    print(f'{scenario.title}:')
    spectator = Spectator()
    executables = (
        Executable('simulate_fleet', '--ros-args', *_arguments(scenario.simulator)),
        Executable(
            'localizer',
            '--ros-args',
            '--params-file',
            str(find_config()),
            *_arguments(scenario.localizer),
        ),
    )
    scenario.compared, scenario.contradictions = spectator.compared, spectator.contradictions
    line = ProgressLine()
    try:
        with running(*executables):
            first_s = _spin_until(
                spectator, executables, lambda: bool(spectator.compared), FIRST_ANSWER_S, line
            )
            _check_answered(spectator, first_s)
            spectator.begin()
            _spin_until(spectator, executables, lambda: False, scenario.seconds, line)
            _check_answered(spectator, scenario.seconds)
            line.show(1.0, _state(spectator), last=True)
    finally:
        spectator.destroy_node()


def _check_answered(spectator: Spectator, within_s: float) -> None:
    """Raise a DemoError where no answer has come."""
    if not spectator.compared:
        raise DemoError(f'no answer within {within_s:g} s: {spectator.status}')


def _arguments(parameters: Mapping[str, object]) -> list[str]:
    """Return parameters as arguments of an executable."""
    texts = [f'{name}:={str(value).lower()}' for name, value in parameters.items()]
    return [argument for text in texts for argument in ('-p', text)]


def _spin_until(
    spectator: Spectator,
    executables: Sequence[Executable],
    done: Callable[[], bool],
    limit_s: float,
    line: ProgressLine,
) -> float:
    """Spin, with a live line, until it is done or time is up; return the time it took."""
    start_s = time.monotonic()
    while (passed_s := time.monotonic() - start_s) < limit_s and not done():
        rclpy.spin_once(spectator, timeout_sec=0.1)
        for executable in executables:
            executable.check()
        line.show(passed_s / limit_s if spectator.compared else 0.0, _state(spectator))
    return passed_s


def _state(spectator: Spectator) -> str:
    """Return the newest answer in a few words."""
    if not spectator.compared:
        return spectator.status
    held = sum(len(compared.held_by) > 0 for compared in spectator.compared)
    return (
        f'{count_text(spectator.compared[-1].answer)}; '
        f'truth held in {held} of {len(spectator.compared)} answers'
    )


def main(args: Sequence[str]) -> int:
    """
    Run all phases.

    Parameters
    ----------
    args : sequence of str
        Command line.

    Returns
    -------
    int
        Exit code: 0, or 1 when an answer did not hold the truth.

    Raises
    ------
    DemoError
        If a process ends or no answer comes.
    ExecutableError
        If the picture cannot be written.

    """
    parser = argparse.ArgumentParser(prog='demo', description='Localize a simulated fleet.')
    parser.add_argument(
        '--seconds',
        type=number(0.0, ' s', strict=True),
        default=8.0,
        help='length of a phase; the second is longer',
    )
    parser.add_argument(
        '--picture', type=path_ending_in(PICTURES), default='demo.png', help='file to write'
    )
    options = parser.parse_args(args)
    claim = claim_domain()
    os.environ['ROS_DOMAIN_ID'] = str(claim.domain_id)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(f'Six robots measure nine ranges to +-3 % (ROS_DOMAIN_ID={claim.domain_id}).')
    try:
        with rclpy_running([]):
            return demonstrate(options.seconds, options.picture)
    except KeyboardInterrupt:
        print_line('\ninterrupted')
        raise
    finally:
        claim.release()


def demonstrate(seconds: float, picture: Path) -> int:
    """
    Run all phases, print what came out, and draw it.

    Parameters
    ----------
    seconds : float
        Length of the first.
    picture : Path
        The picture to write.

    Returns
    -------
    int
        0, or 1 when an answer did not hold the truth.

    Raises
    ------
    DemoError
        If a process ends or no answer comes.
    ExecutableError
        If the picture cannot be written.

    """
    scenarios = phases(seconds)
    for scenario in scenarios:
        run(scenario)
        print(summary(scenario), flush=True)
    if find_spec('matplotlib') is None:
        print(f'no picture without matplotlib: {install_hint("matplotlib")}')
    else:
        with writing(picture):
            draw(scenarios, picture)
        print(f'All feasible placements next to the truth: {picture}')
    return int(not all(scenario.always_held for scenario in scenarios))
