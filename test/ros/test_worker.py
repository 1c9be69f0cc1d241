# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The thread that estimates."""

from concurrent.futures import ThreadPoolExecutor
import os
import subprocess
import sys
from threading import Event, get_native_id
import time

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from dg_localization import SolverOptions  # noqa: E402
from dg_localization.fleet import FleetConfig  # noqa: E402
from dg_localization.ros.node.worker import (  # noqa: E402  # noqa: E402
    MOST_STUCK,
    NICENESS,
    EstimateWorker,
    Watchdog,
    longest_estimate_s,
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


def test_restarted_worker_answers_although_the_first_estimate_hangs(make_worker):
    release, hanging, woken, wakes = Event(), Event(), Event(), []

    def estimate(snapshot, cancel):
        if snapshot == 'hangs':
            hanging.set()
            assert release.wait(DEADLINE_S)
        return snapshot

    def wake():
        wakes.append(1)
        woken.set()

    worker = make_worker(estimate, wake)
    assert worker.busy_s == 0.0
    worker.submit('hangs')
    assert hanging.wait(DEADLINE_S)
    assert worker.busy_s > 0.0
    assert worker.restart() and not worker.busy
    worker.submit('answers')
    assert woken.wait(DEADLINE_S)
    release.set()
    assert worker.take() == 'answers'
    assert len(wakes) == 1


def test_worker_is_not_restarted_while_too_many_threads_are_stuck(make_worker):
    release = Event()
    worker = make_worker(lambda snapshot, cancel: release.wait(DEADLINE_S))
    for _ in range(MOST_STUCK):
        worker.submit(None)
        assert worker.restart()
    worker.submit(None)
    assert not worker.restart() and worker.busy
    release.set()
    worker.cancel()
    for _ in range(MOST_STUCK + 1):
        # What has ended after all counts no more.
        worker.submit(None)
        while not worker.take():
            time.sleep(0.01)
        assert worker.restart()


def test_time_of_the_processor_is_that_of_the_estimate(make_worker):
    release, done = Event(), Event()

    def estimate(snapshot, cancel):
        while snapshot == 'works' and time.thread_time() < 0.3:
            pass
        done.set()
        assert release.wait(DEADLINE_S)

    worker = make_worker(estimate)
    assert worker.cpu_s == 0.0
    worker.submit('works')
    assert done.wait(DEADLINE_S)
    assert 0.2 < worker.cpu_s <= worker.busy_s
    assert worker.restart()
    done.clear()
    worker.submit('waits')
    assert done.wait(DEADLINE_S)
    time.sleep(0.3)
    assert worker.cpu_s < 0.1 < 0.3 < worker.busy_s
    release.set()


def test_an_estimate_may_take_all_the_time_that_parameters_give_it():
    given = SolverOptions(max_seconds=1.5)
    fleet = FleetConfig(['a'], solver=given, memory_max_seconds=30.0, max_conflict_seconds=4.0)
    watchdog = Watchdog(longest_estimate_s(fleet))
    assert not watchdog.is_late(35.0) and not watchdog.is_hopeless(35.0, 35.0)
    assert watchdog.is_late(36.0)


def test_watchdog_knows_a_late_estimate_from_one_that_is_stuck():
    watchdog = Watchdog(2.0)
    assert watchdog.is_late(2.1) and not watchdog.is_late(2.0)
    # A fiftieth of a processor is little, but it gets on.
    assert not any(watchdog.is_hopeless(busy_s, busy_s / 50.0) for busy_s in range(1, 400))
    assert not watchdog.is_hopeless(0.0, 0.0)
    # It stands still.
    assert not any(watchdog.is_hopeless(busy_s, min(busy_s, 2.0)) for busy_s in range(1, 13))
    assert watchdog.is_hopeless(13.0, 2.0)
    # The next one, which runs for ever.
    assert not any(watchdog.is_hopeless(busy_s, 0.9 * busy_s) for busy_s in range(1, 12))
    assert watchdog.is_hopeless(12.0, 10.8)
    # One after another, each seen once: the second has used less, and is not stuck.
    assert not watchdog.is_hopeless(3.0, 3.0)
    assert not watchdog.is_hopeless(4.0, 0.1)
    assert not watchdog.is_hopeless(13.5, 0.5)
    # Idle in between.
    assert not watchdog.is_hopeless(0.0, 0.0)
    assert not watchdog.is_hopeless(9.0, 0.0)


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
