# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The load test: ``python -m benchmarks.load [--only PATTERN ...] [--seconds S] [--soak MINUTES]``.

The node and its sensors run in processes of their own, over DDS. Lateness of a message is the time
from its stamp, set when it is published, to the callback of the node; that of an answer is the
time from its stamp, when the measurements were taken together, until it is published.
"""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
import json
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
from typing import NamedTuple

import numpy as np

from benchmarks.load.scenario import Scenario
from benchmarks.report import machine, table
from dg_localization.fleet import warm_up
from dg_localization.ros.domain import claim_domain

RANGES_ONLY = ('-p', 'bearing.topic:=')
SCENARIOS = (
    *(Scenario(f'{n} robots', n, 10.0) for n in (6, 10, 20, 50)),
    Scenario('20 robots x 50 Hz, peers', 20, 50.0),
    Scenario('5,000 messages/s, single topics', 20, 5000.0 / 240.0, peers=False),
    Scenario('2,500 messages/s, single topics', 20, 2500.0 / 240.0, peers=False),
    Scenario('1,000 messages/s, single topics', 20, 1000.0 / 240.0, peers=False),
    Scenario('50 robots, ranges only', 50, 10.0, degree=3, cameras=False),
)
SOAK = Scenario('soak: 20 robots', 20, 10.0)
RATE_HZ = 5.0
END_S = 30.0


class Run(NamedTuple):
    """What the node and the sensors wrote down, within the time of the measurement."""

    sent: int
    seconds: float
    messages: np.ndarray
    answers: np.ndarray
    resources: np.ndarray
    refused: int


def measure(scenario: Scenario, seconds: float, folder: Path) -> Run:
    """Run a scenario."""
    result = folder / 'result.npz'
    robots = ', '.join(f"'{name}'" for name in scenario.robots)
    arguments = ['--ros-args', '-p', f'robots:=[{robots}]', *scenario.parameters]
    arguments += ['--log-level', 'error']
    node = subprocess.Popen(
        [sys.executable, '-m', 'benchmarks.load.node', str(result), *arguments]
    )
    try:
        sensors = subprocess.run(
            [
                *(sys.executable, '-m', 'benchmarks.load.sensors'),
                *(scenario.to_json(), str(seconds)),
            ],
            capture_output=True,
            text=True,
        )
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(END_S)
    if sensors.returncode != 0:
        sys.exit(f'{scenario.name}: {sensors.stderr}')
    told = json.loads(sensors.stdout)
    with np.load(result) as noted:
        stamps_s = noted['messages'][:, 1]
        within = (told['first_s'] <= stamps_s) & (stamps_s < told['end_s'])
        answered_s = noted['answers'][:, 0]
        recent = (told['first_s'] <= answered_s) & (answered_s < told['end_s'])
        counts = json.loads(str(noted['counts']))
        return Run(
            sent=int(told['sent']),
            seconds=seconds,
            messages=noted['messages'][within],
            answers=noted['answers'][recent],
            resources=noted['resources'],
            refused=counts['rejected'] + counts['malformed'],
        )


def percentiles_ms(values_s: np.ndarray) -> str:
    """Return the median and the 99th percentile of times, in ms."""
    if not len(values_s):
        return '-'
    middle, late = np.percentile(values_s, [50, 99]) * 1e3
    return f'{middle:.1f} / {late:.1f}'


def limit_of(run: Run) -> str:
    """Return what limits a run: the share of a core that the executor's thread took."""
    if len(run.messages) < 2:
        return 'nothing arrived'
    order = np.argsort(run.messages[:, 3])
    cpu_s = np.ptp(run.messages[order, 3])
    wall_s = np.ptp(run.messages[:, 0])
    return f'{100.0 * cpu_s / wall_s:.0f} %'


def row(scenario: Scenario, run: Run) -> list[str]:
    """Return a line of the table."""
    messages, answers = run.messages, run.answers
    lost = 1.0 - len(messages) / max(1, run.sent)
    cpu_s = np.ptp(messages[:, 3]) if len(messages) > 1 else np.nan
    intake_us = 1e6 * float(np.mean(messages[:, 2])) if len(messages) else np.nan
    return [
        scenario.name,
        str(scenario.n_topics),
        f'{run.sent / run.seconds:,.0f}',
        f'{100.0 * lost:.2f} %',
        percentiles_ms(messages[:, 0] - messages[:, 1]),
        f'{intake_us:.0f} / {1e6 * cpu_s / max(1, len(messages)):.0f}',
        limit_of(run),
        f'{len(answers) / run.seconds:.1f}',
        percentiles_ms(answers[:, 0] - answers[:, 1]),
        f'{1e3 * float(np.nanmedian(answers[:, 3])):.0f}' if len(answers) else '-',
        f'{np.median(answers[:, 2]):.0f}' if len(answers) else '-',
    ]


HEADER = (
    *('load', 'topics', 'sent /s', 'lost', 'late, p50 / p99 ms', 'intake / all us per message'),
    *('executor busy', 'answers /s', 'answer late, p50 / p99 ms', 'solve ms', 'hypotheses'),
)


def print_soak(minutes: float, folder: Path) -> None:
    """Run for long, and print how memory, descriptors, threads and rate develop."""
    run = measure(SOAK, 60.0 * minutes, folder)
    resources, begin_s = run.resources, run.resources[0, 0]
    lines = []
    for quarter in range(5):
        index = min(len(resources) - 1, 10 + quarter * (len(resources) - 11) // 4)
        time_s, memory_mib, descriptors, threads, _ = resources[index]
        near = np.abs(run.answers[:, 0] - time_s) < 30.0
        span_s = min(60.0, 30.0 + min(run.answers[-1, 0] - time_s, time_s - run.answers[0, 0]))
        lines.append(
            [
                f'{(time_s - begin_s) / 60.0:.1f}',
                f'{memory_mib:.1f}',
                *(f'{descriptors:.0f}', f'{threads:.0f}', f'{near.sum() / span_s:.2f}'),
            ]
        )
    print(table(('minute', 'memory MiB', 'descriptors', 'threads', 'answers /s'), lines))
    lost = 1.0 - len(run.messages) / run.sent
    print(f'\n{run.sent} messages, {100.0 * lost:.3f} % lost, {run.refused} refused')


def main() -> None:
    """Run the scenarios, and print their table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.load', description=__doc__)
    parser.add_argument('--only', action='append', metavar='PATTERN', help='by name')
    parser.add_argument('--seconds', type=float, default=20.0, help='time of each load (20)')
    parser.add_argument('--soak', type=float, metavar='MINUTES', help='the soak test instead')
    options = parser.parse_args()
    warm_up()
    claim_domain()
    print(f'{machine()}\n', flush=True)
    with tempfile.TemporaryDirectory() as folder:
        if options.soak:
            print_soak(options.soak, Path(folder))
            return
        patterns = [f'*{pattern}*' for pattern in options.only or ['']]
        lines = []
        for scenario in SCENARIOS:
            if any(fnmatch(scenario.name, pattern) for pattern in patterns):
                lines.append(row(scenario, measure(scenario, options.seconds, Path(folder))))
                print(' | '.join(lines[-1]), file=sys.stderr, flush=True)
    print(table(HEADER, lines))


if __name__ == '__main__':
    main()
