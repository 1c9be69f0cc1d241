# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The inputs that checked parameters state: templates of topics, links, ids, and their bounds."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from dg_localization.fleet import ElevationErrorModel, LinkKind, LinkOverride, RangeErrorModel
from dg_localization.ros.interface.identities import IGNORED, parse_ids
from dg_localization.ros.interface.links import (
    ANY_OBSERVER,
    KINDS,
    STAMP_OFFSET,
    Link,
    Template,
    parse_link,
)
from dg_localization.ros.interface.parameters.spec import WrongParameterError, refused

TEMPLATE_TYPES = {
    f'{kind}.topic': one.template_type for kind, one in KINDS.items() if one.template_type
}
BEARING_FIELDS = {
    'half_width': 'bearing_half_width_rad',
    'expected_error': 'bearing_expected_error_rad',
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
                    f"its topics are those of '{names[template.shape]}', and each kind of "
                    'measurement needs topics of its own'
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
                    f"its topic is remapped to '{topic}', and that to '{resolve(topic)}'; name "
                    'the right topics in the links instead'
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
            raise WrongParameterError(
                f"parameter 'links': the odometry of '{key.observer}' is named {count} times, a "
                'robot can have one only'
            )
    return tuple(links)


def ids_from(values: Mapping[str, Any], points: Sequence[str]) -> dict[str, str]:
    """Return who the ids in messages are."""
    with refused("parameter 'ids': "):
        ids = parse_ids(filter(None, values['ids']))
        for name in ids.values():
            if name not in (*points, IGNORED):
                raise ValueError(
                    f"'{name}' is not allowed, it must be one of {', '.join(points)}, or "
                    f"'{IGNORED}' for an id that stands for nobody"
                )
    return ids


def overrides_from(
    links: Iterable[Link],
    points: Iterable[str],
    values: Mapping[str, Any],
    of_all: RangeErrorModel,
) -> tuple[LinkOverride, ...]:
    """
    Gather the bounds of ranges and of bearings between the same two points.

    Each reading has the bounds of its own link. These here are for what is said of two points,
    whatever measured them: the widest where several links do. A link may name a robot that is not
    in the fleet today: its readings are counted and rejected, its bounds concern nobody.
    """
    robot_of = {sensor: sensor.rpartition('/')[0] for sensor in values['mounts.names']}
    robots = {point: robot_of.get(point, point) for point in points}
    gathered: dict[tuple[str, str], LinkOverride] = {}
    for link in links:
        if not {link.key.observer, link.key.target} <= {*robots, '', ANY_OBSERVER}:
            continue
        with refused(f"parameter 'links': the bounds of '{link.topic}' are not allowed: "):
            stated = _stated(link, values, of_all)
            for pair in _pairs(link, robots) if stated else ():
                override = LinkOverride(*pair, **stated)
                gathered[pair] = _widest(gathered.get(pair, override), override)
    return tuple(gathered.values())


def _stated(link: Link, values: Mapping[str, Any], of_all: RangeErrorModel) -> dict[str, Any]:
    """Return the bounds of what a link measures; peers may be ranges and rays."""
    kind, stated = link.key.kind, dict[str, Any]()
    if kind in (LinkKind.RANGE, LinkKind.PEERS):
        stated['range_error'] = link.range_error_within(of_all)
    if kind in (LinkKind.BEARING, LinkKind.PEERS):
        for name, field in BEARING_FIELDS.items():
            stated[field] = link.overrides.get(name, values[f'bearing.{name}'])
    return stated


def _widest(first: LinkOverride, second: LinkOverride) -> LinkOverride:
    """Return the bounds that hold for the readings of both."""
    models = [one.range_error for one in (first, second) if one.range_error is not None]
    bearings = [one for one in (first, second) if one.bearing_half_width_rad is not None]
    half_widths = [one.bearing_half_width_rad or 0.0 for one in bearings]
    errors = {one.bearing_expected_error_rad for one in bearings}
    return replace(
        first,
        range_error=_widest_range(models) if models else None,
        bearing_half_width_rad=max(half_widths, default=None),
        bearing_expected_error_rad=errors.pop() if len(errors) == 1 else None,
    )


def _widest_range(models: Sequence[RangeErrorModel]) -> RangeErrorModel:
    """Return the bounds that hold for the ranges of all, for every reading."""
    shares = list(chain(*((one.min_error_relative, one.max_error_relative) for one in models)))
    expected = {(one.expected_error_m, one.expected_error_relative) for one in models}
    expected_error_m, expected_error_relative = (
        expected.pop() if len(expected) == 1 else (None, 0.0)
    )
    return replace(
        models[0],
        min_error_m=min(one.min_error_m for one in models),
        max_error_m=max(one.max_error_m for one in models),
        min_error_relative=min(shares),
        max_error_relative=max(shares),
        sigma_factor=max(one.sigma_factor for one in models),
        min_reading_m=max(one.min_reading_m for one in models),
        expected_error_m=expected_error_m,
        expected_error_relative=expected_error_relative,
    )


def _pairs(link: Link, robots: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield each observer and target of a link; peers are all points on other robots."""
    if link.key.target:
        yield link.key.ends
        return
    for one in robots if link.key.observer == ANY_OBSERVER else (link.key.observer,):
        yield from ((one, other) for other in robots if robots[one] != robots[other])


def elevation_errors_from(
    links: Iterable[Link], values: Mapping[str, Any], of_all: Mapping[str, float]
) -> dict[str, ElevationErrorModel]:
    """Return the bounds of the points whose elevation links read; the widest of several."""
    errors: dict[str, ElevationErrorModel] = {}
    for link in links:
        point = link.key.observer
        if link.key.kind is not LinkKind.ELEVATION or point not in values['elevations.names']:
            continue
        own = {f'{name}_m': x for name, x in link.overrides.items() if name != STAMP_OFFSET}
        with refused(f"parameter 'links': the bounds of '{link.topic}' are not allowed: "):
            error = ElevationErrorModel(**{**of_all, **own})
        before = errors.get(point, error)
        errors[point] = ElevationErrorModel(
            min(before.min_error_m, error.min_error_m),
            max(before.max_error_m, error.max_error_m),
        )
    return errors
