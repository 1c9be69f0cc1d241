# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The settings that the parameters stand for: checked one by one, then together."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
import re
from typing import Any

from rclpy.node import Node

from dg_localization.fleet import (
    FleetConfig,
    LinkKind,
    SuspectKind,
)
from dg_localization.ros.interface.frames import check_frame_id
from dg_localization.ros.interface.identities import NOBODY, parse_ids
from dg_localization.ros.interface.links import (
    ANY_OBSERVER,
    Link,
    Template,
    parse_link,
)
from dg_localization.ros.interface.parameters.inputs import (
    ends_of,
    overrides_from,
    range_error_from,
    stamp_offset,
    templates_from,
)
from dg_localization.ros.interface.parameters.odometry import (
    REPLACED,
    odometry_error,
    robot_odometry_errors,
)
from dg_localization.ros.interface.parameters.points import (
    anchors_from,
    elevation_error_from,
    elevation_errors_from,
    elevations_from,
    mounts_from,
    specs_of_elevations,
    specs_of_mounts,
)
from dg_localization.ros.interface.parameters.spec import (
    Spec,
    WrongParameterError,
    by_parameters,
    close_name,
    declare,
    given_values,
    refuse_unknown,
)
from dg_localization.ros.interface.parameters.table import TABLE, named_specs, takes_effect_at_once
from dg_localization.ros.interface.poses import CovarianceKind, PoseCovariance
from dg_localization.solver.options import SolverOptions

# An answer counts as new for so many periods, and at least for so long.
LIFETIME_PERIODS = 3.0
LEAST_LIFETIME_S = 1.0
NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*\Z')


@dataclass(frozen=True)
class Settings:
    """
    The checked parameters.

    Attributes
    ----------
    fleet : FleetConfig
        What the ROS-free part is told.
    links : tuple of Link
        The inputs named one by one, with the full names of their topics.
    templates : tuple of Template
        What the topics of all others are named like, in full.
    fixed_frame : str
        frame_id of what is published in the coordinates of the anchors.
    rate_hz : float
        How often the fleet is localized.
    use_header_stamp : bool
        Whether a measurement's time is its header's, not that of its arrival.
    autostart : bool
        Whether to configure and activate at once.
    publish_tf : bool
        Whether to publish transforms.
    ids : mapping of str to str
        The names that ids in messages stand for.
    localized_width_m : float
        A fleet with a wider enclosure is not called localized.
    covariance : PoseCovariance
        How the covariances of poses are made.

    """

    fleet: FleetConfig
    links: tuple[Link, ...]
    templates: tuple[Template, ...]
    fixed_frame: str
    rate_hz: float
    use_header_stamp: bool
    autostart: bool
    publish_tf: bool
    ids: Mapping[str, str]
    localized_width_m: float
    covariance: PoseCovariance

    @property
    def lifetime_s(self) -> float:
        """How long an answer counts as new, in s."""
        return max(LEAST_LIFETIME_S, LIFETIME_PERIODS / self.rate_hz)


def declare_settings(node: Node) -> Settings:
    """
    Declare every parameter of the table and return the settings.

    Raises
    ------
    WrongParameterError
        If a parameter is unknown or has a value it cannot have. The message names it, the
        value and the allowed values.

    """
    values = check_values(given_values(node))
    settings = settings_from(values, node.resolve_topic_name)
    declare_missing(node, values)
    return settings


def declare_missing(node: Node, values: Mapping[str, Any]) -> None:
    """Declare the parameters that are not declared, with checked values."""
    specs = (*TABLE, *_named(values))
    missing = [spec for spec in specs if not node.has_parameter(spec.name)]
    declare(node, missing, values, read_only=False)


def changed_values(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values after some are set, without those of names that are gone."""
    wanted = {**values, **changes}
    known = {spec.name: spec.check(wanted.get(spec.name, spec.default)) for spec in TABLE}
    known |= {spec.name: wanted[spec.name] for spec in _named(known) if spec.name in wanted}
    return check_values(known)


def without_fleet_changes(values: Mapping[str, Any], wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Return the wanted values of what takes effect at once, and the present ones of the rest."""
    return {
        name: wanted.get(name, value) if takes_effect_at_once(name) else value
        for name, value in values.items()
    }


def check_values(given: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the value of every parameter of the table, given or default.

    Parameters
    ----------
    given : mapping of str to object
        What the user sets.

    Raises
    ------
    WrongParameterError
        If a name is not in the table or a value is not allowed.

    """
    values = {spec.name: spec.check(given.get(spec.name, spec.default)) for spec in TABLE}
    for spec in _named(values):
        values[spec.name] = spec.check(given.get(spec.name, spec.default))
    refuse_unknown(given, values, _suggestion)
    return values


def _named(values: Mapping[str, Any]) -> Iterator[Spec]:
    """Yield the parameters that robots, anchors and sensors have of their own."""
    yield from named_specs(values['robots'], values['anchors.names'])
    yield from specs_of_mounts(values)
    yield from specs_of_elevations(values)


def _suggestion(name: str, known: Iterable[str]) -> str:
    if name in REPLACED:
        return f'; {REPLACED[name]}'
    if name.startswith('anchors.'):
        wanted = 'anchors.NAME.position or anchors.NAME.bound'
        return f"; name the anchor in 'anchors.names' and set {wanted}"
    if name.startswith('mounts.'):
        return "; name the sensor in 'mounts.names'"
    if name.startswith('elevations.'):
        return "; name the point in 'elevations.names'"
    if name.startswith('robot_max_speed.') or _is_of_unknown_robot(name, known):
        return "; name the robot in 'robots'"
    return close_name(name, known)


def _is_of_unknown_robot(name: str, known: Iterable[str]) -> bool:
    """Return whether a name is that of the odometry of a robot that has no parameters."""
    of_robot = '.'.join(name.split('.')[:2]) + '.'
    return of_robot.startswith('robot_odometry.') and not any(
        other.startswith(of_robot) for other in known
    )


def in_root_namespace(topic: str) -> str:
    """Return the full name of a topic of a node that has no namespace."""
    return topic if topic.startswith('/') else f'/{topic}'


def settings_from(
    values: Mapping[str, Any], resolve: Callable[[str], str] = in_root_namespace
) -> Settings:
    """
    Return the settings that checked `values` stand for, with all adapters at hand.

    Parameters
    ----------
    values : mapping of str to object
        What `check_values` returned.
    resolve : callable
        Returns the full name of a topic, by the namespace and the remappings of the node.

    Raises
    ------
    WrongParameterError
        If values do not go together.

    """
    try:
        check_frame_id(values['fixed_frame'])
    except ValueError as error:
        raise WrongParameterError(
            f"parameter 'fixed_frame': '{values['fixed_frame']}' is not allowed, {error}"
        ) from None
    if not values['robots']:
        raise WrongParameterError(
            'parameters: robots: [] is not allowed, it must name at least one robot; does the '
            "file name some below '/**:' and 'ros__parameters:'?"
        )
    for name in ('robots', 'anchors.names'):
        _check_names(name, values[name])
    for name in values['mounts.names']:
        _check_names('mounts.names', name.split('/'))
    for parameter in ('anchors.names', 'mounts.names', 'elevations.names'):
        for name, count in Counter(values[parameter]).items():
            if count > 1:
                raise WrongParameterError(
                    f"parameter '{parameter}': '{name}' is not allowed twice, name it once"
                )
    _import_adapters(values['adapter_modules'])
    explicit = _parse_links(values, resolve)
    try:
        fleet = _fleet_config(values, explicit)
    except WrongParameterError:
        raise
    except ValueError as error:
        raise WrongParameterError(f'parameters: {by_parameters(str(error))}') from None
    return Settings(
        fleet=fleet,
        links=explicit,
        templates=templates_from(values, resolve, fleet.points),
        fixed_frame=values['fixed_frame'],
        rate_hz=values['rate'],
        use_header_stamp=values['stamp_source'] == 'header',
        autostart=values['autostart'],
        publish_tf=values['publish_tf'],
        ids=_parse_ids(values['ids'], fleet.points),
        localized_width_m=values['localized_width'],
        covariance=PoseCovariance(
            CovarianceKind(values['covariance']), values['covariance_floor']
        ),
    )


def _import_adapters(modules: Iterable[str]) -> None:
    for name in filter(None, modules):
        try:
            import_module(name)
        except Exception as error:  # a module of somebody else may raise anything
            raise WrongParameterError(
                f"parameter 'adapter_modules': '{name}' cannot be imported "
                f'({type(error).__name__}: {error}); it must be a Python module that is installed '
                'or in a folder of PYTHONPATH'
            ) from error


def _parse_links(values: Mapping[str, Any], resolve: Callable[[str], str]) -> tuple[Link, ...]:
    links = []
    # A list of one empty string is how ROS 1 and 2 users write an empty list of strings.
    for text in filter(None, values['links']):
        try:
            link = parse_link(text)
        except ValueError as error:
            raise WrongParameterError(
                f"parameter 'links': '{text}' is not allowed: {error}"
            ) from None
        overrides = {**stamp_offset(values, link.key.kind), **link.overrides}
        topic = resolve(link.topic)
        if resolve(topic) != topic:
            # A subscription to it would be remapped once more.
            raise WrongParameterError(
                f"parameter 'links': '{text}' is not allowed: its topic is remapped to '{topic}', "
                f"and that to '{resolve(topic)}'; name the right topics in the links instead"
            )
        links.append(replace(link, topic=topic, overrides=overrides))
    topics = [link.topic for link in links]
    for topic in topics:
        if topics.count(topic) > 1:
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


def _parse_ids(texts: Iterable[str], points: Sequence[str]) -> dict[str, str]:
    try:
        ids = parse_ids(filter(None, texts))
    except ValueError as error:
        raise WrongParameterError(f"parameter 'ids': {error}") from None
    for name in ids.values():
        if name not in (*points, NOBODY):
            raise WrongParameterError(
                f"parameter 'ids': '{name}' is not allowed, it must be one of "
                f"{', '.join(points)}, or '{NOBODY}' for an id that stands for nobody"
            )
    return ids


def _check_names(parameter: str, names: Iterable[str]) -> None:
    for name in names:
        if not NAME.match(name):
            raise WrongParameterError(
                f"parameter '{parameter}': '{name}' is not allowed, a name must begin with a "
                'letter and go on with letters, digits and underscores: it is part of topic names'
            )


def _fleet_config(values: Mapping[str, Any], explicit: Iterable[Link]) -> FleetConfig:
    anchors = anchors_from(values)
    points = dict.fromkeys((*values['robots'], *anchors, *values['mounts.names']))
    return FleetConfig(
        robots=tuple(values['robots']),
        dimension=values['dimension'],
        mounts=mounts_from(values),
        elevations_m=elevations_from(values),
        elevation_error=elevation_error_from(values),
        point_elevation_error=elevation_errors_from(explicit, values),
        reference_robot=values['reference_robot'],
        max_age_s=values['max_age'],
        max_future_s=values['max_future'],
        stamp_error_s=values['stamp_error'],
        max_repeats=values['max_repeats'],
        range_error=range_error_from(values),
        bearing_half_width_rad=values['bearing.half_width'],
        bearing_expected_error_rad=values['bearing.expected_error'],
        # A link may name a robot that is not in the fleet today: its readings are counted and
        # rejected, its bounds concern nobody.
        links=overrides_from(
            (link for link in explicit if ends_of(link) <= {*points, '', ANY_OBSERVER}),
            points,
            values,
        ),
        anchors=anchors,
        max_speed_m_s=values['max_speed'],
        robot_max_speed_m_s=_robot_speeds_m_s(values),
        max_turn_rate_rad_s=values['max_turn_rate'],
        min_separation_m=values['min_separation'],
        odometry_error=odometry_error(values),
        robot_odometry_error=robot_odometry_errors(values),
        memory_s=values['memory.seconds'],
        memory_max_seconds=values['memory.max_seconds'],
        window_outliers=values['window_outliers'],
        max_hypotheses=values['max_hypotheses'],
        max_outliers=values['max_outliers'],
        outlier_unit=SuspectKind(values['outlier_unit']),
        stuck_readings=values['stuck.readings'],
        drop_stuck=values['stuck.drop'],
        max_conflict_solves=values['conflicts.max_solves'],
        max_conflict_seconds=values['conflicts.max_seconds'],
        solver=SolverOptions(
            resolution=values['solver.resolution'],
            max_boxes=values['solver.max_boxes'],
            max_seconds=values['solver.max_seconds'],
            tighten_slices=values['solver.tighten_slices'],
            tighten_seconds=values['solver.tighten_seconds'],
        ),
    )


def _robot_speeds_m_s(values: Mapping[str, Any]) -> dict[str, float]:
    speeds = {name: values[f'robot_max_speed.{name}'] for name in values['robots']}
    return {name: speed for name, speed in speeds.items() if speed >= 0.0}
