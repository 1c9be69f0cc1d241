# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The special features of drawn histories: shapes, heights, offsets, settings and lies."""

from dataclasses import dataclass, field, replace
from itertools import combinations, permutations
import math

from drives import DELAYS_S, SAMPLE_S, direction
import numpy as np
from shapes import random_rotation, turn

from dg_localization.fleet import Anchor, DifferenceErrorModel, ElevationErrorModel, SensorBounds

CLIMBING_M_S = 0.3
LISTENING = 0.4
"""The share of histories in which sensors hear range differences."""
FORMATIONS = ('none', 'none', 'in line', 'abreast', 'together', 'on a grid')
SPACING_M = 1.5
ANCHORED_M = (-4.0, 3.0, 8.0, 12.0, 20.0)
"""Where anchors are on the line of the robots."""
LATENCIES_S = (0.0, 0.0, 0.03, 0.045)
ANCHOR_BOUNDS_M = (0.0, 0.0, 0.05, 0.5)


def has_resets(seed):
    """Return whether the localizer of a seed is reset now and then."""
    return seed % 2 == 1


def draw_habits(history, seed):
    """Return a history with all that a seed draws besides."""
    rng = np.random.default_rng([seed, history.config.dimension, 14])
    _draw_formation(history, rng)
    _draw_offsets(history, rng)
    if rng.random() < 0.5:
        _limit_motion(history)
    _draw_settings(history, rng)
    _draw_silent_links(history, rng)
    for robot, drive in zip(history.config.robots, history.drives, strict=True):
        # The frame of such odometry need not be upright.
        if history.config.odometry_error_of(robot).tilt_rad is None and rng.random() < 0.5:
            drive.start_anew(0, np.zeros(3), random_rotation(rng, history.config.dimension))
    if rng.random() < 0.2:
        drive = history.drives[int(rng.integers(len(history.drives)))]
        leap_m = 100.0 * direction(rng) * [1.0, 1.0, 0.0]
        first = int(rng.integers(min(5, len(drive.true) - 1), len(drive.true)))
        drive.start_anew(first, leap_m, turn(2, rng.uniform(-3.0, 3.0)))
    in_plane = history.config.dimension == 2
    if in_plane and not history.heights.waves and rng.random() < 0.2:
        history.park(int(rng.integers(len(history.drives))), rng)
    # After a reset nothing is known of a robot whose odometry is missing.
    if in_plane and history.config.memory_s > 0.0 and not has_resets(seed):
        history.lies = _draw_lies(history, rng)
    return listen(history, rng) if rng.random() < LISTENING else history


def _draw_formation(history, rng):
    """
    Let robots start in a formation, if any: shapes that a rounding error turns over.

    In line or abreast they look the same way. Half of these go straight ahead, all alike, so that
    their shape stays; together, at one place, each goes its own way. The anchors of half of these
    fleets are on the line of the robots.
    """
    formation, alike = str(rng.choice(FORMATIONS)), int(rng.integers(2**32))
    if formation == 'on a grid':
        for drive in history.drives:
            drive.start(np.round(drive.true[0][0]))
    if formation in ('none', 'on a grid'):
        return
    dimension, are_together = history.config.dimension, formation == 'together'
    if not are_together and rng.random() < 0.5:
        for robot in range(len(history.drives)):
            history.go_straight(robot, np.random.default_rng(alike))
    for robot, drive in enumerate(history.drives):
        start_m = np.zeros(3)
        if not are_together:
            start_m[int(formation == 'abreast')] = SPACING_M * robot
        drive.start(start_m, None if are_together else 0.0)
    if rng.random() < 0.5:
        places = zip(history.config.anchors, ANCHORED_M, strict=False)
        anchors = {name: Anchor((x_m, *np.zeros(dimension - 1))) for name, x_m in places}
        history.config = replace(history.config, anchors=anchors)


def _draw_offsets(history, rng):
    """Let stamps of odometry be late and anchors be displaced, within the stated bounds."""
    config = history.config
    latencies_s = rng.choice(LATENCIES_S, len(config.robots)).tolist()
    errors = {
        robot: replace(config.robot_odometry_error.get(robot, config.odometry_error), latency_s=s)
        for robot, s in zip(config.robots, latencies_s, strict=True)
    }
    late = zip(history.drives, latencies_s, strict=True)
    history.late_s = [_draw_late(rng, len(drive.true), latency_s) for drive, latency_s in late]
    bound_m, q = float(rng.choice(ANCHOR_BOUNDS_M)), config.dimension
    anchors = {name: replace(anchor, bound_m=bound_m) for name, anchor in config.anchors.items()}
    history.off_m = {name: 0.999 * bound_m * direction(rng)[:q] for name in anchors}
    history.config = replace(config, robot_odometry_error=errors, anchors=anchors)


def draw_clocks(rng, robots):
    """Draw how far clocks may be wrong, and how far they are."""
    error_s = float(rng.choice([0.0, 0.0, 0.005, 0.05]))
    return error_s, (0.999 * error_s * rng.choice([-1.0, 0.3, 1.0], robots)).tolist()


def _draw_late(rng, count, latency_s):
    """Draw how much later than true each sample of an odometry is stamped; their order stays."""
    if latency_s > 0.3 * SAMPLE_S:
        return 0.999 * latency_s * np.cos(rng.uniform(0.0, 6.0) + 0.3 * np.arange(count))
    return 0.999 * latency_s * rng.choice([-1.0, 0.5, 1.0], count)


def _limit_motion(history):
    """Limit robots to the speeds that they have, and in the plane to their turn rates."""
    config = history.config
    limits = {'robot_max_speed_m_s': {}}
    for robot, (name, drive) in enumerate(zip(config.robots, history.drives, strict=True)):
        places = [history.place(robot, k * SAMPLE_S) for k in range(len(drive.true))]
        _, swing_m, frequency_rad_s, _ = history.heights.waves.get(name, (0.0,) * 4)
        level_m_s = np.linalg.norm(np.diff(places, axis=0), axis=1).max() / SAMPLE_S
        fastest_m_s = 1.001 * math.hypot(level_m_s, swing_m * frequency_rad_s)
        limits['robot_max_speed_m_s'][name] = fastest_m_s
    if config.dimension == 2:
        turns = [np.abs(np.diff([yaw for _, yaw, *_ in d.true])).max() for d in history.drives]
        limits['max_turn_rate_rad_s'] = 1.001 * max(turns) / SAMPLE_S
    history.config = replace(config, **limits)


def _draw_settings(history, rng):
    """
    Draw what a fleet is told besides, and how it is asked.

    Another robot may be the reference, single links may have bounds of their own, sensors limits
    and variances (REP-117), and answers may be for a time a little before.
    """
    history.config = replace(
        history.config,
        reference_robot=str(rng.choice(history.config.robots)),
        max_repeats=int(rng.choice([1, 2, 8])),
        max_outliers=int(rng.choice([0, 0, 1])),
    )
    history.answers_late = bool(rng.random() < 0.3)
    if rng.random() < 0.3:
        _override_links(history, rng)
    if rng.random() < 0.3:
        _limit_ranges(history, rng)


def _draw_lies(history, rng):
    """
    Draw by how much observations are off, as many of each two bodies as are tolerated.

    Half of the time they are of one pair of points, one after the other, and off alike.
    """
    of_bodies, most, agree = {}, history.config.window_outliers, rng.random() < 0.5
    for observed in history.observed:
        first, second = (_body_of(history, point) for point in observed[:2])
        # What two anchors say of each other counts as it is.
        if None not in (first, second) and first != second:
            of_bodies.setdefault(frozenset({first, second}), []).append(observed)
    lies = {}
    for observations in of_bodies.values():
        first, off = int(rng.integers(len(observations))), rng.uniform(-4.0, 4.0)
        for k in rng.integers(len(observations), size=most):
            lies[observations[k]] = rng.uniform(-4.0, 4.0)
        if agree:
            alike = [one for one in observations[first:] if one[:2] == observations[first][:2]]
            lies = {one: lies[one] for one in lies if one not in observations}
            lies |= dict.fromkeys(alike[:most], off)
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


def _draw_silent_links(history, rng):
    """Let some links have no ranges, and some no rays."""
    points = range(len(history.config.points))
    shares = rng.choice([0.0, 0.0, 0.3, 0.6, 0.85], 2)
    for silent, share in zip((history.unranged, history.unseen), shares, strict=True):
        silent.update(link for link in permutations(points, 2) if rng.random() < share)


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


def beyond_limits(reading_m, least_m, most_m):
    """Return what a sensor of limited range reads, as in REP-117."""
    if least_m <= reading_m <= most_m:
        return reading_m
    return math.copysign(math.inf, reading_m - least_m)


@dataclass
class Heights:
    """Robots that rise and sink, and anchors that stay; without `stated_m` all are at 0."""

    stated_m: dict = field(default_factory=dict)
    error: ElevationErrorModel = ElevationErrorModel()
    every_s: dict = field(default_factory=dict)
    """How often the elevation of a robot is read, of those that read it."""
    waves: dict = field(default_factory=dict)
    """The middle (m), the amplitude (m), the frequency (rad/s) and the phase (rad) of each."""

    @classmethod
    def draw(cls, rng, robots, anchors):
        """Draw those of robots and anchors by name; most fleets are flat."""
        if rng.random() < 0.7:
            return cls()
        heights = cls(error=ElevationErrorModel(-float(rng.choice([0.0, 0.1])), 0.05))
        for name in (*robots, *anchors):
            swing_m = rng.uniform(0.0, 1.5) if name in robots else 0.0
            wave = (rng.uniform(-3.0, 3.0), swing_m, CLIMBING_M_S / 1.5, rng.uniform(0.0, 6.0))
            low_m, high_m = rng.choice([0.0, 0.1, 2.0], 2)
            heights.waves[name] = wave
            heights.stated_m[name] = (wave[0] - swing_m - low_m, wave[0] + swing_m + high_m)
            if name in robots and rng.random() < 0.7:
                heights.every_s[name] = rng.choice([0.1, 0.4])
        return heights

    def at_m(self, name, time_s):
        """Return how high a robot or an anchor is, some seconds after the start."""
        middle_m, swing_m, frequency_rad_s, phase_rad = self.waves.get(name, (0.0,) * 4)
        return middle_m + swing_m * math.sin(frequency_rad_s * time_s + phase_rad)

    def read_m(self, name, time_s, share):
        """Return what is read of it: `share` tells where in its bounds the error is."""
        low_m, high_m = self.error.min_error_m, self.error.max_error_m
        return self.at_m(name, time_s) + low_m + share * (high_m - low_m)


def listen(history, rng):
    """Return a history with range differences of some sensors, at their bounds if extreme."""
    config, seconds = history.config, SAMPLE_S * (len(history.drives[0].true) - 2)
    bound_m = float(rng.choice([0.02, 0.1, 0.5]))
    error = DifferenceErrorModel(-bound_m, 0.5 * bound_m)
    history.config = replace(config, range_difference_error=error)
    bodies = {}
    for point, name in enumerate(config.points):
        robot = config.robot_of(name)
        body = '' if name in config.anchors else robot
        if body or robot == name:
            bodies.setdefault(body, []).append(point)
    for own, other in permutations(bodies, 2):
        pairs = [*combinations(bodies[other], 2)]
        for observer in bodies[own] if own and pairs else ():
            for first, second in rng.permutation(pairs)[:3].tolist():
                every_s = float(rng.choice([0.25, 0.6]))
                history.calls += [
                    _difference(history, rng, observer, first, second, time_s)
                    for time_s in np.arange(rng.uniform(0.0, every_s), seconds, every_s)
                ]
    history.calls.sort(key=lambda call: call[0])
    return history


def _difference(history, rng, observer, first, second, time_s):
    names = [history.config.points[point] for point in (observer, first, second)]
    share = (0.001, 0.999)[rng.integers(2)] if history.extreme else rng.uniform()

    def call(localizer, now_s):
        near_m, far_m = (history.distance(observer, end, time_s) for end in (first, second))
        error = history.config.range_difference_error
        reading_m = far_m - near_m + error.min_error_m
        reading_m += share * (error.max_error_m - error.min_error_m)
        stamp_s = history.stamp_s(observer, time_s)
        return localizer.add_range_difference(*names, reading_m, stamp_s, now_s)

    return history.start_s + time_s + DELAYS_S[rng.integers(3)], call
