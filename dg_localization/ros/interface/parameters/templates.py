# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the topics of inputs are named like, by their parameters."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from dg_localization.ros.interface.links import Template
from dg_localization.ros.interface.parameters.links import stamp_offset
from dg_localization.ros.interface.parameters.spec import WrongParameterError

TEMPLATE_TYPES = {
    'range.topic': 'sensor_msgs/msg/Range',
    'bearing.topic': 'geometry_msgs/msg/Vector3Stamped',
    'odometry.topic': 'nav_msgs/msg/Odometry',
    'peers.topic': 'sensor_msgs/msg/PointCloud2',
    'elevation.topic': 'geometry_msgs/msg/PointStamped',
}


def templates_from(
    values: Mapping[str, Any], resolve: Callable[[str], str], points: Sequence[str]
) -> tuple[Template, ...]:
    """
    Return the templates, with the full names of their topics.

    Parameters
    ----------
    values : mapping of str to object
        What `check_values` returned.
    resolve : callable
        Returns the full name of a topic.
    points : sequence of str
        Robots, anchors and sensors.

    Raises
    ------
    WrongParameterError
        If one is no template, or topics have more than one meaning.

    """
    templates: list[Template] = []
    names: dict[str, str] = {}
    for name, type_name in TEMPLATE_TYPES.items():
        template = Template(values[name], type_name)
        try:
            template.check()
            offset = stamp_offset(values, template.kind)
            template = replace(template.resolved(resolve), overrides=offset)
            template.check_names(points)
            if template.shape in names:
                raise ValueError(
                    f"its topics are those of '{names[template.shape]}', and each kind of "
                    'measurement needs topics of its own'
                )
        except ValueError as error:
            raise WrongParameterError(
                f"parameter '{name}': '{values[name]}' is not allowed, {error}"
            ) from None
        if template.text:
            names[template.shape] = name
            templates.append(template)
    return tuple(templates)
