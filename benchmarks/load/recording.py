# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The node on a recording that is replayed at its own pace, over DDS.

    python -m benchmarks.load.recording BAG --params FILE [--cores N] [ROS arguments]

Prints how many answers a second the node gives, and what they cost.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

import numpy as np
from numpy.typing import NDArray

from benchmarks.load.__main__ import END_S, percentiles_ms
from benchmarks.report import machine, table
from dg_localization.fleet import warm_up
from dg_localization.ros.domain import claim_domain

SETTLE_S = 10.0
"""What comes before is not counted: subscriptions, and a memory that is still empty."""
HEADER = (
    *('messages /s', 'answers /s', 'apart, p50 / p99 ms', 'answer late, p50 / p99 ms'),
    *('solve ms', 'executor busy', 'process busy'),
)


def row(noted: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return the line of the table from what the node noted, after `SETTLE_S`."""
    messages, answers, resources = noted['messages'], noted['answers'], noted['resources']
    # A message may come before the first of the clock.
    messages = messages[messages[:, 0] > 0.0]
    first_s, end_s = messages[0, 0] + SETTLE_S, messages[-1, 0]
    messages, answers = (
        rows[(rows[:, 0] >= first_s) & (rows[:, 0] < end_s)] for rows in (messages, answers)
    )
    seconds = end_s - first_s
    # These are noted once a second of the recording.
    used = np.ptp(resources[int(SETTLE_S) :], axis=0)
    return [
        f'{len(messages) / seconds:,.0f}',
        f'{len(answers) / seconds:.2f}',
        percentiles_ms(np.diff(answers[:, 0])),
        percentiles_ms(answers[:, 0] - answers[:, 1]),
        f'{1e3 * float(np.nanmedian(answers[:, 3])):.0f}',
        f'{100.0 * np.ptp(messages[:, 3]) / seconds:.0f} %',
        f'{100.0 * used[4] / used[0]:.0f} %',
    ]


def run(options: argparse.Namespace, ros_arguments: list[str], result: Path) -> None:
    """Replay to the node, which writes down what it notes."""
    cores = sorted(os.sched_getaffinity(0))
    node = subprocess.Popen(
        [
            *(sys.executable, '-m', 'benchmarks.load.node', str(result), '--ros-args'),
            *('--params-file', str(options.params), '-p', 'use_sim_time:=true'),
            *('--log-level', 'error', *ros_arguments),
        ]
    )
    os.sched_setaffinity(node.pid, cores[: options.cores])
    os.sched_setaffinity(0, cores[options.cores :] or cores)
    try:
        subprocess.run(
            [
                *(sys.executable, '-m', 'dg_localization.ros', 'replay', str(options.bag)),
                *('--start', options.start, '--duration', options.duration, '--wait', '60'),
            ],
            check=True,
        )
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(END_S)


def main() -> None:
    """Replay, and print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.load.recording')
    parser.add_argument('bag', type=Path, metavar='BAG')
    parser.add_argument('--params', type=Path, required=True, metavar='FILE')
    parser.add_argument('--start', default='0', metavar='S')
    parser.add_argument('--duration', default='60', metavar='S')
    parser.add_argument('--cores', type=int, default=1, help='for the node (1)')
    options, ros_arguments = parser.parse_known_args()
    warm_up()
    claim_domain()
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / 'result.npz'
        run(options, ros_arguments, result)
        with np.load(result) as noted:
            cells = row(noted)
    print(f'{machine()}\n')
    print(table(HEADER, [cells]))


if __name__ == '__main__':
    main()
