# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What robots at known places tell a localizer: odometry, ranges and rays."""

import math
from types import MappingProxyType

from shapes import in_space

from dg_localization import SolverOptions
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
)
from dg_localization.fleet.rotations import quaternion_of_yaw

MODELS = {
    'range_error': RangeErrorModel,
    'odometry_error': OdometryErrorModel,
    'solver': SolverOptions,
}


def anchors_at(places_m, bound_m=0.0):
    """Return anchors by name."""
    return {name: Anchor(tuple(place_m), bound_m) for name, place_m in places_m.items()}


def new_localizer(robots, anchors=MappingProxyType({}), **settings):
    """
    Return a localizer: models are given by their numbers, and anchors by their places.

    What it remembers has no limit of time.
    """
    for name, model in MODELS.items():
        given = settings.get(name)
        if isinstance(given, dict):
            settings[name] = model(**given)
        elif isinstance(given, tuple):
            settings[name] = model(*given)
    if not any(isinstance(one, Anchor) for one in anchors.values()):
        anchors = anchors_at(anchors)
    settings = {'memory_max_seconds': math.inf, **settings}
    return Localizer(FleetConfig(tuple(robots), anchors=anchors, **settings))


def add_odometry(localizer, robot, place_m, stamp_s, yaw_rad=0.0, now_s=None, frame=''):
    """Add a pose, which arrives at once unless `now_s` is given."""
    pose = in_space(place_m), quaternion_of_yaw(yaw_rad)
    now_s = stamp_s if now_s is None else now_s
    assert localizer.add_odometry(robot, *pose, stamp_s, now_s, frame) is None


def add_ranges(localizer, observer, place_m, targets_m, stamp_s, off_m=0.0, now_s=None):
    """Add ranges to targets by name, all too long by as much."""
    now_s = stamp_s if now_s is None else now_s
    for name, target_m in targets_m.items():
        range_m = math.dist(place_m, target_m) + off_m
        assert localizer.add_range(observer, name, range_m, stamp_s, now_s) is None


def ray(place_m, target_m, yaw_rad=0.0):
    """Return where in the plane a robot sees a target, by its own axes."""
    (x, y), (u, v) = place_m[:2], target_m[:2]
    angle = math.atan2(v - y, u - x) - yaw_rad
    return [math.cos(angle), math.sin(angle), 0.0]


def reading_of(distance_m, model, share, more_m=0.0):
    """Return a range whose error is so far up between the bounds, and more besides."""
    absolute_m = model.min_error_m + share * (model.max_error_m - model.min_error_m) + more_m
    spread = model.max_error_relative - model.min_error_relative
    return max(0.0, (distance_m + absolute_m) / (1.0 - model.min_error_relative - share * spread))
