# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What sensors away from the center of a robot measured before is remembered as well."""

from itertools import product
import math

import numpy as np
import pytest
from sensing import add_odometry, new_localizer
from shapes import attitude, holds, in_space, turn

from dg_localization import Verdict
from dg_localization.fleet import Mount
from dg_localization.fleet.rotations import quaternion_of

ANCHORS_M = {
    'a0': (0.0, 0.0, 0.5),
    'a1': (8.0, 0.0, 2.0),
    'a2': (3.0, 7.0, 0.0),
    'a3': (8.0, 7.0, 3.0),
}
TAG_M = np.array([0.5, 0.2, 0.3])
ERROR = {
    'translation_per_m': 0.02,
    'rotation_per_rad': 0.02,
    'constant_m': 0.01,
    'constant_rad': 0.01,
    'tilt_rad': 0.02,
}


def pose(time_s, dimension):
    """Return place and rotation of a robot that drives, or flies and tilts, in an eight."""
    x, y = 4.0 + 1.5 * math.sin(0.5 * time_s), 3.0 + 1.5 * math.sin(time_s)
    yaw = math.atan2(1.5 * math.cos(time_s), 0.75 * math.cos(0.5 * time_s))
    if dimension == 2:
        return np.array([x, y, 0.0]), attitude(yaw)
    z, roll = 1.0 + 0.3 * math.sin(0.3 * time_s), 0.4 * math.sin(0.7 * time_s)
    return np.array([x, y, z]), attitude(yaw, 0.0, roll)


def drive(dimension, memory_s, *, lies=(), seed=0, noise_m=0.0, camera=False, **settings):
    """Yield times and estimates of a robot with one tag, away from its center; some ticks lie."""
    rng = np.random.default_rng(seed)
    anchors_m = {name: np.array(place[:dimension]) for name, place in ANCHORS_M.items()}
    localizer = new_localizer(
        ('r',),
        dimension=dimension,
        anchors=anchors_m,
        mounts={'r': {'tag': Mount(tuple(TAG_M[:dimension]), bound_m=0.01)}},
        range_error=(-0.02 - 1.4 * noise_m, 0.02 + 1.4 * noise_m, 0.0, 0.0),
        bearing_half_width_rad=0.1,
        odometry_error=ERROR,
        max_speed_m_s=2.0,
        max_turn_rate_rad_s=3.0,
        memory_s=memory_s,
        memory_max_seconds=math.inf,
        solver={'resolution': 0.3, 'max_boxes': 60},
        **settings,
    )
    for tick in range(161):
        time_s = 10.0 + 0.05 * tick
        place, rotation = pose(time_s, dimension)
        stamps = time_s, time_s
        localizer.add_odometry('r', place, quaternion_of(rotation), *stamps)
        name = f'a{tick % 4}'
        gap = in_space(anchors_m[name]) - in_space((place + rotation @ TAG_M)[:dimension])
        reading = np.linalg.norm(gap) + (1.5 if tick in lies else rng.uniform(-noise_m, noise_m))
        assert localizer.add_range('r/tag', name, float(reading), *stamps) is None
        if camera:
            ray = turn(2, rng.uniform(-0.08, 0.08)) @ rotation.T @ gap
            assert localizer.add_bearing('r/tag', name, ray, *stamps) is None
        if tick % 40 == 0 and tick:
            yield time_s, localizer.step(time_s)


def holds_truth(estimate, time_s, dimension):
    place, rotation = pose(time_s, dimension)
    return holds(estimate, place[:dimension], [rotation])


def placement_of(estimate):
    """Return the only placement, whose heading must be known."""
    (placement,) = estimate.placements
    assert placement.heading_known[0]
    return placement


@pytest.mark.parametrize('dimension', [2, 3])
def test_one_sensor_away_from_the_center_tells_the_heading(dimension):
    for time_s, estimate in drive(dimension, memory_s=6.0):
        assert estimate.verdict is not Verdict.INFEASIBLE
        assert not estimate.forgotten
        assert placement_of(estimate) and holds_truth(estimate, time_s, dimension)
    placement = placement_of(estimate)
    assert placement.heading_half_width_rad[0] < 0.5
    assert np.all(np.ptp(placement.enclosure_m[0], axis=0)[:2] < 0.5)
    *_, (_, moment) = drive(dimension, memory_s=0.0)
    assert not moment.placements[0].heading_known[0]
    widths_m = np.ptp(moment.placements[0].enclosure_m[0], axis=0)
    assert np.all(widths_m[:2] > 0.8)


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_wrong_reading_of_a_sensor_is_tolerated_and_named(dimension):
    """One is the newest reading of an estimate, the other is old."""
    found = set()
    for time_s, estimate in drive(dimension, memory_s=6.0, window_outliers=2, lies=(65, 120)):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert holds_truth(estimate, time_s, dimension)
        found.update(str(suspect) for suspect in estimate.suspects_in_window)
    assert placement_of(estimate).heading_half_width_rad[0] < 0.7
    assert found == {'range r/tag->a1 at 13.250 s', 'range r/tag->a0 at 16.000 s'}


@pytest.mark.parametrize('camera', [False, True])
def test_the_best_point_goes_by_what_a_sensor_measured_before(camera):
    """Ranges are up to 0.2 m off, rays up to 0.08 rad."""
    off_m = {0.0: [], 10.0: []}
    for memory_s, seed in product(off_m, range(2)):
        for time_s, estimate in drive(2, memory_s, seed=seed, noise_m=0.2, camera=camera):
            place = pose(time_s, 2)[0][:2]
            off_m[memory_s].append(np.linalg.norm(estimate.placements[0].positions_m[0] - place))
    assert np.median(off_m[10.0]) < 0.1 < 0.2 < np.median(off_m[0.0])


def test_ranges_of_two_sensors_may_differ_without_a_suspect():
    """Two robots drive side by side; one has a sensor ahead and one behind."""
    localizer = new_localizer(
        ('r', 's'),
        mounts={'r': {'ahead': (0.5, 0.0), 'behind': (-0.5, 0.0)}},
        range_error=(-0.01, 0.01, 0.0, 0.0),
        odometry_error=ERROR,
        memory_max_seconds=math.inf,
        window_outliers=1,
    )
    for tick in range(40):
        now_s = 10.0 + 0.1 * tick
        for robot, start_m in (('r', 0.0), ('s', 3.0)):
            add_odometry(localizer, robot, (start_m + 0.05 * tick, 0.0), now_s)
        localizer.add_range('r/ahead', 's', 2.5, now_s, now_s)
        localizer.add_range('r/behind', 's', 3.5, now_s, now_s)
    estimate = localizer.step(now_s)
    assert estimate.verdict is not Verdict.INFEASIBLE
    assert estimate.suspects_in_window == ()
