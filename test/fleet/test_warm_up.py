# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The warm-up: afterwards no estimate waits for a kernel."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

# Without numba there is nothing to compile.
pytest.importorskip('numba', reason='numba is not installed')

HERE = Path(__file__).parent

WARMED_UP = """
import sys
from numba.core.dispatcher import Dispatcher
from dg_localization.fleet import warm_up

def compiled():
    modules = [m for name, m in list(sys.modules.items()) if name.startswith('dg_localization.')]
    values = [value for module in modules for value in vars(module).values()]
    kernels = {value for value in values if isinstance(value, Dispatcher)}
    return {k.py_func.__qualname__: len(k.signatures) for k in kernels if k.signatures}

warm_up()
before = compiled()
"""

SIMULATED_FLEETS = """
import math
import numpy as np
from dg_localization.fleet import Anchor, FleetConfig, Localizer
from dg_localization.simulation import moving_fleet as simulation

state = simulation.FleetMotion().state(0.0)
sensors = simulation.FleetSensors()
for cameras in (False, True):
    localizer = Localizer(FleetConfig(robots=simulation.ROBOTS))
    for r in sensors.ranges(state):
        localizer.add_range(r.observer, r.target, r.range_m, 1.0, 1.0)
    for b in sensors.bearings(state) if cameras else ():
        localizer.add_bearing(b.observer, b.target, b.ray, 1.0, 1.0)
    assert localizer.step(1.0).placements
for count in (2, 3):
    robots = simulation.ROBOTS[:count]
    config = FleetConfig(robots=robots, anchors=ANCHORS, window_outliers=OUTLIERS)
    localizer = Localizer(config)
    for step in range(10):
        now_s = 1.0 + 0.2 * step
        for i, robot in enumerate(config.robots):
            orientation = [0.0, 0.0, np.sin(0.05 * step), np.cos(0.05 * step)]
            localizer.add_odometry(robot, [0.1 * step, 0.0, 0.0], orientation, now_s, now_s)
            localizer.add_range(robot, config.robots[i - 1], 3.0, now_s, now_s)
            for k, anchor in enumerate(config.anchors):
                localizer.add_range(robot, anchor, 3.0 + 0.2 * i + 0.1 * k, now_s, now_s)
                localizer.add_bearing(robot, anchor, [1.0, 0.1 * k, 0.0], now_s, now_s)
        localizer.step(now_s)
places = {'a': (0.0, 0.0), 'b': (4.0, 0.0), 'c': (0.0, 4.0)}
mounts = {'left': (0.0, 0.3), 'right': (0.3, 0.0)}
anchors = {name: Anchor(place) for name, place in places.items()}
localizer = Localizer(FleetConfig(['r'], anchors=anchors, mounts={'r': mounts}))
for sensor, (x, y) in mounts.items():
    for name, place in places.items():
        range_m = math.dist(place, (2.0 + x, 2.0 + y))
        localizer.add_range(f'r/{sensor}', name, range_m, 1.0, 1.0)
assert localizer.step(1.0).placements
"""


DRAWN_FLEETS = """
import histories
import space_histories

# Every twentieth is long enough for filters: here of robots among anchors, and of two alone.
for seed in (1, 2, 20, 40):
    histories.play_seed(seed)
for seed in range(3):
    space_histories.play_seed(seed)
"""


SOLVED_FLEETS = """
from benchmarks.pieces import TABLES
from dg_localization import SolverOptions, solve

rows = [row for table in TABLES.values() for row in table if row.n_points in (20, 50)]
for row in rows:
    for hypothesis in solve(row.problem(0), SolverOptions(max_seconds=0.2)).hypotheses:
        hypothesis.proved, hypothesis.upper
"""

NOTHING_WAS_COMPILED = """
assert before and compiled() == before, set(compiled().items()) - set(before.items())
"""


def check(code):
    """Run some code in a process that is warmed up; it may compile nothing."""
    code = WARMED_UP + code + NOTHING_WAS_COMPILED
    folder = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(HERE), *sys.path])}
    subprocess.run([sys.executable, '-c', code], check=True, timeout=250.0, env=folder)


@pytest.mark.parametrize('anchors', ['{}', "{'a': Anchor((0, 0)), 'b': Anchor((4, 0))}"])
@pytest.mark.parametrize('outliers', ['0', '1'])
def test_simulated_fleets_compile_nothing(anchors, outliers):
    check(SIMULATED_FLEETS.replace('ANCHORS', anchors).replace('OUTLIERS', outliers))


def test_fleets_that_are_followed_compile_nothing():
    check(DRAWN_FLEETS)


def test_fleets_of_the_solver_compile_nothing():
    check(SOLVED_FLEETS)
