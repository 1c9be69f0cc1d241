# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What calls return in a process whose kernels run in Python."""

import os
from pathlib import Path
import pickle
import subprocess
import sys

RUN = """
import pickle, sys
calls = pickle.load(sys.stdin.buffer)
pickle.dump([call() for call in calls], sys.stdout.buffer)
"""


def in_plain_python(calls):
    finished = subprocess.run(
        [sys.executable, '-c', RUN],
        input=pickle.dumps(calls),
        capture_output=True,
        cwd=Path(__file__).parents[1],
        env=os.environ | {'NUMBA_DISABLE_JIT': '1'},
        timeout=200,
    )
    assert finished.returncode == 0, finished.stderr.decode()
    return pickle.loads(finished.stdout)
