# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of inputs: templates of topics, links named one by one, and their bounds."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
import math
from typing import Any

from dg_localization.fleet import LinkKind, LinkOverride, RangeErrorModel
from dg_localization.ros.interface.links import (
    ANY_OBSERVER,
    RANGE_FIELDS,
    STAMP_OFFSET,
    Link,
    Template,
)
from dg_localization.ros.interface.parameters.spec import (
    DOUBLE,
    STRINGS,
    Section,
    Spec,
    WrongParameterError,
    by_parameters,
)
from msg_adapters import PeersReading, adapter_for

LINKS = Section(
    'Links',
    '',
    (
        Spec(
            'links',
            STRINGS,
            [],
            "inputs named one by one, 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'; "
            'each replaces what the templates give for the same measurement',
            details='NAME overrides min_error, max_error, min_error_relative, max_error_relative, '
            'sigma_factor, expected_error, expected_error_relative, min_reading or max_reading of '
            'a range, half_width or '
            'expected_error of a bearing, min_error or max_error of an elevation, any of the '
            'bounds for all that peers measure, and gives roll, pitch and yaw (rad) of a sensor '
            'of peers in the body frame of its robot; stamp_offset (s) is added to stamps. '
            'Odometry, elevations, peers and cameras have no TARGET; the OBSERVER of peers is * '
            'where their messages say who measured. A link to a robot that is not in robots is '
            'allowed: its readings are counted and rejected.',
            examples=(
                'links:',
                "  - '/uwb_1/to_2 sensor_msgs/msg/Range robot_1 robot_2 max_error=1.2'",
                "  - '/cam1/seen_2 geometry_msgs/msg/Vector3Stamped robot_1 robot_2 "
                "half_width=0.12'",
                "  - '/base_3/odom nav_msgs/msg/Odometry robot_3'",
                "  - '/base_3/seen sensor_msgs/msg/PointCloud2 robot_3'",
                "  - '/uwb uwb_ros/msg/RangeStamped *'",
            ),
        ),
        Spec(
            'ids',
            STRINGS,
            [],
            "who the ids in messages of other packages are, 'ID NAME'",
            details='NAME is a robot or an anchor, or - for an id to be passed over. Several ids '
            'may have one name. The name of a robot or an anchor stands for itself. An ID that '
            'has blanks stands in double quotes.',
            examples=("ids: ['12 robot_1', '13 robot_1', 'tag36h11:4 robot_2', 'chair -']",),
        ),
        Spec(
            'adapter_modules',
            STRINGS,
            [],
            'Python modules to import at start, which register adapters of message types',
            examples=("adapter_modules: ['tag_adapter']",),
        ),
    ),
)


def stamp_offset_spec(kind: LinkKind) -> Spec:
    """Return the parameter that corrects the stamps of all inputs of a kind."""
    return Spec(
        f'{kind}.{STAMP_OFFSET}',
        DOUBLE,
        0.0,
        'what is added to stamps, negative where they are late',
        's',
        details='A link may have a `stamp_offset` of its own.',
    )


def stamp_offset(values: Mapping[str, Any], kind: LinkKind) -> dict[str, float]:
    """Return what links of a kind override where they do not say it themselves."""
    offset_s = values.get(f'{kind}.{STAMP_OFFSET}', 0.0)
    return {STAMP_OFFSET: offset_s} if offset_s else {}


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


MEASURE_OTHERS = (LinkKind.RANGE, LinkKind.BEARING, LinkKind.PEERS)
BEARING_FIELDS = {
    'half_width': 'bearing_half_width_rad',
    'expected_error': 'bearing_expected_error_rad',
}


def range_error_from(values: Mapping[str, Any]) -> RangeErrorModel:
    """Return the bounds of all ranges."""
    expected_error = values['range.expected_error']
    return RangeErrorModel(
        min_error_m=values['range.min_error'],
        max_error_m=values['range.max_error'],
        min_error_relative=values['range.min_error_relative'],
        max_error_relative=values['range.max_error_relative'],
        sigma_factor=values['range.sigma_factor'],
        beyond_max_is_far=values['range.beyond_max_is_far'],
        expected_error_m=None if math.isnan(expected_error) else expected_error,
        expected_error_relative=values['range.expected_error_relative'],
        min_reading_m=values['range.min_reading'],
        max_reading_m=values['range.max_reading'],
    )


def overrides_from(
    links: Iterable[Link], points: Iterable[str], values: Mapping[str, Any]
) -> tuple[LinkOverride, ...]:
    """
    Gather the bounds of ranges and of bearings between the same two points.

    Each reading has the bounds of its own link. These here are for what is said of two points,
    whatever measured them: the widest where several links do.
    """
    robot_of = {sensor: sensor.rpartition('/')[0] for sensor in values['mounts.names']}
    robots = {point: robot_of.get(point, point) for point in points}
    gathered: dict[tuple[str, str], LinkOverride] = {}
    for link in links:
        try:
            stated = _stated(link, values)
            for pair in _pairs(link, robots) if stated else ():
                override = LinkOverride(*pair, **stated)
                gathered[pair] = _widest(gathered.get(pair, override), override)
        except ValueError as error:
            raise WrongParameterError(
                f"parameter 'links': the bounds of '{link.topic}' are not allowed: "
                f'{by_parameters(str(error))}'
            ) from None
    return tuple(gathered.values())


def _stated(link: Link, values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the bounds of all that a link measures.

    Of peers with ids of their own only those that it names: they may be ranges or rays.
    """
    kind, stated = link.key.kind, dict[str, Any]()
    if kind not in MEASURE_OTHERS:
        return stated
    is_cloud = adapter_for(link.type_name).value_class is PeersReading
    of_ranges = () if kind is LinkKind.BEARING else tuple(RANGE_FIELDS)
    if not link.overrides.keys().isdisjoint(of_ranges) or is_cloud or kind is LinkKind.RANGE:
        stated['range_error'] = link.range_error_within(range_error_from(values))
    for name, field in BEARING_FIELDS.items():
        stands = name in link.overrides or is_cloud or kind is LinkKind.BEARING
        if name not in of_ranges and stands:
            stated[field] = link.overrides.get(name, values[f'bearing.{name}'])
    return stated


def _widest(first: LinkOverride, second: LinkOverride) -> LinkOverride:
    """Return the bounds that hold for the readings of both."""
    models = [one.range_error for one in (first, second) if one.range_error is not None]
    half_widths = _known(first.bearing_half_width_rad, second.bearing_half_width_rad)
    errors = _known(first.bearing_expected_error_rad, second.bearing_expected_error_rad)
    return replace(
        first,
        range_error=None if not models else reduce(_widest_range, models),
        bearing_half_width_rad=max(half_widths, default=None),
        bearing_expected_error_rad=errors[0] if len(set(errors)) == 1 else None,
    )


def _known(*values: float | None) -> list[float]:
    return [value for value in values if value is not None]


def _widest_range(first: RangeErrorModel, second: RangeErrorModel) -> RangeErrorModel:
    """Return the bounds that hold for the ranges of both, for every reading."""
    agree = (first.expected_error_m, first.expected_error_relative) == (
        second.expected_error_m,
        second.expected_error_relative,
    )
    shares = [
        share
        for one in (first, second)
        for share in (one.min_error_relative, one.max_error_relative)
    ]
    return replace(
        first,
        min_error_m=min(first.min_error_m, second.min_error_m),
        max_error_m=max(first.max_error_m, second.max_error_m),
        min_error_relative=min(shares),
        max_error_relative=max(shares),
        sigma_factor=max(first.sigma_factor, second.sigma_factor),
        min_reading_m=min(first.min_reading_m, second.min_reading_m),
        max_reading_m=max(first.max_reading_m, second.max_reading_m),
        expected_error_m=first.expected_error_m if agree else None,
        expected_error_relative=first.expected_error_relative if agree else 0.0,
    )


def _pairs(link: Link, robots: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """
    Yield each observer and target of a link; a link to peers has all targets on other robots.

    Parameters
    ----------
    link : Link
    robots : mapping of str to str
        By point, the robot that it is on; other points are on themselves.

    """
    if link.key.target:
        yield link.key.ends
        return
    for one in robots if link.key.observer == ANY_OBSERVER else (link.key.observer,):
        yield from ((one, other) for other in robots if robots[one] != robots[other])


def ends_of(link: Link) -> set[str]:
    """Return the observer and the target of a link."""
    return {link.key.observer, link.key.target}
