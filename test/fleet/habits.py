# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a fleet of a drawn history is told besides, and how it is asked."""

from dataclasses import replace
import math

import numpy as np

from dg_localization.fleet import SensorBounds


def has_resets(seed):
    """Return whether the localizer of a seed is reset now and then."""
    return seed % 2 == 1


def draw_habits(history, seed):
    """
    Return a history with the habits that a seed draws.

    Another robot may be the reference, single links may have bounds of their own, sensors limits
    and variances (REP-117), odometries may start anew, a robot of the plane may be parked as an
    anchor, and answers may be for a time a little before. In the plane as many observations are
    wrong as are tolerated.
    """
    rng = np.random.default_rng([seed, 14])
    config = history.config
    history.config = replace(
        config,
        reference_robot=str(rng.choice(config.robots)),
        max_repeats=int(rng.choice([1, 2, 8])),
        max_outliers=int(rng.choice([0, 0, 1])),
    )
    history.answers_late = bool(rng.random() < 0.3)
    if rng.random() < 0.3:
        _override_links(history, rng)
    if rng.random() < 0.3:
        _limit_ranges(history, rng)
    if rng.random() < 0.2:
        drive = history.drives[int(rng.integers(len(config.robots)))]
        drive.start_anew(int(rng.integers(5, len(drive.true))), *_draw_leap(rng))
    if config.dimension == 2 and not history.heights.waves and rng.random() < 0.2:
        history.park(int(rng.integers(len(config.robots))), rng)
    # After a reset nothing is known of a robot whose odometry is missing.
    if config.dimension == 2 and config.memory_s > 0.0 and not has_resets(seed):
        history.lies = _draw_lies(history, rng)
    return history


def _draw_lies(history, rng):
    """Draw by how much observations are off, as many of each two bodies as are tolerated."""
    of_bodies = {}
    for observed in history.observed:
        first, second = (_body_of(history, point) for point in observed[:2])
        # What two anchors say of each other counts as it is.
        if None not in (first, second) and first != second:
            of_bodies.setdefault(frozenset({first, second}), []).append(observed)
    lies = {}
    for observations in of_bodies.values():
        for k in rng.integers(len(observations), size=history.config.window_outliers):
            lies[observations[k]] = rng.uniform(-4.0, 4.0)
    return lies


def _body_of(history, point):
    """
    Return whose motion is known that a point is on: a robot, or the anchors all together.

    Of robots without odometry and sensors on anchors nothing can be remembered: None.
    """
    config, body = history.config, history.body(point)
    if body is None:
        return 'anchors'
    if config.robots[body] in config.anchors:
        return 'anchors' if point < len(config.robots) else None
    return body if body in history.with_odometry else None


def _override_links(history, rng):
    """Give some links bounds of their own."""
    config, error = history.config, history.config.range_error
    for observer in config.points:
        for target in config.points:
            if config.robot_of(observer) != config.robot_of(target) and rng.random() < 0.3:
                factor = float(rng.choice([0.5, 2.0]))
                own = replace(
                    error,
                    min_error_m=-float(rng.choice([0.0, 0.02])),
                    min_error_relative=factor * error.min_error_relative,
                    max_error_relative=factor * error.max_error_relative,
                )
                half_rad = factor * config.bearing_half_width_rad
                history.bounds[observer, target] = SensorBounds(own, half_rad)


def _limit_ranges(history, rng):
    """Let all sensors see no farther and no nearer than their limits, and state variances."""
    limits_m = float(rng.choice([0.0, 1.0, 3.0])), float(rng.choice([2.0, 4.0, 8.0]))
    variance_m2 = float(rng.choice([0.0, 0.0001, 0.01]))
    history.limits = (min(limits_m), max(limits_m), variance_m2)
    told = {'beyond_max_is_far': True, 'sigma_factor': float(rng.choice([0.0, 1.0, 3.0]))}
    config = history.config
    history.config = replace(config, range_error=replace(config.range_error, **told))
    for names, own in history.bounds.items():
        history.bounds[names] = replace(own, range_error=replace(own.range_error, **told))


def _draw_leap(rng):
    """Draw where an odometry goes on that starts anew, too far away to have driven there."""
    angle = rng.uniform(-math.pi, math.pi)
    return 100.0 * np.array([math.cos(angle), math.sin(angle)]), rng.uniform(-3.0, 3.0)
