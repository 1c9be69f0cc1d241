# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Code in processes of its own, and what calls return where kernels run in Python."""

import base64
import os
from pathlib import Path
import pickle
import subprocess
import sys

REPOSITORY = Path(__file__).parents[1]
RUN = """
import base64, pickle, sys
calls = pickle.loads(base64.b64decode(sys.stdin.read()))
print(base64.b64encode(pickle.dumps([call() for call in calls])).decode())
"""


def run_python(code, *arguments, given=None, **environment):
    """Run some code in the repository, and return the process that has ended."""
    return subprocess.run(
        [sys.executable, '-c', code, *arguments],
        input=given,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        timeout=280.0,
    )


def in_plain_python(calls):
    given = base64.b64encode(pickle.dumps(calls)).decode()
    done = run_python(RUN, given=given, NUMBA_DISABLE_JIT='1')
    assert done.returncode == 0, done.stderr
    return pickle.loads(base64.b64decode(done.stdout))
