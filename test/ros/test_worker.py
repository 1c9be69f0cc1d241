# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The thread that estimates."""

from concurrent.futures import ThreadPoolExecutor
import os
import subprocess
import sys
from threading import Event, get_native_id

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization import SolverOptions  # noqa: E402
from dg_localization.fleet import FleetConfig  # noqa: E402
from dg_localization.ros.node.worker import (  # noqa: E402  # noqa: E402
    NICENESS,
    EstimateWorker,
    longest_estimate_s,
    patience_s,
)

DEADLINE_S = 60.0


@pytest.fixture
def make_worker():
    made = []

    def make(estimate, wake=lambda: None, **warm_up):
        made.append(EstimateWorker(estimate, wake, **warm_up))
        return made[-1]

    yield make
    for worker in made:
        worker.close()


@pytest.mark.skipif(sys.platform != 'linux', reason='threads have no priority of their own')
def test_receiving_comes_before_estimating(make_worker):
    def niceness():
        return os.getpriority(os.PRIO_PROCESS, get_native_id())

    def estimate(snapshot, cancel):
        inner = ThreadPoolExecutor(1)
        return niceness(), inner.submit(niceness).result()

    woken = Event()
    worker = make_worker(estimate, woken.set)
    worker.submit(1)
    assert woken.wait(DEADLINE_S)
    lower = min(19, niceness() + NICENESS)
    assert worker.take() == (lower, lower)


def test_defect_comes_out_of_take(make_worker):
    woken = Event()
    worker = make_worker(lambda snapshot, cancel: 1 // snapshot, woken.set)
    worker.submit(0)
    assert woken.wait(DEADLINE_S)
    with pytest.raises(ZeroDivisionError):
        worker.take()
    assert not worker.busy


def test_cancelled_answer_is_never_seen_and_the_next_one_is(make_worker):
    running, woken, wakes = Event(), Event(), []

    def estimate(snapshot, cancel):
        running.set()
        if snapshot == 'slow':
            assert cancel.wait(DEADLINE_S)
        return snapshot

    def wake():
        wakes.append(1)
        woken.set()

    worker = make_worker(estimate, wake)
    worker.submit('slow')
    assert running.wait(DEADLINE_S)
    worker.cancel()
    assert not worker.busy
    worker.submit('fast')
    assert woken.wait(DEADLINE_S)
    assert worker.take() == 'fast'
    assert len(wakes) == 1


def test_warm_up_comes_first_and_no_cancel_stops_it(make_worker):
    release, warm, answered, done = Event(), Event(), Event(), []

    def warm_up():
        assert release.wait(DEADLINE_S)
        done.append('warm-up')

    worker = make_worker(
        lambda snapshot, cancel: done.append(snapshot),
        answered.set,
        warm_up=warm_up,
        warm=warm.set,
    )
    worker.submit('dropped')
    worker.cancel()
    worker.submit('estimate')
    assert not worker.warm_up.done()
    release.set()
    assert warm.wait(DEADLINE_S)
    assert answered.wait(DEADLINE_S)
    assert done == ['warm-up', 'dropped', 'estimate']


def test_an_estimate_may_take_all_the_time_that_parameters_give_it():
    given = SolverOptions(max_seconds=1.5)
    fleet = FleetConfig(['a'], solver=given, memory_max_seconds=30.0, max_conflict_seconds=4.0)
    assert longest_estimate_s(fleet) == 35.5
    assert (patience_s(35.5), patience_s(0.2)) == (177.5, 10.0)


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
    assert subprocess.run([sys.executable, '-c', code], timeout=60.0).returncode == 3
