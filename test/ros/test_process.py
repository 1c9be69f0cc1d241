# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The node in a process of its own."""

import subprocess
import sys

CODE = """
import gc
from dg_localization.ros.node.worker import load_for_good
load_for_good()
print(gc.get_freeze_count(), len(gc.get_objects()))
"""


def test_collections_leave_out_what_the_kernels_are_made_of():
    done = subprocess.run(
        [sys.executable, '-c', CODE], capture_output=True, text=True, timeout=600, check=True
    )
    left_out, looked_at = map(int, done.stdout.split())
    assert left_out > 100 * looked_at
