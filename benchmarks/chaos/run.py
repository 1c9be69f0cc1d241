# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One disturbance after the other, and what the node made of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

from benchmarks.chaos.disturbances import DISTURBANCES
from benchmarks.chaos.world import World, parameters

START_S = 90.0
RECOVERY_S = 60.0
CALM_S = 0.5
EMPTIED_S = 10.0
# The node calls an answer late after this. Its diagnostics come once a second, on a busy machine
# somewhat later.
OLD_S = 1.0
TOLD_S = 4.0


@dataclass(frozen=True)
class Outcome:
    """
    What came of one disturbance; times are on the clock of the wall, from the start.

    Attributes
    ----------
    name : str
    begin_s, end_s : float
    recovery_s : float or None
        From its end to the first answer about it that has all robots; None if there was none.

    """

    name: str
    begin_s: float
    end_s: float
    recovery_s: float | None


@dataclass(frozen=True)
class Day:
    """All that happened."""

    outcomes: list[Outcome]
    world: World
    faults: list[str]
    exit_code: int
    output: str


def live_through(names: Iterable[str]) -> Day:
    """Start a node, let the disturbances of these names happen one by one, and stop it."""
    outcomes: list[Outcome] = []
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        slow, log = Path(folder) / 'slow', Path(folder) / 'log'
        with log.open('w') as output:
            node = subprocess.Popen(
                [sys.executable, '-m', 'benchmarks.chaos.node', str(slow), *parameters()],
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        world = World()
        try:
            if not _recovered(world, START_S):
                faults.append('the node has not started')
            for name in names:
                if node.poll() is not None:
                    faults.append(f'the node has ended before: {name}')
                    break
                outcomes.append(_disturb(world, name, slow, faults))
        finally:
            slow.unlink(missing_ok=True)
            node.send_signal(signal.SIGINT)
            code = node.wait(RECOVERY_S)
            world.close()
        faults += [*world.faults, *old_ones(world)]
        return Day(outcomes, world, faults, code, log.read_text())


def _disturb(world: World, name: str, slow: Path, faults: list[str]) -> Outcome:
    """Let one disturbance happen, and wait for an answer."""
    disturbance, seconds, leaves_none = DISTURBANCES[name]
    world.until(lambda: False, CALM_S)
    begin_s = world.wall_s
    with disturbance(world, slow):
        world.until(lambda: False, seconds)
        if leaves_none and not world.until(lambda: world.screen_is_empty, EMPTIED_S):
            faults.append(f'{name}: an answer still stands')
    end_s = world.wall_s
    recovered = _recovered(world, RECOVERY_S)
    if not recovered:
        faults.append(f'{name}: no answer within {RECOVERY_S:.0f} s')
    return Outcome(name, begin_s, end_s, world.wall_s - end_s if recovered else None)


def _recovered(world: World, seconds: float) -> bool:
    """Wait for an answer that has all robots, about a time from now on."""
    asked_s = world.now_s
    world.complete_stamp_s = -float('inf')
    return world.until(lambda: world.complete_stamp_s >= asked_s, seconds)


def old_ones(world: World) -> list[str]:
    """Return where an old answer looked new: nobody was told for long that it is old."""
    faults, since_s = [], None
    for seen in world.seen:
        is_old = seen.stamp_s is not None and seen.now_s - seen.stamp_s > OLD_S
        if not is_old or seen.level != 0:
            since_s = None
        elif since_s is None:
            since_s = seen.wall_s
        elif seen.wall_s - since_s > TOLD_S:
            faults.append(f'at {seen.wall_s:.1f} s an answer of {seen.stamp_s:.2f} looks new')
            since_s = None
    return faults
