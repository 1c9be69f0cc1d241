# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The subscriptions of the node: explicit links, and topics that match templates."""

from collections.abc import Callable
from copy import copy
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from dg_localization.fleet import LinkKind
from dg_localization.ros.interface.discovery import TopicFinder
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from dg_localization.ros.interface.parameters.settings import Settings
from dg_localization.ros.spinning import BATCH_S, STEADY
from msg_adapters import adapter_for

# The standard sensor-data profile, compatible with every publisher, with a longer queue: while an
# answer or the diagnostics of a large fleet are published, the executor does not receive. On an
# overloaded machine queues stay full, and messages are as old as the queue is long: with sensors
# at 10 Hz that must be less than the default `max_age`, or no message would be of use. A topic
# that several robots share has such a queue for each of them.
QUEUE_DEPTH = 8
SENSOR_DATA = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=QUEUE_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# rclpy would report publishers with incompatible QoS, which do not exist for `SENSOR_DATA`, and
# those with other types, which the finder reports.
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


class PolledGroup(CallbackGroup):
    """Subscriptions that no executor checks, because the node polls them itself."""

    def can_execute(self, entity: Any) -> bool:
        """Return False, so that an executor does not wait for the subscriptions."""
        return False


class Inputs:
    """
    Subscriptions to the inputs of a fleet.

    An executor of rclpy takes 5 ms of processor time to find which of 200 subscriptions have a
    message; polling all of them takes 0.3 ms. So a timer polls them, and the executor does not
    check them. Most pairs of a large fleet never measure each other: topics that match a template
    are subscribed to only when they exist.

    Parameters
    ----------
    node : Node
        The node that subscribes.
    settings : Settings
    take : callable
        Called with the link and the bytes of each message, and the time in s since the middleware
        received it.

    Attributes
    ----------
    finder : TopicFinder
        The finder of inputs, which also knows inputs whose topic has endpoints of other types.

    """

    def __init__(
        self, node: Node, settings: Settings, take: Callable[[Link, bytes, float], None]
    ) -> None:
        self._node = node
        self._take = take
        self._n_robots = len(settings.fleet.robots)
        self._group = PolledGroup()
        self.finder = TopicFinder(settings.templates, settings.links, settings.fleet.points)
        self._subscriptions: dict[Link, Subscription] = {}
        for link in settings.links:
            self._subscribe(link)
        # An executor calls timers before it takes a simulated time, and guard conditions after it:
        # in a fast replay of a bag, messages polled by a timer would seem to be in the future.
        self._poller = node.create_guard_condition(self._poll)
        # The node's own time stands still while a simulation pauses.
        self._timer = node.create_timer(BATCH_S, self._poller.trigger, clock=STEADY)

    @property
    def links(self) -> tuple[Link, ...]:
        """The subscribed inputs."""
        return tuple(self._subscriptions)

    def search(self) -> None:
        """Subscribe to new topics, and log topics of a wrong type once."""
        known = self.finder.wrong_types
        for link in self.finder.find(self._node.get_topic_names_and_types()):
            self._subscribe(link)
        for link in [link for link in self.links if link.key.kind is LinkKind.CAMERA]:
            self._follow_durability(link)
        for link in self.finder.passed_over:
            self._node.get_logger().warning(
                f'{link.topic}: not read: a link replaces what templates give for {link.key}; '
                'name this topic in a link, too, if both are to be read'
            )
        for link in self.finder.wrong_types.keys() - known.keys():
            types = ', '.join(self.finder.wrong_types[link])
            self._node.get_logger().warning(
                f'{link.topic}: wrong type: the topic has {types}, this input is {link.type_name}'
            )

    def drop_waiting(self) -> None:
        """Drop measurements that have arrived and were not taken yet."""
        for link, subscription in self._subscriptions.items():
            depth = 0 if link.key.kind is LinkKind.CAMERA else subscription.qos_profile.depth
            for _ in range(depth):
                if _taken_from(subscription) is None:
                    break

    def destroy(self) -> None:
        """Remove the subscriptions from the graph."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_guard_condition(self._poller)
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self.finder.wrong_types.clear()

    def _poll(self) -> None:
        """
        Take the arrived messages, one message of each topic in turn.

        If more messages arrive than can be taken, each topic still gets its turn, and so do the
        other callbacks of the node. A topic that raises does not block the others.
        """
        end_s = time.monotonic() + BATCH_S
        waiting = list(self._subscriptions.items())
        failure: Exception | None = None
        while waiting:
            asked, waiting = waiting, []
            for link, subscription in asked:
                try:
                    if self._take_from(link, subscription):
                        waiting.append((link, subscription))
                except Exception as error:
                    failure = error
            if time.monotonic() >= end_s:
                break
        if failure is not None:
            raise failure

    def _take_from(self, link: Link, subscription: Subscription) -> bool:
        """Take the next message of a topic, and return whether there was one."""
        taken = _taken_from(subscription)
        if taken is None:
            return False
        data, information = taken
        # Zero if the middleware gives no time; the clock may have been set back since.
        received_ns = information['received_timestamp'] or time.time_ns()
        self._take(link, data, max(0.0, 1e-9 * (time.time_ns() - received_ns)))
        return True

    def _follow_durability(self, link: Link) -> None:
        """Use a latched subscription to a camera topic if all publishers are latched."""
        publishers = self._node.get_publishers_info_by_topic(link.topic)
        is_latched = bool(publishers) and all(
            info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            and info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            for info in publishers
        )
        wanted = LATCHED if is_latched else SENSOR_DATA
        if publishers and self._subscriptions[link].qos_profile.durability != wanted.durability:
            self._node.destroy_subscription(self._subscriptions[link])
            self._subscribe(link, wanted)

    def _subscribe(self, link: Link, qos: QoSProfile = SENSOR_DATA) -> None:
        qos = copy(qos)
        qos.depth *= self._n_robots if link.key.observer == ANY_OBSERVER else 1
        # Raw: a message that is too long must not be decoded, and decoding must not raise here.
        self._subscriptions[link] = self._node.create_subscription(
            adapter_for(link.type_name).message_class(),
            link.topic,
            lambda _: None,  # never called: the node polls
            qos,
            callback_group=self._group,
            event_callbacks=NO_EVENTS,
            raw=True,
        )


def _taken_from(subscription: Subscription) -> tuple[bytes, dict[str, int]] | None:
    return subscription.handle.take_message(subscription.msg_type, subscription.raw)
