# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The settings of the node from its parameters: checked one by one, then together."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
import re
from textwrap import wrap
from typing import Any

import numpy as np
from rclpy.node import Node

from dg_localization.fleet import Anchor, FleetConfig, Mount, OdometryErrorModel
from dg_localization.fleet.rotations import quaternion_of_euler
from dg_localization.ros.interface.discovery import Template, templates_from
from dg_localization.ros.interface.identities import ids_from
from dg_localization.ros.interface.links import (
    ANY_NAME,
    WANTED_NAME,
    Link,
    check_links,
    links_from,
)
from dg_localization.ros.interface.parameters.spec import (
    WrongParameterError,
    checked,
    close_name,
    declare,
    given_values,
    refuse_unknown,
    refused,
)
from dg_localization.ros.interface.parameters.table import POINTS, TABLE, fields_of, named_specs
from dg_localization.ros.interface.poses import check_frame_id

# The number of periods, and the least time in s, for which an answer counts as new.
LIFETIME_PERIODS, LIFETIME_S = 3.0, 1.0

# The width of comments in a file of parameters.
WIDTH = 98

# The form of names, by the parameter that lists them.
NAMES = {'robots': ANY_NAME, 'anchors.names': ANY_NAME, 'elevations.names': '.*'}
NAMES |= {'mounts.names': f'{ANY_NAME}/{ANY_NAME}'}

# Fields of the fleet that the parameters with their names as a prefix state together.
MODELS = ('range_error', 'elevation_error', 'range_difference_error', 'odometry_error', 'solver')


@dataclass(frozen=True)
class Settings:
    """
    The checked parameters.

    Attributes
    ----------
    fleet : FleetConfig
        The settings of the ROS-free part.
    links : tuple of Link
        The explicit inputs, with the full names of their topics.
    templates : tuple of Template
        Templates of the full names of all other topics.
    fixed_frame : str
        The frame_id of messages in the coordinates of the anchors.
    rate_hz : float
        The rate of localization.
    use_header_stamp : bool
        Whether the time of a measurement is its header stamp, not its arrival.
    autostart : bool
        Whether to configure and activate at once.
    publish_tf : bool
        Whether to publish transforms.
    ids : mapping of str to str
        The names of ids in messages.
    localized_width_m : float
        A fleet with a wider enclosure is not called localized.
    least_deviation_m : float or None
        Least standard deviation of a coordinate; None for covariances from the bounds.

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
    least_deviation_m: float | None

    @property
    def lifetime_s(self) -> float:
        """The time for which an answer counts as new, in s."""
        return max(LIFETIME_S, LIFETIME_PERIODS / self.rate_hz)


def declare_settings(node: Node) -> Settings:
    """Declare every parameter of the table; raise `WrongParameterError` for a wrong one."""
    values = check_values(given_values(node))
    settings = settings_from(values, node.resolve_topic_name)
    declare_missing(node, values)
    return settings


def declare_missing(node: Node, values: Mapping[str, Any]) -> None:
    """Declare the parameters that are not declared yet, with checked values."""
    declare(node, {**TABLE, **dict(named_specs(values))}, values, read_only=False)


def check_values(given: Mapping[str, Any], refuses_unknown: bool = True) -> dict[str, Any]:
    """
    Return all values, given or default; raise `WrongParameterError` for a wrong one.

    A name is unknown if it is misspelled, or belongs to a robot or point that does not exist.
    """
    values = checked(TABLE, given)
    values |= checked(dict(named_specs(values)), given)
    if refuses_unknown:
        refuse_unknown(given, values, _suggestion)
    return values


def _suggestion(name: str, known: Collection[str]) -> str:
    """Return a hint on an unknown name: a similar name, or where to list a point."""
    of_point = '.'.join([*name.split('.')[:2], ''])
    points = POINTS.get(name.partition('.')[0])
    is_new = points and not any(other.startswith(of_point) for other in known)
    return (f"; name its point in '{points}'" if is_new else '') + close_name(name, known)


def in_root_namespace(topic: str) -> str:
    """Return the full name of a topic of a node without namespace."""
    return topic if topic.startswith('/') else f'/{topic}'


def settings_from(
    values: Mapping[str, Any], resolve: Callable[[str], str] = in_root_namespace
) -> Settings:
    """
    Return the settings of checked values; raise `WrongParameterError` if they do not fit together.

    The names of topics are resolved by the namespace and the remappings of the node.
    """
    with refused(f"parameter 'fixed_frame': '{values['fixed_frame']}' is not allowed, "):
        check_frame_id(values['fixed_frame'])
    _check_names(values)
    _import_adapters(values['adapter_modules'])
    links = links_from(values, resolve)
    with refused('parameters: '):
        fleet = _fleet_config(values)
    check_links(links, fleet)
    stated = {
        **_stated(Settings, values),
        'fleet': fleet,
        'links': links,
        'templates': templates_from(values, resolve, fleet.points),
        'use_header_stamp': values['stamp_source'] == 'header',
        'ids': ids_from(values, fleet.points),
        'least_deviation_m': (
            values['covariance_floor'] if values['covariance'] == 'estimate' else None
        ),
    }
    return Settings(**stated)


def _check_names(values: Mapping[str, Any]) -> None:
    """Refuse names that occur twice, or that cannot be part of topics."""
    if not values['robots']:
        raise WrongParameterError(
            "parameters: robots: [] is not allowed, it must name at least one, below '/**:' and "
            "'ros__parameters:' of the file"
        )
    for parameter, form in NAMES.items():
        with refused(f"parameter '{parameter}': "):
            for name in values[parameter]:
                # The configuration of the fleet refuses two robots of one name.
                if parameter != 'robots' and values[parameter].count(name) > 1:
                    raise ValueError(f"'{name}' is not allowed twice, name it once")
                if not re.fullmatch(form, name):
                    wanted = "it must read 'ROBOT/SENSOR', and " if '/' in form else ''
                    raise ValueError(f"'{name}' is not allowed, {wanted}a name {WANTED_NAME}")


def _import_adapters(modules: Iterable[str]) -> None:
    for name in filter(None, modules):
        try:
            import_module(name)
        except (Exception, SystemExit) as error:  # the module of a user may raise anything
            raise WrongParameterError(
                f"parameter 'adapter_modules': '{name}' cannot be imported "
                f'({type(error).__name__}: {error}) from PYTHONPATH'
            ) from error


def _stated(settings: Any, values: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return the fields of a dataclass that parameters state; NaN states nothing."""
    stated = {field: values[prefix + name] for name, field in fields_of(settings, prefix).items()}
    return {field: value for field, value in stated.items() if value == value}


def _own(values: Mapping[str, Any], name: str, of_all: str) -> float:
    """Return the own value of a robot or anchor, or else the common value."""
    value: float = values[of_all] if values[name] < 0.0 else values[name]
    return value


def _fleet_config(values: Mapping[str, Any]) -> FleetConfig:
    default = FleetConfig(tuple(values['robots']))
    models = {
        field: replace(model, **_stated(model, values, f'{field.removesuffix("_error")}.'))
        for field, model in vars(default).items()
        if field in MODELS
    }
    stated = {
        **_stated(FleetConfig, values),
        **models,
        'mounts': _mounts(values),
        'elevations_m': _elevations_m(values),
        'anchors': {
            name: Anchor(
                tuple(values[f'anchors.{name}.position']),
                _own(values, f'anchors.{name}.bound', 'anchors.bound'),
            )
            for name in values['anchors.names']
        },
        'robot_max_speed_m_s': {
            name: values[f'robot_max_speed.{name}']
            for name in values['robots']
            if values[f'robot_max_speed.{name}'] >= 0.0
        },
        'robot_odometry_error': {
            robot: error
            for robot, error in _odometry_errors(values)
            if error != models['odometry_error']
        },
    }
    return replace(default, **stated)


def _mounts(values: Mapping[str, Any]) -> dict[str, dict[str, Mount]]:
    """Return the sensors of each robot."""
    mounts: dict[str, dict[str, Mount]] = {}
    for full_name in values['mounts.names']:
        robot, name = full_name.split('/')
        prefix = f'mounts.{robot}.{name}'
        position_m, bound_m, rotation_rad = (
            values[f'{prefix}.{field}'] for field in ('position', 'bound', 'rotation')
        )
        if len(rotation_rad) != 3:
            text = f'{rotation_rad!r} is not allowed, it must be roll, pitch and yaw (rad)'
            raise WrongParameterError(f"parameter '{prefix}.rotation': {text}")
        rotation_xyzw = quaternion_of_euler(*rotation_rad)
        mounts.setdefault(robot, {})[name] = Mount(tuple(position_m), bound_m, rotation_xyzw)
    return mounts


def _elevations_m(values: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Return the bounds of each elevation; refuse topics of elevations without any bounds."""
    if values['elevation.topic'] and not values['elevations.names']:
        raise WrongParameterError(
            f"parameter 'elevation.topic': '{values['elevation.topic']}' is not allowed without "
            "'elevations.names' (dimension: 2)"
        )
    return {
        name: tuple(values[f'elevations.{name.replace("/", ".")}'])
        for name in values['elevations.names']
    }


def _odometry_errors(values: Mapping[str, Any]) -> Iterator[tuple[str, OdometryErrorModel]]:
    """Yield the odometry bounds of each robot: its own values, else the common ones."""
    for robot in values['robots']:
        own = {
            f'odometry.{name}': _own(values, f'robot_odometry.{robot}.{name}', f'odometry.{name}')
            for name in fields_of(OdometryErrorModel, 'odometry.')
        }
        yield robot, OdometryErrorModel(**_stated(OdometryErrorModel, own, 'odometry.'))


def parameters_text(comments: Iterable[str], parameters: Mapping[str, Any]) -> str:
    """Return the text of a file of parameters; empty sections are left out."""
    lines = [
        line for text in comments for line in wrap(f'# {text}', WIDTH, subsequent_indent='#   ')
    ]
    return '\n'.join([*lines, '/**:', '  ros__parameters:', *_yaml(parameters, '    ')])


def _yaml(tree: Mapping[str, Any], indent: str) -> Iterator[str]:
    for name, value in tree.items():
        if isinstance(value, Mapping) and value:
            yield f'{indent}{name}:'
            yield from _yaml(value, f'{indent}  ')
        elif isinstance(value, list) and value and isinstance(value[0], str):
            yield f'{indent}{name}:'
            yield from (f"{indent}  - '{text}'" for text in value)
        elif value or isinstance(value, float):
            yield f'{indent}{name}: {yaml_value(value)}'


def yaml_value(value: Any) -> str:
    """Return a value as YAML; a number is written so that it is read as the same float."""
    if isinstance(value, list):
        return f'[{", ".join(map(yaml_value, value))}]'
    return np.format_float_positional(value, trim='0')
