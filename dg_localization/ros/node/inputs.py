# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The subscriptions of the node: the links named one by one, and topics that templates name."""

from collections.abc import Callable
from functools import partial

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from dg_localization.ros.interface.discovery import TopicFinder
from dg_localization.ros.interface.links import Link
from dg_localization.ros.interface.parameters.settings import Settings
from dg_localization.ros.interface.patient_group import PatientGroup
from msg_adapters import adapter_for

# As the profile of that name, which every publisher can serve, with a longer queue: publishing
# an answer or the diagnostics of a large fleet keeps the executor from receiving for a moment. On
# a machine that is too busy queues stay full, and what is taken is as old as they are long: with
# sensors at 10 Hz that must be less than the default `max_age`, or no message would be of use.
SENSOR_DATA = QoSProfile(depth=8, reliability=ReliabilityPolicy.BEST_EFFORT)


class Inputs:
    """
    Subscriptions to the inputs of a fleet.

    Every subscription costs the executor time at every wake-up, and most pairs of a large fleet
    never measure each other. So topics that only a template names are subscribed to once they
    exist.

    Parameters
    ----------
    node : Node
        The node that subscribes.
    settings : Settings
    take : callable
        Called with the link and the bytes of each message.

    """

    def __init__(
        self, node: Node, settings: Settings, take: Callable[[Link, bytes], None]
    ) -> None:
        self._node = node
        self._take = take
        self._group = PatientGroup(node.default_callback_group)
        self._finder = TopicFinder(settings.templates, settings.links, settings.fleet.points)
        self._subscriptions: dict[Link, Subscription] = {}
        for link in settings.links:
            self._subscribe(link)

    @property
    def links(self) -> tuple[Link, ...]:
        """The inputs that are subscribed to."""
        return tuple(self._subscriptions)

    @property
    def wrong_types(self) -> dict[Link, tuple[str, ...]]:
        """Inputs whose topic has endpoints of other types, with these types."""
        return self._finder.wrong_types

    def search(self) -> None:
        """Subscribe to topics that have come into being."""
        for link in self._finder.find(self._node.get_topic_names_and_types()):
            self._subscribe(link)

    def destroy(self) -> None:
        """Take the subscriptions off the graph."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._finder.wrong_types.clear()

    def _subscribe(self, link: Link) -> None:
        # Raw: a message that is too long must not be decoded, nor one that cannot be raise here.
        self._subscriptions[link] = self._node.create_subscription(
            adapter_for(link.type_name).message_class(),
            link.topic,
            partial(self._take, link),
            SENSOR_DATA,
            callback_group=self._group,
            raw=True,
        )
