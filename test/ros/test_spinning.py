# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How the executables spin: what is ready together is run together."""

import gc
import itertools
import time
import weakref

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')

from rclpy.event_handler import PublisherEventCallbacks  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from dg_localization.ros.interface.patient_group import PERIOD_S, PatientGroup  # noqa: E402
from dg_localization.ros.spinning import BATCH_S, BatchExecutor  # noqa: E402

NUMBER = 20


class Counting(BatchExecutor):
    """An executor that counts how often it looks for what is ready."""

    looked = 0

    def get_nodes(self):
        self.looked += 1
        return super().get_nodes()


def make_ready(node, callback):
    guards = [node.create_guard_condition(lambda i=i: callback(i)) for i in range(NUMBER)]
    for guard in guards:
        guard.trigger()
    return guards


def test_what_is_ready_together_is_run_after_one_look(node):
    called = []
    executor = Counting(context=node.context)
    executor.add_node(node)
    make_ready(node, called.append)
    executor.spin_batch()
    assert called == list(range(NUMBER))
    assert executor.looked == 1
    executor.shutdown()


def test_a_callback_that_raises_does_not_drop_the_others(node):
    called = []

    def callback(number):
        called.append(number)
        if number == 3:
            raise ValueError('wrong')

    executor = BatchExecutor(context=node.context)
    executor.add_node(node)
    make_ready(node, callback)
    with pytest.raises(ValueError, match='wrong'):
        executor.spin_batch()
    executor.spin_batch()
    assert called == list(range(NUMBER))
    executor.shutdown()


def test_without_anything_ready_it_waits(node):
    called = []
    executor = BatchExecutor(context=node.context)
    executor.add_node(node)
    timer = node.create_timer(20.0 * BATCH_S, lambda: called.append(1))
    executor.spin_batch()
    assert called == [1]
    node.destroy_timer(timer)
    executor.shutdown()


def publisher_with_event(node, callback, group=None):
    return node.create_publisher(
        String,
        'topic',
        1,
        callback_group=group or PatientGroup(node.default_callback_group),
        event_callbacks=PublisherEventCallbacks(matched=callback, use_default_callbacks=False),
    )


def test_events_are_looked_for_once_in_a_while(node, monkeypatch):
    """Each look would take a time that grows with the square of their number."""
    (event,) = publisher_with_event(node, print).event_handlers
    now_s = 100.0
    monkeypatch.setattr('dg_localization.ros.interface.patient_group.monotonic', lambda: now_s)
    found = []
    for _ in range(300):
        found.append(event.callback_group.can_execute(event))
        now_s += 0.01 * PERIOD_S
    assert found[:3] == [True, True, False] and not any(found[5:95])
    assert sum(found) == 6


def test_an_event_that_is_looked_for_is_run_however_late(node, monkeypatch):
    (event,) = publisher_with_event(node, print).event_handlers
    now_s = 100.0
    monkeypatch.setattr('dg_localization.ros.interface.patient_group.monotonic', lambda: now_s)
    group = event.callback_group
    for waited_s in (0.0, 0.1 * PERIOD_S, 0.9 * PERIOD_S, 2.5 * PERIOD_S):
        now_s += 10.0 * PERIOD_S
        assert group.can_execute(event)
        now_s += waited_s
        assert group.can_execute(event)


def test_what_the_other_group_refuses_does_not_count(node):
    (event,) = publisher_with_event(node, print).event_handlers
    group = event.callback_group
    assert node.default_callback_group.beginning_execution(event)
    assert not any(group.can_execute(event) for _ in range(5))
    node.default_callback_group.ending_execution(event)
    assert group.can_execute(event)


def test_events_that_are_gone_are_forgotten(node, monkeypatch):
    now_s = 100.0
    monkeypatch.setattr('dg_localization.ros.interface.patient_group.monotonic', lambda: now_s)
    group = PatientGroup(node.default_callback_group)
    for _ in range(10):
        publisher = publisher_with_event(node, print, group)
        (event,) = publisher.event_handlers
        assert group.can_execute(event)
        gone = weakref.ref(event)
        node.destroy_publisher(publisher)
        del publisher, event
        gc.collect()
        assert gone() is None
        now_s += PERIOD_S
    assert len(group._allowed) == 1


def test_all_of_many_events_are_seen_in_one_look_that_takes_long(node, monkeypatch):
    """A pass over 300 events, and what runs meanwhile, take a busy executor tenths of a second."""
    group = PatientGroup(node.default_callback_group)
    seen = set()
    publishers = [
        publisher_with_event(node, lambda _, number=number: seen.add(number), group)
        for number in range(300)
    ]
    node.create_subscription(String, 'topic', lambda _: None, 1)
    began_s = time.monotonic()
    while not all(p.get_subscription_count() for p in publishers):
        assert time.monotonic() - began_s < 60.0, 'the publishers find no subscription'
        time.sleep(0.01)
    # Each question takes a millisecond of this clock.
    clock = (100.0 + 0.001 * number for number in itertools.count())
    monkeypatch.setattr('dg_localization.ros.interface.patient_group.monotonic', clock.__next__)
    executor = Counting(context=node.context)
    executor.add_node(node)
    # It would wait if nothing were ready.
    make_ready(node, lambda _: None)
    executor.spin_batch()
    assert len(seen) == len(publishers)
    assert executor.looked == 1
    executor.shutdown()


def test_no_event_is_missed(node):
    seen = []
    publisher = publisher_with_event(node, seen.append)
    executor = BatchExecutor(context=node.context)
    executor.add_node(node)
    node.create_timer(0.02, lambda: None)
    node.create_subscription(String, publisher.topic_name, lambda _: None, 1)
    began_s = time.monotonic()
    while not seen and time.monotonic() - began_s < 20.0:
        executor.spin_batch()
    assert seen
    executor.shutdown()
