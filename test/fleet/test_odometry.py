# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Odometry as bounded motion: no true pose is lost while every error obeys its bound."""

from dataclasses import replace
import math

from drives import draw_drive
import numpy as np
import pytest
from shapes import attitude

from dg_localization.fleet import FleetConfig
from dg_localization.fleet.motion import Motion, OdometryTrack
from dg_localization.fleet.odometry import MotionLimits, OdometryPath
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.vocabulary import OdometrySample
from dg_localization.interval.arrays import Interval
from dg_localization.poses import PastPoses

STAMPS = 1e9 + np.arange(201) * 0.05
TERMS = ('translation_per_m', 'translation_per_rad', 'rotation_per_m', 'rotation_per_rad')


def drive(rng, steps, error, worst, space):
    """Return a stated and a true track, each (positions, yaws), that differ by the error."""
    of_track = replace(error, constant_m=0.0, constant_rad=0.0)
    driven = draw_drive(rng, steps + 1, of_track, worst, np.array([1.0, 1.0, space]))
    stated_yaws = [math.atan2(rotation[1, 0], rotation[0, 0]) for _, rotation in driven.stated]
    stated = np.array([place for place, _ in driven.stated]), np.unwrap(stated_yaws)
    return stated, tuple(np.array([pose[k] for pose in driven.true]) for k in (0, 1))


def seen_from_last(positions, yaws):
    """Return true poses in the level frame of the last."""
    back = attitude(-yaws[-1])
    return (positions - positions[-1]) @ back.T, yaws - yaws[-1]


def path_of(stamps, track, error, limits=None):
    rotations = [attitude(yaw) for yaw in track[1]]
    dimension = 3 if track[0][:, 2].any() else 2
    whole = replace(error, max_gap_s=math.inf)
    return OdometryPath(stamps, track[0], rotations, whole, limits, dimension)


def assert_inside(poses, positions, yaws):
    tolerance = 1e-9
    assert np.all(poses.position_m.lower - tolerance <= positions)
    assert np.all(positions <= poses.position_m.upper + tolerance)
    middle = 0.5 * (poses.yaw_rad.lower + poses.yaw_rad.upper)
    half = 0.5 * (poses.yaw_rad.upper - poses.yaw_rad.lower)
    off = np.abs(np.remainder(yaws - middle + math.pi, 2 * math.pi) - math.pi)
    assert np.all(off <= half + tolerance)


@pytest.mark.parametrize('n_missing', [0, 2, 30, 198])
@pytest.mark.parametrize('worst', [True, False])
@pytest.mark.parametrize('seed', range(20))
def test_drift_at_its_bound_is_inside(seed, worst, n_missing):
    """Past poses and steps of the track hold the true ones, also across missing samples."""
    rng = np.random.default_rng([seed, worst, n_missing])
    terms = {term: rng.choice([0.0, 0.02, 0.2]) for term in TERMS}
    constants = {'constant_m': 0.3, 'constant_rad': 0.4} if n_missing else {}
    error = OdometryErrorModel(**terms, **constants, max_gap_s=0.06)
    (places, turns), (positions, yaws) = drive(rng, 200, error, worst, space=seed % 2)
    first = int(rng.integers(0, 200 - n_missing))
    heard = np.r_[: first + 1, first + n_missing + 1 : 201]
    lengths_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    limits = MotionLimits(lengths_m.max() / 0.05, np.abs(np.diff(turns)).max() / 0.05)
    rotations = [attitude(yaw) for yaw in turns[heard]]
    path = OdometryPath(STAMPS[heard], places[heard], rotations, error, limits, 2 + seed % 2)
    poses = path.past_poses(STAMPS[heard], STAMPS[-1])
    assert_inside(poses, *seen_from_last(positions[heard], yaws[heard]))
    if not constants:
        assert np.all(poses.position_m.upper[-1] - poses.position_m.lower[-1] < 1e-6)
    others = np.sort(rng.choice(heard, (5, 2)), axis=1).tolist()
    for begin, end in ((first, first + n_missing + 1), (first, first), *others):
        step = path.track_step(STAMPS[begin], STAMPS[end])
        ahead = attitude(-yaws[begin]) @ (positions[end] - positions[begin])
        lower, upper = step.pose.position_m.lower[0], step.pose.position_m.upper[0]
        assert np.linalg.norm(ahead - np.clip(ahead, lower, upper)) <= step.ball_m + 1e-9
        in_ball = PastPoses(Interval.point(ahead[None]), step.pose.yaw_rad)
        assert_inside(in_ball, ahead[None], yaws[[end]] - yaws[begin])
        # Errors of single poses are no errors of the track.
        if begin == end:
            assert np.all(upper - lower + 2.0 * step.ball_m < 1e-9)


def spin(count, turn_rad, error):
    """
    Turn on the spot by the odometry; return the true positions, the stated and the true yaws.

    Each turn errs by its bound. The poses are stated as one place, and their constant errors all
    push the same way as the track turns.
    """
    off_rad = error.rotation_per_rad * turn_rad * 0.999
    stated, true = np.arange(count + 1) * turn_rad, np.arange(count + 1) * (turn_rad + off_rad)
    offs_rad = true - stated
    angles = -0.5 * (offs_rad[1:] + offs_rad[:-1]) - 0.5 * math.pi
    constants = np.zeros((count + 1, 3))
    constants[1:, 0], constants[1:, 1] = np.cos(angles), np.sin(angles)
    constants *= 0.499 * error.constant_m
    changes = zip(offs_rad, constants, constants[1:], strict=False)
    steps = [attitude(off) @ (before - after) for off, before, after in changes]
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]), stated, true


@pytest.mark.parametrize('count', [1, 10, 300, 600])
def test_the_constant_errors_of_poses_turn_with_the_track(count):
    error = OdometryErrorModel(rotation_per_rad=0.2, constant_m=0.04)
    positions, stated, yaws = spin(count, 0.1, error)
    if count >= 300:
        assert np.linalg.norm(positions[-1] - positions[0]) > 2.0 * error.constant_m
    stamps = 100.0 + 0.1 * np.arange(count + 1)
    path = path_of(stamps, (np.zeros((count + 1, 3)), stated), error)
    assert_inside(path.past_poses(stamps, stamps[-1]), *seen_from_last(positions, yaws))
    on_track = path.past_poses(stamps, stamps[-1], on_track=True)
    off_m = path.off_track(stamps[-1]).ball_m
    seen, _ = seen_from_last(positions, yaws)
    assert np.all(np.linalg.norm(seen, axis=1) <= on_track.position_m.upper[:, 0] + off_m)
    step = path.track_step(stamps[0], stamps[-1])
    ends_m = 2.0 * path.off_track(stamps[-1]).ball_m
    reach_m = np.linalg.norm(step.pose.position_m.upper[0]) + step.ball_m + ends_m
    assert np.linalg.norm(positions[-1] - positions[0]) <= reach_m
    assert step.ball_m < 0.03 * 0.2 * 0.1 * count


@pytest.mark.parametrize('lag_s', [-0.2, -0.07, 0.13, 0.2])
@pytest.mark.parametrize('seed', range(10))
def test_late_samples_are_inside(seed, lag_s):
    rng = np.random.default_rng(seed)
    error = OdometryErrorModel(latency_s=0.2)
    track, _ = drive(rng, 400, error, True, space=0)
    stamps = np.arange(401) * 0.02
    limits = MotionLimits(speed_m_s=6.0, turn_rate_rad_s=30.0)
    poses = path_of(stamps, track, error, limits).past_poses(stamps[50:380], stamps[380])

    def truly(times):
        parts = track[0], track[1][:, None]
        return tuple(np.array([np.interp(times, stamps, x) for x in part.T]).T for part in parts)

    positions, yaws = truly(np.append(stamps[50:380], stamps[380]) + lag_s)
    positions, yaws = seen_from_last(positions, yaws[:, 0])
    assert_inside(poses, positions[:-1], yaws[:-1])


def test_between_and_beyond_samples():
    positions = np.zeros((11, 3))
    positions[:, 0] = np.arange(11)
    track = positions, np.zeros(11)
    between = path_of(np.arange(11), track, OdometryErrorModel()).past_poses([2.4], 10.0)
    assert between.position_m.lower[0, 0] <= -7.6 <= between.position_m.upper[0, 0]
    assert np.all((between.position_m.upper - between.position_m.lower)[0, :2] <= 2.0 + 1e-9)
    limited = path_of(np.arange(11), track, OdometryErrorModel(), MotionLimits(1.1, 0.1))
    between = limited.past_poses([2.4], 10.0)
    assert np.all((between.position_m.upper - between.position_m.lower)[0, :2] <= 0.89)
    beyond = limited.past_poses([-2.0, 10.0], 10.5)
    assert beyond.position_m.lower[0, 0] == pytest.approx(-10 - 2.2 - 0.55, abs=0.2)
    assert beyond.position_m.upper[1, 0] == pytest.approx(0.55, abs=0.05)
    assert beyond.yaw_rad.upper[0] == pytest.approx(0.25)
    unlimited = path_of(np.arange(11), track, OdometryErrorModel()).past_poses([-2.0, 5.0], 10.0)
    assert math.isinf(unlimited.position_m.upper[0, 0])
    assert unlimited.position_m.upper[1, 0] == pytest.approx(-5.0)


def test_in_the_plane_what_a_robot_rises_is_way_on_which_odometry_errs():
    """It rises by 5 m and drifts sideways meanwhile; then it may be anywhere near a sample."""
    positions = np.zeros((6, 3))
    positions[:, 2] = np.arange(6)
    path = OdometryPath(np.arange(6), positions, [np.eye(3)] * 6, OdometryErrorModel(0.1))
    (drift_m, between_m), _ = path.past_poses([0.0, 4.5], 5.0).position_m.upper[:, :2].T
    assert drift_m == pytest.approx(0.5)
    assert 1.0 < between_m < 1.5
    assert path.past_poses([0.0], 5.0).position_m.upper[0, 2] < 1e-9


def test_two_stated_headings_differ_by_the_whole_constant_error():
    """A robot stands still; by its odometry it turns by as much as its constant error."""
    error = OdometryErrorModel(constant_rad=0.4, max_gap_s=math.inf)
    turned = [attitude(0.0), attitude(0.4)]
    path = OdometryPath([0.0, 1.0], np.zeros((2, 3)), turned, error)
    assert path.past_poses([0.0], 1.0).yaw_rad.upper[0] >= 0.0


def test_a_body_that_is_not_level():
    yaw, pitch, roll = 0.5, 0.3, -0.2
    error = OdometryErrorModel(tilt_rad=0.05)
    turned = attitude(yaw, pitch, roll)
    path = OdometryPath([0.0], [[1.0, 2.0, 3.0]], [turned], error, dimension=3)
    mount = np.array([[0.4, 0.1, 0.2]])
    true = attitude(0.0, pitch, roll) @ mount[0]
    leveled = path.leveled_points([0.0], Interval.point(mount))
    assert np.all((leveled.lower <= true) & (true <= leveled.upper))
    swing = 2.0 * math.sin(0.025) * np.linalg.norm(mount)
    assert (leveled.upper - leveled.lower)[0] == pytest.approx(2.0 * swing, rel=1e-6)
    rays, errors = path.leveled_rays([0.0], mount, [0.01])
    assert rays[0] == pytest.approx(true) and errors[0] == pytest.approx(0.06)


def test_yaw_and_tilt_change_faster_than_a_steep_body_turns():
    limits = MotionLimits(1.0, 0.1)
    steep = attitude(0.0, 1.2, 0.0)
    path = OdometryPath([0.0], np.zeros((1, 3)), [steep], OdometryErrorModel(), limits, 3)
    _, (error_rad,) = path.tilts([1.0])
    # Turned by 0.1 rad about its own upright axis: less than the limit in every angle of Euler.
    turned = steep @ attitude(0.1)
    yaw, pitch = math.atan2(turned[1, 0], turned[0, 0]), -math.asin(turned[2, 0])
    roll = math.atan2(turned[2, 1], turned[2, 2])
    assert 0.2 < yaw <= path.past_poses([0.0], 1.0).yaw_rad.upper[0]
    level, before = attitude(0.0, pitch, roll), attitude(0.0, 1.2, 0.0)
    apart_rad = math.acos(0.5 * (np.trace(before.T @ level) - 1.0))
    assert 0.2 < apart_rad <= error_rad
    # Beyond that nothing is known of either.
    _, (error_rad,) = path.tilts([5.0])
    assert error_rad == math.pi
    assert path.past_poses([0.0], 5.0).yaw_rad.upper[0] > math.pi


def test_a_late_stamp_leaves_all_that_lies_between_the_samples_around_it():
    """The robot is as far from two samples as these are apart, and farther from the nearest."""
    height_m = math.sqrt(0.75)
    stamps_s = [0.0, 0.93, 0.96, 1.0, 1.15, 4.0, 4.2]
    at_rest = [0.0, 0.0, 0.0]
    places_m = [at_rest, [1.0, 0.0, 0.0], [0.5, height_m, 0.0], at_rest, at_rest, at_rest, at_rest]
    error = OdometryErrorModel(latency_s=0.1, max_gap_s=math.inf)
    path = OdometryPath(stamps_s, places_m, [np.eye(3)] * 7, error, MotionLimits(1000.0, 10.0))
    past = path.past_poses([1.0], 4.05)
    farthest_m = np.array([1.5, height_m])
    lower_m, upper_m = past.position_m.lower[0, :2], past.position_m.upper[0, :2]
    assert (lower_m <= farthest_m).all() and (farthest_m <= upper_m).all()


def test_between_two_samples_the_errors_of_the_step_count():
    """A robot that turns on the spot, as its odometry says, goes and turns by its errors."""
    error = OdometryErrorModel(translation_per_rad=0.1, rotation_per_rad=0.5, max_gap_s=math.inf)
    path = OdometryPath([0.0, 1.0], np.zeros((2, 3)), [np.eye(3), attitude(0.2)], error)
    # It goes 0.02 m along x and turns by 0.3 rad, evenly.
    past = path.past_poses([0.6], 1.0)
    true_m = 0.4 * 0.0199 * np.array([-np.cos(0.3), np.sin(0.3)])
    assert np.all(past.position_m.lower[0, :2] <= true_m)
    assert np.all(true_m <= past.position_m.upper[0, :2])
    assert past.yaw_rad.lower[0] <= -0.4 * 0.2999 <= past.yaw_rad.upper[0]


def test_where_samples_are_missing_the_robot_may_be_as_far_as_its_limits_allow():
    """It may have gone once round a circle of radius 1 m."""
    stamps_s, limits = [0.0, 0.5, 4.5, 5.0], MotionLimits(1.6, 1.6)
    places_m = np.outer([-0.5, 0.0, 0.0, 0.5], [1.0, 0.0, 0.0])
    path = OdometryPath(stamps_s, places_m, [np.eye(3)] * 4, OdometryErrorModel(), limits)
    past = path.past_poses([0.0, 0.5, 2.5, 4.5], 5.0)
    opposite_m = np.array([-0.5, 2.0])
    assert np.all(past.position_m.lower[2, :2] <= opposite_m)
    assert np.all(opposite_m <= past.position_m.upper[2, :2])
    assert past.yaw_rad.upper[2] - past.yaw_rad.lower[2] >= 2.0 * math.pi
    # Where it was seen it is known, as this odometry does not err.
    widths_m = past.position_m.upper - past.position_m.lower
    assert np.all(widths_m[[0, 1, 3]] < 1e-6)


def motion_of(*readings, speed=1e9, turn_rate=1.0, dimension=3, **errors):
    config = FleetConfig(
        ('a',),
        dimension=dimension,
        max_speed_m_s=speed,
        max_turn_rate_rad_s=turn_rate,
        odometry_error=OdometryErrorModel(**{'max_gap_s': math.inf, **errors}),
        memory_s=1e9,
    )
    track = OdometryTrack(config, 'a')
    for reading in readings:
        track.append(reading)
    return Motion(config, {'a': track.readings})


@pytest.mark.parametrize('far_m', [0.0, 1e6, 5e6, -7e8])
def test_a_robot_at_its_limit_far_from_the_origin_does_not_restart_its_odometry(far_m):
    """Rounding of large coordinates, such as those of UTM, looks like faster steps."""
    samples = []
    for number in range(100):
        position_m = np.array([far_m + 0.05 * number, 0.0, 0.0])
        samples.append(OdometrySample(100.0 + 0.1 * number, position_m, np.eye(3), 'odom'))
    assert len(motion_of(*samples, speed=0.5).odometry['a']) == 100


@pytest.mark.parametrize('seed', range(50))
def test_a_way_whose_steps_err_by_their_bounds_stays_within(seed):
    rng = np.random.default_rng(seed)
    most = zip(TERMS, (0.1, 0.05, 0.2, 0.3), strict=True)
    errors = {term: rng.choice([0.0, error]) for term, error in most}
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


def test_displacements_have_the_constant_errors_of_both_ends():
    errors = {'rotation_per_rad': 0.2, 'constant_m': 0.04}
    positions, stated, _ = spin(300, 0.1, OdometryErrorModel(**errors))
    samples = [OdometrySample(1.0 + k, np.zeros(3), attitude(yaw)) for k, yaw in enumerate(stated)]
    most_m = motion_of(*samples, **errors).displacement_m('a', 1.0, 301.0)
    assert 0.1 < np.linalg.norm(positions[-1] - positions[0]) <= most_m < 0.3


@pytest.mark.parametrize('pitch_rad', [0.0, 0.3, 0.6])
def test_the_turn_of_a_body_that_pitches_is_that_of_its_heading(pitch_rad):
    """A robot on a ramp turns about its own axis: its heading turns by more, and errs by that."""
    before, after = (attitude(0.0, pitch_rad) @ attitude(angle) for angle in (-0.25, 0.25))
    readings = [OdometrySample(1.0, np.zeros(3), before), OdometrySample(2.0, np.zeros(3), after)]
    motion = motion_of(*readings, turn_rate=1e9, dimension=2, rotation_per_rad=0.1)
    first_rad, last_rad = (np.arctan2(turn[1, 0], turn[0, 0]) for turn in (before, after))
    assert motion.turn('a', 1.0, 2.0)[1] >= 0.1 * (last_rad - first_rad)
