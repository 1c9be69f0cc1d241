# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The thread that estimates."""

from concurrent.futures import ThreadPoolExecutor
import os
import sys
from threading import Event, get_native_id

from plain_python import run_python
import pytest

from dg_localization.ros.node.worker import NICENESS, EstimateWorker

DEADLINE_S = 60.0


@pytest.mark.skipif(sys.platform != 'linux', reason='threads have no priority of their own')
def test_receiving_comes_before_estimating():
    def niceness():
        return os.getpriority(os.PRIO_PROCESS, get_native_id())

    def estimate(snapshot, cancel):
        inner = ThreadPoolExecutor(1)
        return niceness(), inner.submit(niceness).result()

    woken = Event()
    worker = EstimateWorker(estimate, woken.set)
    worker.submit(1)
    assert woken.wait(DEADLINE_S)
    lower = min(19, niceness() + NICENESS)
    assert worker.take() == (lower, lower)
    worker.close()


def test_process_ends_although_the_thread_does_not():
    code = """
import sys, time
from threading import Event
from dg_localization.ros.node import worker
worker.CLOSE_S = 0.05
running = Event()
def estimate(snapshot, cancel):
    running.set()
    time.sleep(1000.0)
one = worker.EstimateWorker(estimate, print)
one.submit(None)
running.wait()
one.close()
sys.exit(worker.exit_code_despite_worker(3))
"""
    assert run_python(code).returncode == 3


FREEZING = """
import gc
from dg_localization.ros.node.worker import load_for_good
load_for_good()
print(gc.get_freeze_count(), len(gc.get_objects()))
"""


def test_collections_leave_out_what_the_kernels_are_made_of():
    done = run_python(FREEZING)
    left_out, looked_at = map(int, done.stdout.split())
    assert left_out > 100 * looked_at
