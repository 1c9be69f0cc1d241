# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parts of the node: its time, its log, the thread that estimates, and how it is spun."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
import os
import sys
from threading import Event, get_native_id
import time
from unittest.mock import Mock, call

from plain_python import run_python
from processes import LATCHED, Listener, wait_for
import pytest
from sensor_msgs.msg import CameraInfo, Range

from dg_localization.ros.interface.diagnostics import TOLERATED_RATE
from dg_localization.ros.interface.parameters.settings import check_values, settings_from
from dg_localization.ros.node.clock import NodeTime, Pace, RateMeter
from dg_localization.ros.node.inputs import SENSOR_DATA, Inputs
from dg_localization.ros.node.lifecycle import LOOKS_BETWEEN, FleetLog
from dg_localization.ros.node.worker import NICENESS, EstimateWorker
from dg_localization.ros.spinning import BATCH_S, BatchExecutor
from msg_adapters import Level, Status

POINTS = ('a', 'b', 'c')
TOPICS = [f'/{one}/range/{other}' for one in POINTS for other in POINTS if one != other]
DEADLINE_S = 60.0


@pytest.mark.parametrize(
    ('period_s', 'until_s', 'wanted_hz', 'now_s', 'rate_hz'),
    [
        (0.2, 20.0, 5.0, 120.1, 5.0),
        (2.4, 12.0, 5.0, 112.1, 1.0 / 2.4),
        (0.2, 1.0, 5.0, 101.1, None),
        (0.2, 0.0, 5.0, 110.0, 0.1),
        (10.0, 100.0, 0.1, 209.0, 0.1),
        (10.0, 0.0, 0.1, 103.0, None),
    ],
    ids=['met', 'not met', 'too early', 'an estimate that does not end', 'slow', 'slow at first'],
)
def test_the_rate_is_that_of_the_last_estimates(period_s, until_s, wanted_hz, now_s, rate_hz):
    meter = RateMeter(wanted_hz)
    for number in range(int(until_s / period_s) + 1):
        meter.count(100.0 + number * period_s)
    assert meter.rate_hz(now_s) == (None if rate_hz is None else pytest.approx(rate_hz))
    meter.clear()
    assert meter.rate_hz(now_s) is None


def follow(pace, base_s, number=30):
    """Let estimates take some time, and all that they may spend besides."""
    for _ in range(number):
        pace.note(base_s + pace.tighten_s)


def test_bounds_are_tightened_for_as_long_as_the_rate_allows():
    pace = Pace(5.0)
    assert pace.tighten_s == pytest.approx(TOLERATED_RATE * 0.2)
    follow(pace, base_s=0.05)
    assert pace.tighten_s == pytest.approx(TOLERATED_RATE * 0.2 - 0.05)
    follow(pace, base_s=1.0)
    assert pace.tighten_s == 0.0
    follow(pace, base_s=0.02)
    assert pace.tighten_s == pytest.approx(TOLERATED_RATE * 0.2 - 0.02)


def test_at_a_low_rate_the_limit_of_the_solver_is_what_late_estimates_lower():
    pace = Pace(1.0, limit_s=0.1)
    assert pace.tighten_s == 0.1
    pace.note(TOLERATED_RATE + 0.1)
    assert pace.tighten_s == pytest.approx(0.05)
    # What is left of the period is measured by the period, not by the limit.
    pace.note(0.5)
    assert pace.tighten_s == 0.1


class TwoClocks:
    """The time of a node by a clock and a steady clock that are set by hand."""

    def __init__(self, is_simulated):
        self.read_s = 100.0, 0.0
        self.time = NodeTime(lambda: self.read_s[0], is_simulated, lambda: self.read_s[1])

    def at(self, clock_s, steady_s):
        """Set both; return the time of the node, and how far it jumped back."""
        self.read_s = clock_s, steady_s
        return self.time.now()


@pytest.mark.parametrize('step_s', [0.02, 1.0])
def test_the_steps_of_a_simulated_time_are_measured(step_s):
    clocks = TwoClocks(True)
    for number in range(100):
        clocks.at(100.0 + number // 5 * step_s, 0.0)
    assert clocks.time.step_s() == pytest.approx(step_s)


@pytest.mark.parametrize('is_simulated', [False, True])
def test_a_clock_that_was_set_back_by_less_than_since_the_last_call_is_seen(is_simulated):
    """A simulated clock may run slowly."""
    clocks = TwoClocks(is_simulated)
    assert clocks.at(100.2, 0.2) == (100.2, 0.0)
    assert clocks.at(100.3, 0.5) == (100.3, 0.0 if is_simulated else pytest.approx(0.2))
    assert (clocks.time.arrived_s(0.01) is None) is not is_simulated
    assert clocks.at(100.4, 0.6) == (100.4, 0.0)
    assert clocks.time.arrived_s(0.01) is not None


def test_what_interrupts_a_call_sets_no_clock_back():
    """The thread may have to wait between looks at the two clocks."""
    looks = iter(range(1, 1000))
    node_time = NodeTime(lambda: 100.0 + 0.07 * next(looks), False, lambda: 0.07 * next(looks))
    assert [node_time.now()[1] for _ in range(5)] == [0.0] * 5


@pytest.mark.parametrize('is_simulated, arrived_s', [(False, 97.0), (True, 100.0)])
def test_what_has_waited_arrived_before(is_simulated, arrived_s):
    """By a simulated clock, which may be paused or fast, it is not known how long it waited."""
    clocks = TwoClocks(is_simulated)
    clocks.at(100.0, 0.0)
    assert clocks.time.arrived_s(3.0) == arrived_s
    assert clocks.time.arrived_s(0.0) == 100.0


@pytest.mark.parametrize('is_simulated', [False, True])
def test_what_arrived_before_the_time_jumped_back_never_looks_new(is_simulated):
    clocks = TwoClocks(is_simulated)
    assert clocks.at(1.0, 10.0) == (1.0, 99.0)
    assert clocks.time.arrived_s(0.001) is None
    clocks.read_s = 1.0, 11.0
    assert clocks.time.arrived_s(1.001) is None
    assert clocks.time.arrived_s(0.5) is not None


def look(fleet_log, *seen):
    for level, message in seen:
        fleet_log.look(Status(level, 'localizer: fleet', message, 'fleet', {}))


def test_what_lasts_is_said_once_with_its_severity():
    logger = Mock()
    fleet_log = FleetLog(logger)
    stale = [(Level.WARN, f'all measurements are stale: the youngest is {s} s old') for s in '234']
    wrong = (Level.ERROR, 'contradiction: a - b')
    good = (Level.OK, 'localized: one hypothesis')
    for seen in (stale, [good], [wrong], [good]):
        look(fleet_log, *seen, *[seen[-1]] * LOOKS_BETWEEN)
    assert logger.method_calls == [
        call.warning('fleet: all measurements are stale: the youngest is 3 s old'),
        call.info('fleet: localized: one hypothesis'),
        call.error('fleet: contradiction: a - b'),
        call.info('fleet: localized: one hypothesis'),
    ]


def test_what_comes_and_goes_slowly_is_said_at_times():
    logger = Mock()
    good, wide = (Level.OK, 'localized'), (Level.WARN, 'one hypothesis, 6.2 m wide')
    look(FleetLog(logger), *[good, good, wide, wide] * 10 * LOOKS_BETWEEN)
    assert 10 <= len(logger.method_calls) <= 40


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


def test_what_is_ready_is_run_after_one_look_also_where_a_callback_raises(node):
    called = []

    def callback(number):
        called.append(number)
        if number == 3:
            raise ValueError('wrong')

    executor = BatchExecutor(context=node.context)
    executor.add_node(node)
    # It asks for its nodes each time that it looks for what is ready.
    executor.get_nodes = Mock(wraps=executor.get_nodes)
    guards = [node.create_guard_condition(lambda i=i: callback(i)) for i in range(20)]
    for guard in guards:
        guard.trigger()
    with pytest.raises(ValueError, match='wrong'):
        executor.spin_batch()
    assert executor.get_nodes.call_count == 1
    executor.spin_batch()
    assert called == list(range(20))
    executor.shutdown()


def connected(node, take):
    """Return inputs that have found a publisher for every topic, and the publishers."""
    publishers = [node.create_publisher(Range, topic, SENSOR_DATA) for topic in TOPICS]
    inputs = Inputs(node, settings_from(check_values({'robots': POINTS})), take)

    def found():
        inputs.search()
        return all(publisher.get_subscription_count() for publisher in publishers)

    wait_for(found)
    return inputs, publishers


def test_every_message_of_every_topic_is_taken_once(node):
    taken = Counter()
    inputs, publishers = connected(node, lambda link, *_: taken.update([link.topic]))
    for _ in range(SENSOR_DATA.depth):
        for publisher in publishers:
            publisher.publish(Range())
    Listener(node, {}).spin_until(lambda: taken.total() >= SENSOR_DATA.depth * len(TOPICS))
    assert taken == dict.fromkeys(TOPICS, SENSOR_DATA.depth)
    inputs.destroy()


def test_the_matrix_that_a_camera_published_before_the_start_is_taken(node):
    node.create_publisher(CameraInfo, '/a/info', LATCHED).publish(CameraInfo())
    taken = []
    given = {'robots': POINTS, 'links': ['/a/info sensor_msgs/msg/CameraInfo a']}
    inputs = Inputs(node, settings_from(check_values(given)), lambda *one: taken.append(one))
    node.create_timer(0.05, inputs.search)
    listener = Listener(node, {})
    assert listener.spin_until(lambda: taken)
    # Another camera on the topic that keeps nothing is heard, too.
    other = node.create_publisher(CameraInfo, '/a/info', SENSOR_DATA)
    node.create_timer(0.05, lambda: other.publish(CameraInfo(width=7)))
    assert listener.spin_until(lambda: len(taken) > 1)
    inputs.destroy()


def test_where_more_arrives_than_can_be_taken_all_topics_have_their_turn(node):
    taken = Counter()

    def take_slowly(link, *_):
        taken.update([link.topic])
        time.sleep(2.0 * BATCH_S)
        if link.topic == TOPICS[0]:
            raise ValueError('wrong')

    inputs, publishers = connected(node, take_slowly)
    for _ in range(SENSOR_DATA.depth):
        for publisher in publishers:
            publisher.publish(Range())
    time.sleep(0.5)
    # Nor does one that raises keep the others from their turn.
    with pytest.raises(ValueError, match='wrong'):
        inputs._poll()
    assert taken == dict.fromkeys(TOPICS, 1)
    inputs.destroy()
