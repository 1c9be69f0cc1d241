# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The warm-up: afterwards no estimate waits for a kernel."""

import subprocess
import sys

import pytest

# Without numba there is nothing to compile.
pytest.importorskip('numba', reason='numba is not installed')

CODE = """
import sys
from numba.core.dispatcher import Dispatcher
from dg_localization.fleet import FleetConfig, Localizer, warm_up
from dg_localization.simulation import moving_fleet as simulation

def compiled():
    modules = [m for name, m in list(sys.modules.items()) if name.startswith('dg_localization.')]
    values = [value for module in modules for value in vars(module).values()]
    kernels = {value for value in values if isinstance(value, Dispatcher)}
    return {k.py_func.__qualname__: len(k.signatures) for k in kernels if k.signatures}

warm_up()
before = compiled()
state = simulation.FleetMotion().state(0.0)
sensors = simulation.FleetSensors()
for cameras in (False, True):
    localizer = Localizer(FleetConfig(robots=simulation.ROBOTS))
    for r in sensors.ranges(state):
        localizer.add_range(r.observer, r.target, r.range_m, 1.0, 1.0)
    for b in sensors.bearings(state) if cameras else ():
        localizer.add_bearing(b.observer, b.target, b.ray, 1.0, 1.0)
    assert localizer.step(1.0).placements
assert before and compiled() == before, (before, compiled())
"""


def test_nothing_is_left_to_compile():
    subprocess.run([sys.executable, '-c', CODE], check=True, timeout=250.0)
