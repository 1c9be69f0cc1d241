# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of motion hold."""

import math

from drives import draw_drive
import numpy as np
import pytest
from shapes import attitude
from test_odometry import spin

from dg_localization.fleet import FleetConfig
from dg_localization.fleet.motion import Motion, OdometryTrack
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.vocabulary import OdometrySample


def config_of(speed, turn_rate, dimension=3, **errors):
    return FleetConfig(
        ('a',),
        dimension=dimension,
        max_speed_m_s=speed,
        max_turn_rate_rad_s=turn_rate,
        odometry_error=OdometryErrorModel(**errors),
        memory_s=1e9,
    )


def track_of(config, readings):
    track = OdometryTrack(config, 'a')
    for reading in readings:
        track.append(reading)
    return track


def motion_of(*readings, speed=1e9, turn_rate=1.0, **errors):
    config = config_of(speed, turn_rate, 3, **{'max_gap_s': math.inf, **errors})
    return Motion(config, {'a': track_of(config, readings).readings})


@pytest.mark.parametrize('far_m', [0.0, 1e6, 5e6, -7e8])
def test_a_robot_at_its_limit_far_from_the_origin_does_not_restart_its_odometry(far_m):
    """Rounding of large coordinates, such as those of UTM, looks like faster steps."""
    track = OdometryTrack(config_of(0.5, 1.0), 'a')
    for number in range(100):
        position_m = np.array([far_m + 0.05 * number, 0.0, 0.0])
        track.append(OdometrySample(100.0 + 0.1 * number, position_m, np.eye(3), 'odom'))
    assert len(track.readings) == 100


@pytest.mark.parametrize('seed', range(50))
def test_a_way_whose_steps_err_by_their_bounds_stays_within(seed):
    rng = np.random.default_rng(seed)
    errors = {
        'translation_per_m': rng.choice([0.0, 0.1]),
        'translation_per_rad': rng.choice([0.0, 0.05]),
        'rotation_per_m': rng.choice([0.0, 0.2]),
        'rotation_per_rad': rng.choice([0.0, 0.3]),
    }
    drive = draw_drive(rng, 61, OdometryErrorModel(**errors), True, np.array([1.0, 1.0, 0.0]))
    readings = [OdometrySample(1.0 + k, *stated) for k, stated in enumerate(drive.stated)]
    (first_m, first_rad, *_), (last_m, last_rad, *_) = drive.true[0], drive.true[-1]
    motion = motion_of(*readings, turn_rate=9.0, **errors)
    assert np.linalg.norm(last_m - first_m) <= motion.displacement_m('a', 1.0, 61.0)
    rotation, half_width_rad = motion.turn('a', 1.0, 61.0)
    off_rad = last_rad - first_rad + np.arctan2(rotation[1, 0], rotation[0, 0])
    assert half_width_rad >= abs(math.remainder(off_rad, math.tau)) - 1e-9


def test_before_the_first_odometry_and_after_the_last_the_limits_bound_the_way():
    readings = [OdometrySample(stamp_s, np.zeros(3), np.eye(3)) for stamp_s in (2.0, 3.0)]
    displacement_m = motion_of(*readings, speed=0.5).displacement_m
    for times_s in ((1.0, 3.0), (2.0, 4.0)):
        assert 0.5 <= displacement_m('a', *times_s) == pytest.approx(0.5)


def test_where_odometry_is_missing_the_way_is_as_long_as_the_limits_allow():
    """A robot may drive in a circle meanwhile, and be back up to the errors of that way."""
    errors = {'translation_per_m': 0.1, 'rotation_per_rad': 0.1, 'max_gap_s': 1.0}
    readings = [OdometrySample(stamp_s, np.zeros(3), np.eye(3)) for stamp_s in (0.0, 1.0, 4.0)]
    motion = motion_of(*readings, speed=2.0, **errors)
    assert motion.displacement_m('a', 0.0, 1.0) == pytest.approx(0.0, abs=1e-12)
    # 6 m of way, and 0.3 rad of turns that swing it.
    assert 0.6 <= motion.displacement_m('a', 0.0, 4.0) == pytest.approx(0.6 + 0.3 * 6.0)
    assert 0.3 <= motion.turn('a', 1.0, 4.0)[1] == pytest.approx(0.3)


def test_the_constant_errors_of_poses_turn_with_the_track():
    errors = {'rotation_per_rad': 0.2, 'constant_m': 0.04}
    positions, stated, _ = spin(300, 0.1, OdometryErrorModel(**errors))
    readings = [
        OdometrySample(1.0 + k, np.zeros(3), attitude(yaw)) for k, yaw in enumerate(stated)
    ]
    most_m = motion_of(*readings, **errors).displacement_m('a', 1.0, 301.0)
    assert 0.1 < np.linalg.norm(positions[-1] - positions[0]) <= most_m < 0.3


@pytest.mark.parametrize('pitch_rad', [0.0, 0.3, 0.6])
def test_the_turn_of_a_body_that_pitches_is_that_of_its_heading(pitch_rad):
    """A robot on a ramp turns about its own axis: its heading turns by more, and errs by that."""
    before, after = (attitude(0.0, pitch_rad) @ attitude(angle) for angle in (-0.25, 0.25))
    config = config_of(1e9, 1e9, 2, rotation_per_rad=0.1)
    readings = [OdometrySample(1.0, np.zeros(3), before), OdometrySample(2.0, np.zeros(3), after)]
    motion = Motion(config, {'a': track_of(config, readings).readings})
    first_rad, last_rad = (np.arctan2(turn[1, 0], turn[0, 0]) for turn in (before, after))
    assert motion.turn('a', 1.0, 2.0)[1] >= 0.1 * (last_rad - first_rad)
