# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of odometry, and of what it makes of older measurements."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math
from typing import Any

from dg_localization.fleet import LinkKind, OdometryErrorModel
from dg_localization.fleet.config import LEAST_MEMORY_S
from dg_localization.fleet.odometry_error import LEAST_SCALE, MOST_SCALE
from dg_localization.ros.interface.parameters.inputs import stamp_offset_spec
from dg_localization.ros.interface.parameters.spec import DOUBLE, INTEGER, STRING, Section, Spec

ODOMETRY = Section(
    'Odometry',
    'Messages of type nav_msgs/Odometry. They are optional and keep older measurements sharp. The '
    'bounds per m and per rad are those of each step between two messages; seen from now they add '
    'up along the way. A robot may have each of these numbers of its own, '
    'robot_odometry.NAME.translation_scale and so on.',
    (
        Spec('odometry.topic', STRING, '{robot}/odom', 'template of the topics; empty for none'),
        stamp_offset_spec(LinkKind.ODOMETRY),
        Spec(
            'odometry.translation_scale',
            DOUBLE,
            1.0,
            'the true distance traveled is this times the reported one, up to the errors',
            '',
            LEAST_SCALE,
            MOST_SCALE,
            details='The errors count per meter of the scaled distance.',
        ),
        Spec(
            'odometry.translation_per_m',
            DOUBLE,
            0.1,
            'greatest error of the position per meter traveled',
            'm/m',
            0.0,
        ),
        Spec(
            'odometry.translation_per_rad',
            DOUBLE,
            0.0,
            'greatest error of the position per radian turned',
            'm/rad',
            0.0,
        ),
        Spec(
            'odometry.rotation_per_m',
            DOUBLE,
            0.02,
            'greatest error of the heading per meter traveled',
            'rad/m',
            0.0,
        ),
        Spec(
            'odometry.rotation_per_rad',
            DOUBLE,
            0.1,
            'greatest error of the heading per radian turned',
            'rad/rad',
            0.0,
        ),
        Spec(
            'odometry.constant_translation',
            DOUBLE,
            0.02,
            'greatest error of the position however short the way',
            'm',
            0.0,
        ),
        Spec(
            'odometry.constant_rotation',
            DOUBLE,
            0.02,
            'greatest error of the heading however short the way',
            'rad',
            0.0,
        ),
        Spec(
            'odometry.latency',
            DOUBLE,
            0.0,
            'how far the stamp of a pose may be from the time when it was true',
            's',
            0.0,
        ),
        Spec(
            'odometry.max_gap',
            DOUBLE,
            1.0,
            'where stamps are farther apart, messages are taken to be lost',
            's',
            0.0,
            details='Only `max_speed` and `max_turn_rate` bound what a robot does meanwhile. '
            'Raise it where odometry is published less often.',
        ),
        Spec(
            'odometry.restart_gap',
            DOUBLE,
            math.nan,
            'where stamps are farther apart, the odometry counts as started anew',
            's',
            0.0,
            may_be_nan=True,
            details='By default, .nan, gaps alone do not; a pose near zero after a pause, a jump '
            'and a new frame always do.',
        ),
        Spec(
            'odometry.tilt',
            DOUBLE,
            math.nan,
            'greatest error of roll and pitch together, as an angle',
            'rad',
            0.0,
            may_be_nan=True,
            details='State it with `dimension: 3` where the z axes of odometry frames and of the '
            'anchors point up. Without it, .nan, nothing is remembered in space.',
        ),
    ),
)

ERRORS = {
    'translation_scale': 'translation_scale',
    'translation_per_m': 'translation_per_m',
    'translation_per_rad': 'translation_per_rad',
    'rotation_per_m': 'rotation_per_m',
    'rotation_per_rad': 'rotation_per_rad',
    'constant_translation': 'constant_m',
    'constant_rotation': 'constant_rad',
    'latency': 'latency_s',
    'max_gap': 'max_gap_s',
    'restart_gap': 'restart_gap_s',
    'tilt': 'tilt_rad',
}
"""By the name of the parameter without its prefix, the field of `OdometryErrorModel`."""

REPLACED = {
    'odometry.relative_error': 'the error of odometry is stated by odometry.translation_per_m, '
    'odometry.rotation_per_rad and the like, along its way and not at full speed'
}
"""Parameters of before, and what to set in their place."""

MEMORY = Section(
    'Memory',
    'What robots with odometry measured of each other, and of anchors, is remembered. It rules '
    'out mirror images and other hypotheses, bounds headings, and keeps robots placed that '
    'measure nothing for a moment. With `dimension: 3` it does so for robots among anchors, '
    'where `odometry.tilt` is stated.',
    (
        Spec(
            'memory.seconds',
            DOUBLE,
            30.0,
            'how long measurements are remembered; 0 remembers nothing',
            's',
            LEAST_MEMORY_S,
            may_be_zero=True,
        ),
        Spec(
            'memory.max_seconds',
            DOUBLE,
            0.15,
            'longest processor time that an estimate spends on them',
            's',
            0.0,
            details='`.inf` is refused. When it is over, or three times as long on the clock, the '
            'answer is wider, never wrong. With `window_outliers` what is left of it goes to the '
            'search for suspects, where a pair contradicts itself.',
        ),
        Spec(
            'window_outliers',
            INTEGER,
            0,
            'so many observations of each pair may be wrong in memory.seconds: of two robots, or '
            'of a robot and all anchors together',
            at_least=0,
            details='The truth is in the answer then, whether they contradict anything or not. '
            'Answers are wider. Of one observer and target at most one observation counts in '
            'memory.seconds/300.',
        ),
    ),
)


def robot_odometry_specs(robot: str) -> Iterator[Spec]:
    """Yield the parameters of the odometry of one robot; negative for those of all robots."""
    for spec in ODOMETRY.specs:
        of_all, name = spec.name, spec.name.removeprefix('odometry.')
        if name in ERRORS:
            yield Spec(
                f'robot_odometry.{robot}.{name}',
                DOUBLE,
                -1.0,
                f'the same of this robot; negative for {of_all}',
                spec.unit,
                may_be_nan=spec.may_be_nan,
            )


def odometry_error(values: Mapping[str, Any]) -> OdometryErrorModel:
    """Return the bounds that checked values of the parameters stand for."""
    return _error({name: values[f'odometry.{name}'] for name in ERRORS})


def odometry_error_parameters(error: OdometryErrorModel) -> dict[str, float]:
    """Return the bounds that are stated, by the names of the parameters without their prefix."""
    numbers = {name: getattr(error, field) for name, field in ERRORS.items()}
    stated = {name: value for name, value in numbers.items() if value not in (None, math.inf)}
    return {name: float(value) for name, value in stated.items()}


def robot_odometry_errors(values: Mapping[str, Any]) -> dict[str, OdometryErrorModel]:
    """
    Return the bounds of the robots that have some of their own.

    Raises
    ------
    WrongParameterError
        If a number is not negative, which stands for that of all robots, and not allowed.

    """
    specs = {spec.name.removeprefix('odometry.'): spec for spec in ODOMETRY.specs}
    errors = {}
    for robot in values['robots']:
        own = {}
        for name in ERRORS:
            full_name = f'robot_odometry.{robot}.{name}'
            if not values[full_name] < 0.0:
                own[name] = replace(specs[name], name=full_name).check(values[full_name])
        if own:
            errors[robot] = _error({name: values[f'odometry.{name}'] for name in ERRORS} | own)
    return errors


def _error(numbers: Mapping[str, float]) -> OdometryErrorModel:
    """Return the bounds with a field for each parameter; what is NaN is not stated."""
    fields = {ERRORS[name]: value for name, value in numbers.items() if not math.isnan(value)}
    return OdometryErrorModel(**fields)
