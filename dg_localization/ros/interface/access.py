# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Every topic and service of the node, as full names: what a policy has to allow it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from rclpy.node import Node

from dg_localization.fleet import LinkKey
from dg_localization.ros.interface.links import Template
from dg_localization.ros.interface.outputs import DIAGNOSTICS, estimate_outputs
from dg_localization.ros.interface.parameters.settings import Settings
from dg_localization.ros.interface.transforms import TRANSFORM_TOPIC

RESET = '~/reset'
# The heartbeat for a lifecycle manager, where the package bondpy is installed.
BOND_TOPIC = 'bond'
# What rclpy makes of its own accord for a node, and for a managed one.
NODE_TOPICS = ('/parameter_events', '/rosout')
NODE_SERVICES = (
    '~/describe_parameters',
    '~/get_parameter_types',
    '~/get_parameters',
    '~/get_type_description',
    '~/list_parameters',
    '~/set_parameters',
    '~/set_parameters_atomically',
)
LIFECYCLE_TOPICS = ('~/transition_event',)
LIFECYCLE_SERVICES = (
    '~/change_state',
    '~/get_available_states',
    '~/get_available_transitions',
    '~/get_state',
    '~/get_transition_graph',
)
CLOCK = '/clock'


@dataclass(frozen=True)
class Access:
    """
    What the node does on the graph, as full names in alphabetical order.

    Attributes
    ----------
    publishes, subscribes : tuple of str
        Topics.
    serves : tuple of str
        Services that it offers; it calls none.

    """

    publishes: tuple[str, ...]
    subscribes: tuple[str, ...]
    serves: tuple[str, ...]


def access_of(node: Node, settings: Settings) -> Access:
    """
    Return what a localizer needs.

    Parameters
    ----------
    node : Node
        A node with its name and its remappings.
    settings : Settings

    """
    topics = [output.name for output in (*estimate_outputs(settings.fleet.robots), DIAGNOSTICS)]
    topics += [*NODE_TOPICS, *LIFECYCLE_TOPICS]
    inputs = [link.topic for link in settings.links]
    for template in settings.templates:
        inputs += _topics(template, settings)
    if settings.publish_tf:
        topics.append(TRANSFORM_TOPIC)
    if not settings.autostart:
        topics.append(BOND_TOPIC)
        inputs.append(BOND_TOPIC)
    if node.get_parameter('use_sim_time').value:
        inputs.append(CLOCK)
    services = (RESET, *NODE_SERVICES, *LIFECYCLE_SERVICES)
    return Access(
        publishes=tuple(sorted(map(node.resolve_topic_name, topics))),
        subscribes=tuple(sorted(map(node.resolve_topic_name, inputs))),
        serves=tuple(sorted(map(node.resolve_service_name, services))),
    )


def _topics(template: Template, settings: Settings) -> Iterator[str]:
    """Yield the topics of a template that carry measurements of the fleet."""
    replaced = {link.key for link in settings.links}
    for names in product(settings.fleet.points, repeat=len(template.fields)):
        if len(set(names)) < len(names):
            continue
        key = LinkKey(template.kind, names[0], names[1] if len(names) > 1 else '')
        if key not in replaced:
            yield template.text.format(**dict(zip(template.fields, names, strict=True)))
