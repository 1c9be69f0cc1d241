# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The inputs that checked parameters state: templates of topics, links, ids, and their bounds."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from dg_localization.fleet import FleetConfig, LinkKind
from dg_localization.ros.interface.identities import IGNORED, parse_ids
from dg_localization.ros.interface.links import KINDS, STAMP_OFFSET, Link, Template, parse_link
from dg_localization.ros.interface.parameters.spec import WrongParameterError, refused

TEMPLATE_TYPES = {
    f'{kind}.topic': one.template_type for kind, one in KINDS.items() if one.template_type
}


def _stamp_offset(values: Mapping[str, Any], kind: LinkKind) -> dict[str, float]:
    """Return what links of a kind override where they do not say it themselves."""
    offset_s = values.get(f'{kind}.{STAMP_OFFSET}', 0.0)
    return {STAMP_OFFSET: offset_s} if offset_s else {}


def templates_from(
    values: Mapping[str, Any], resolve: Callable[[str], str], points: Sequence[str]
) -> tuple[Template, ...]:
    """Return the templates, with the full names of their topics; each has topics of its own."""
    templates: list[Template] = []
    names: dict[str, str] = {}
    for name, type_name in TEMPLATE_TYPES.items():
        template = Template(values[name], type_name)
        with refused(f"parameter '{name}': '{values[name]}' is not allowed, "):
            template.check()
            offset = _stamp_offset(values, template.kind)
            template = replace(template.resolved(resolve), overrides=offset)
            template.check_names(points)
            if template.shape in names:
                raise ValueError(
                    f"its topics are those of '{names[template.shape]}', it must have topics of "
                    'its own'
                )
        if template.text:
            names[template.shape] = name
            templates.append(template)
    return tuple(templates)


def links_from(values: Mapping[str, Any], resolve: Callable[[str], str]) -> tuple[Link, ...]:
    """Return the links that are named one by one, with the full names of their topics."""
    links = []
    # A list of one empty string is how ROS 1 and 2 users write an empty list of strings.
    for text in filter(None, values['links']):
        with refused(f"parameter 'links': '{text}' is not allowed: "):
            link = parse_link(text)
            topic = resolve(link.topic)
            if resolve(topic) != topic:
                # A subscription to it would be remapped once more.
                raise ValueError(
                    f"its topic is remapped to '{topic}', and that to '{resolve(topic)}': name "
                    'the topic that is meant'
                )
        overrides = {**_stamp_offset(values, link.key.kind), **link.overrides}
        links.append(replace(link, topic=topic, overrides=overrides))
    for topic, count in Counter(link.topic for link in links).items():
        if count > 1:
            raise WrongParameterError(
                f"parameter 'links': topic '{topic}' is named twice, it can carry one link only"
            )
    for key, count in Counter(link.key for link in links).items():
        if key.kind is LinkKind.ODOMETRY and count > 1:
            # Steps from a pose of one to a pose of the other are no steps of the robot.
            text = f"the odometry of '{key.observer}' is named {count} times, not once"
            raise WrongParameterError(f"parameter 'links': {text}")
    return tuple(links)


def ids_from(values: Mapping[str, Any], points: Sequence[str]) -> dict[str, str]:
    """Return who the ids in messages are."""
    with refused("parameter 'ids': "):
        ids = parse_ids(filter(None, values['ids']))
        for name in ids.values():
            if name not in (*points, IGNORED):
                allowed = f"one of {', '.join(points)}, or '{IGNORED}' for nobody"
                raise ValueError(f"'{name}' is not allowed, it must be {allowed}")
    return ids


def check_links(links: Iterable[Link], fleet: FleetConfig) -> None:
    """Refuse links with bounds that are none, and between two points of one robot."""
    for link in links:
        with refused(f"parameter 'links': the bounds of '{link.topic}' are not allowed: "):
            link.bounds_within(fleet.sensor_bounds)
        robot, other = map(fleet.robot_of, link.key.ends)
        if robot == other:
            raise WrongParameterError(
                f"parameter 'links': {'->'.join(link.key.ends)} is not allowed, both are on robot "
                f"'{robot}', it must join points of two robots or anchors"
            )
