# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Chaos: ``python -m benchmarks.chaos [--rounds N] [--minutes M] [--seed S] [--picture FILE]``.

Each disturbance happens once in a round, in an order of its own; with a time, any of them happens
next until it is over.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import random
import sys
import time

import numpy as np

from benchmarks.chaos.disturbances import DISTURBANCES
from benchmarks.chaos.run import Day, live_through
from benchmarks.report import machine, table
from dg_localization.fleet import warm_up
from dg_localization.ros.domain import claim_domain

COLORS = ('#2ca02c', '#ffbf00', '#d62728', '#7f7f7f')
LEVELS = ('OK', 'WARN', 'ERROR', 'STALE')


def in_rounds(rounds: int, seed: int) -> Iterator[str]:
    """Yield the disturbances of some rounds; the first is in the order of the table."""
    yield from DISTURBANCES
    for number in range(1, rounds):
        yield from random.Random(seed + number).sample(list(DISTURBANCES), len(DISTURBANCES))


def for_minutes(minutes: float, seed: int) -> Iterator[str]:
    """Yield any disturbances until the time is over."""
    source, end_s = random.Random(seed), time.monotonic() + 60.0 * minutes
    while time.monotonic() < end_s:
        yield source.choice(list(DISTURBANCES))


def draw(day: Day, path: str) -> None:
    """Draw the age of the answer on the screen, the status, and the disturbances."""
    import matplotlib

    matplotlib.use('Agg')
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(14.0, 4.5), layout='constrained')
    walls = [seen.wall_s for seen in day.world.seen]
    ends = [*walls[1:], walls[-1] + 0.1]
    for seen, end_s in zip(day.world.seen, ends, strict=True):
        axes.axvspan(seen.wall_s, end_s, 0.0, 0.05, color=COLORS[seen.level], lw=0)
        if seen.stamp_s is None:
            axes.axvspan(seen.wall_s, end_s, 0.05, 0.08, color='black', lw=0)
    for level, color in enumerate(COLORS):
        points = [
            (s.wall_s, max(0.0, s.now_s - s.stamp_s))
            for s in day.world.seen
            if s.stamp_s is not None and s.level == level
        ]
        if points:
            axes.plot(*zip(*points, strict=True), '.', ms=3, color=color, label=LEVELS[level])
    for outcome in day.outcomes:
        axes.axvspan(outcome.begin_s, outcome.end_s, color='#1f77b4', alpha=0.2, lw=0)
        recovery = '-' if outcome.recovery_s is None else f'{outcome.recovery_s:.1f} s'
        axes.text(
            outcome.begin_s,
            0.98,
            f'{outcome.name} ({recovery})',
            rotation=90,
            va='top',
            ha='right',
            fontsize=8,
            transform=axes.get_xaxis_transform(),
        )
    axes.set_xlim(walls[0], ends[-1])
    axes.set_ylim(-0.6, 8.0)
    axes.set_xlabel('time in s')
    axes.set_ylabel('age of the answer on the screen in s')
    axes.set_title(
        'Blue: a disturbance (and the time to recover). Dots: the answer, in the color of the '
        'status, which is also below; black: no answer',
        fontsize=9,
    )
    axes.legend(loc='upper left', fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Live through some disturbances, and print what came of them."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.chaos', description=__doc__)
    parser.add_argument('--rounds', type=int, default=1, help='how often each happens (1)')
    parser.add_argument('--minutes', type=float, help='any of them in random order for so long')
    parser.add_argument('--seed', type=int, default=0, help='of the order (0)')
    parser.add_argument('--picture', metavar='FILE', help='where to draw the timeline')
    options = parser.parse_args()
    warm_up()
    claim_domain()
    if options.minutes:
        day = live_through(for_minutes(options.minutes, options.seed))
    else:
        day = live_through(in_rounds(options.rounds, options.seed))
    lines = []
    for name in DISTURBANCES:
        times = [o.recovery_s for o in day.outcomes if o.name == name and o.recovery_s is not None]
        span = f'{np.median(times):.1f} / {max(times):.1f}' if times else '-'
        survived = f'{len(times)} of {sum(o.name == name for o in day.outcomes)}'
        lines.append([name, survived, span])
    header = 'disturbance', 'survived', 'recovery in s, median / worst'
    print(f'{machine()}\n\n' + table(header, lines))
    print(
        f'\n{len(day.outcomes)} disturbances in {day.world.wall_s / 60.0:.1f} minutes, '
        f'{day.world.answers} answers; exit code {day.exit_code}; faults: {len(day.faults)}'
    )
    for fault in day.faults:
        print(f'- {fault}')
    if options.picture:
        draw(day, options.picture)
    sys.exit(1 if day.faults else 0)


if __name__ == '__main__':
    main()
