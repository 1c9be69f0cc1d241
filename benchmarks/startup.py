# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a new process pays: import, compilation, loading from the cache, and no numba at all."""

from __future__ import annotations

import hashlib
import json
import os
from statistics import median
import subprocess
import sys
import tempfile
import time
from typing import Any

from benchmarks.contest import Figure
from benchmarks.problems import fleet
from dg_localization import solve

IMPORTS = 5

_IMPORT = """
import json, sys, time
begin = time.perf_counter()
import dg_localization
print(json.dumps({'seconds': time.perf_counter() - begin, 'numba': 'numba' in sys.modules}))
"""
_SOLVE = 'from benchmarks.startup import solve_twice; solve_twice()'


def solve_twice() -> None:
    """Print the times of the first two solves of a process, and the digest of the answer."""
    problem = fleet()
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        result = solve(problem)
        seconds.append(time.perf_counter() - begin)
    digest = hashlib.sha256()
    for hypothesis in result.hypotheses:
        digest.update(hypothesis.boxes.tobytes())
    print(json.dumps({'first': seconds[0], 'second': seconds[1], 'digest': digest.hexdigest()}))


def _run(code: str, **environment: str) -> dict[str, Any]:
    """Run code in a new interpreter and return what it prints."""
    done = subprocess.run(
        [sys.executable, '-c', code],
        env={**os.environ, **environment},
        check=True,
        capture_output=True,
        text=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def figures() -> list[Figure]:
    """Measure everything in new processes; compiles in an empty cache."""
    imports = [_run(_IMPORT) for _ in range(IMPORTS)]
    seconds = median(answer['seconds'] for answer in imports)
    light = not any(answer['numba'] for answer in imports)
    with tempfile.TemporaryDirectory() as cache:
        compiled = _run(_SOLVE, NUMBA_CACHE_DIR=cache)
        cached = _run(_SOLVE, NUMBA_CACHE_DIR=cache)
    python = _run(_SOLVE, NUMBA_DISABLE_JIT='1')
    slow = python['second']
    same = python['digest'] == cached['digest']
    return [
        Figure(
            'import dg_localization',
            f'{seconds * 1e3:.0f} ms{"" if light else ", numba included"}',
            'under 0.3 s, without numba',
            seconds < 0.3 and light,
        ),
        Figure('first solve on a machine (compiles)', f'{compiled["first"]:.1f} s'),
        Figure('first solve of a later process (cache)', f'{cached["first"]:.2f} s'),
        Figure('fleet without numba', f'{slow:.2f} s', 'under 1 s', slow < 1.0),
        Figure('same bounds with and without numba', 'yes' if same else 'no', 'to the bit', same),
    ]
