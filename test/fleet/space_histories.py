# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Fleets that fly about in space: the histories of `histories`, in three dimensions.

    python test/fleet/space_histories.py STEPS [--first SEED]

plays them until so many estimates were made, and ends at the first truth that is lost.
"""

from dataclasses import dataclass, replace
import math

from drives import SAMPLE_S, draw_errors, draw_lost
from flights import angle_rad, attitude, turn
from habits import has_resets
from histories import (
    MAX_AGE_S,
    TOLERANCE,
    History,
    draw_rate_hz,
    draw_synchronous,
    draw_ticks_s,
    hostile,
    limited,
    localizer_of,
)
from long_run import play_many
import numpy as np
from offsets import draw_clocks

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import Anchor, FleetConfig, Mount, RangeErrorModel
from dg_localization.fleet.rotations import quaternion_of, rotation_of_quaternion

SECONDS = 8.0
FASTEST_M_S, TILTING_RAD = 0.7, 0.03
"""Of a drive: its greatest speed, and how far roll and pitch change from sample to sample."""


@dataclass
class Drive:
    """The true poses (place, yaw, pitch, roll) and the stated ones (place, rotation)."""

    true: list
    stated: list
    scale: float

    def pose(self, time_s):
        """Return the true place and rotation since the start, evenly between samples."""
        place, *angles = self._between(time_s, 4)
        return place, attitude(*angles)

    def place(self, time_s):
        """Return the true place since the start, evenly between samples."""
        return self._between(time_s, 1)[0]

    def start(self, place_m, _yaw_rad=None):
        """Let the robot start elsewhere; its attitude stays."""
        moved_m = place_m - self.true[0][0]
        self.true = [(place + moved_m, *angles) for place, *angles in self.true]

    def start_anew(self, sample, leap_m, turn_rad):
        """Let the odometry start anew at a sample, elsewhere and turned."""
        axes, leap_m = turn(2, turn_rad), np.append(leap_m, 0.0)
        self.stated[sample:] = [
            (axes @ place + leap_m, axes @ rotation) for place, rotation in self.stated[sample:]
        ]

    def _between(self, time_s, parts):
        low = min(int(time_s / SAMPLE_S), len(self.true) - 2)
        share = time_s / SAMPLE_S - low
        before, after = self.true[low][:parts], self.true[low + 1][:parts]
        return [a + share * (b - a) for a, b in zip(before, after, strict=True)]


def direction(rng):
    drawn = rng.normal(size=3)
    return drawn / math.sqrt(drawn @ drawn)


def cross(first, second):
    """Return the vector product; that of NumPy takes ten times as long for one."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def draw_drive(rng, count, error, worst, steepest_rad, turning=1.0):
    """
    Fly about; odometry errs by its bounds if `worst`, by less otherwise.

    A robot with `turning` 0 keeps its heading.
    """
    place, yaw = rng.uniform(-5.0, 5.0, 3) * [1.0, 1.0, 0.4], rng.uniform(-3.0, 3.0)
    track, track_yaw = rng.uniform(-5.0, 5.0, 3), rng.uniform(-3.0, 3.0)
    tilt, goal_tilt = rng.uniform(-steepest_rad, steepest_rad, (2, 2))
    rate = turning * rng.uniform(-0.8, 0.8)
    velocity = rng.uniform(0.0, FASTEST_M_S) * direction(rng)
    aim, sign = direction(rng), rng.choice([-1.0, 1.0])
    true, stated, step, before_yaw = [], [], np.zeros(3), yaw
    for _sample in range(count):
        reported = _stated(rng, error, worst, (track, track_yaw, *tilt), yaw - track_yaw, aim)
        if stated:
            way_m = math.dist(reported[0], stated[-1][0])
            turned_rad = angle_rad(stated[-1][1].T @ reported[1])
            off_m = error.translation_per_m * way_m + error.translation_per_rad * turned_rad
            off_rad = error.rotation_per_m * way_m + error.rotation_per_rad * turned_rad
            share = 0.99 if worst else 0.99 * rng.random()
            off = share * off_m * (aim if worst else direction(rng))
            place = place + turn(2, before_yaw) @ (step + off)
            yaw = before_yaw + rate * SAMPLE_S + sign * share * off_rad
        true.append((place, yaw, *tilt))
        stated.append(reported)
        if rng.random() < 0.05:
            rate = turning * rng.uniform(-0.8, 0.8)
            velocity = rng.uniform(0.0, FASTEST_M_S) * direction(rng)
            goal_tilt = rng.uniform(-steepest_rad, steepest_rad, 2)
        before_yaw, step = yaw, velocity * SAMPLE_S
        track, track_yaw = track + turn(2, track_yaw) @ step, track_yaw + rate * SAMPLE_S
        tilt = tilt + np.clip(goal_tilt - tilt, -TILTING_RAD, TILTING_RAD)
    return Drive(true, stated, error.translation_scale)


def _stated(rng, error, worst, pose, off_rad, aim):
    """Return what odometry states of a pose of its track, which is off by a turn."""
    track, yaw, pitch, roll = pose
    share = 1.0 if worst else rng.random()
    constant = 0.499 * share * error.constant_m * (turn(2, -off_rad) @ aim)
    constant_rad = 0.999 * error.constant_rad * rng.random()
    tilted = 0.98 * (error.tilt_rad or 0.0) * share * rng.choice([-1.0, 1.0], 2)
    part = rng.random()
    angles = yaw + constant_rad, pitch + part * tilted[0], roll + (1.0 - part) * tilted[1]
    return track + constant, attitude(*angles)


class SpaceHistory(History):
    """A fleet in space with everything it will measure."""

    @classmethod
    def draw_any(cls, seed):
        """Draw a history of a seed."""
        rng = np.random.default_rng([seed, 77])
        robots, anchors = int(rng.integers(1, 5)), int(rng.choice([0, 0, 1, 2, 3, 4, 5]))
        worst, scale = bool(rng.random() < 0.5), 0.05 if rng.random() < 0.4 else 1.0
        high = scale * float(rng.choice([0.01, 0.05, 0.1]))
        errors = [
            replace(error, tilt_rad=rng.choice([0.0, 0.02, 0.1, None]))
            for error in draw_errors(rng, robots, rng, rng)
        ]
        count, steepest_rad = (
            round(SECONDS / SAMPLE_S) + 2,
            float(rng.choice([0.0, 0.2, 0.6, 1.3])),
        )
        drives = [draw_drive(rng, count, error, worst, steepest_rad) for error in errors]
        flat = np.array([1.0, 1.0, float(rng.random() < 0.7)])
        mounted = int(rng.choice([0, 0, 1, 2])) if robots > 1 else 0
        stamp_error_s, clocks_s = draw_clocks([seed, 6], robots)
        config = FleetConfig(
            robots=tuple(f'r{i}' for i in range(robots)),
            dimension=3,
            anchors={
                f'a{i}': Anchor(tuple(rng.uniform(-5.0, 5.0, 3) * flat)) for i in range(anchors)
            },
            mounts={f'r{i}': draw_mounts(rng) for i in range(mounted)},
            max_age_s=MAX_AGE_S,
            stamp_error_s=stamp_error_s,
            range_error=RangeErrorModel(
                min_error_relative=-high, max_error_relative=0.5 * high, max_error_m=0.02 * scale
            ),
            bearing_half_width_rad=float(rng.choice([0.02, 0.1])),
            max_turn_rate_rad_s=2.0,
            odometry_error=errors[0],
            robot_odometry_error={f'r{i}': error for i, error in enumerate(errors) if i},
            memory_s=float(rng.choice([0.0, 2.0, 6.0])),
            memory_max_seconds=math.inf,
            window_outliers=int(rng.choice([0, 0, 1])),
            max_hypotheses=1000,
            solver=SolverOptions(resolution=0.5, max_boxes=30),
        )
        start_s = float(rng.choice([1.0, 1.7e9]))
        history = cls(config, drives, start_s, rng, worst, clocks_s=clocks_s)
        history.arms_m = {name: history.draw_arm(mount) for name, mount in config.sensors.items()}
        history.lost = [draw_lost([seed, 7, robot], count) for robot in range(robots)]
        history.synchronous = draw_synchronous([seed, 16])
        history.measure(SECONDS, cameras=bool(rng.random() < 0.5))
        return history

    def _odometry(self, robot, sample):
        arrival_s, name = self.start_s + sample * SAMPLE_S, self.config.robots[robot]

        def call(localizer, now_s):
            place, rotation = self.drives[robot].stated[sample]
            stated = place / self.drives[robot].scale, quaternion_of(rotation)
            stamp_s = self._odometry_stamp_s(robot, sample)
            return localizer.add_odometry(name, *stated, stamp_s, now_s, f'{name}/odom')

        return arrival_s, call

    def _ray(self, observer, target, time_s):
        names = self.config.points[observer], self.config.points[target]
        share = 0.999 if self.extreme else self.rng.uniform()
        aside = direction(self.rng)

        def call(localizer, now_s):
            gap = self.place(target, time_s) - self.place(observer, time_s)
            if not gap.any():
                return None
            bounds = self.bounds_of(*names)
            off_rad = share * bounds.bearing_half_width_rad
            _, rotation = self.drives[self.body(observer)].pose(time_s)
            mount = self.config.sensors.get(names[0])
            if mount is not None:
                rotation = rotation @ rotation_of_quaternion(np.array(mount.rotation_xyzw))
            ray = rotation.T @ gap / math.sqrt(gap @ gap)
            across = cross(ray, aside)
            ray = ray + math.tan(off_rad) * across / math.sqrt(across @ across)
            times_s = self._stamp_s(observer, time_s), now_s
            return localizer.add_bearing(*names, ray, *times_s, bounds)

        return self._arrival_s(time_s), call

    def go_straight(self, robot, rng):
        """Let a robot fly level, and turn nowhere."""
        count, error = len(self.drives[robot].true), self.error_of(robot)
        self.drives[robot] = draw_drive(rng, count, error, self.extreme, 0.0, turning=0.0)

    def draw_arm(self, mount):
        """Return where a sensor truly is in the body frame: anywhere within its bound."""
        return np.array(mount.position_m) + 0.999 * mount.bound_m * direction(self.rng)

    def place(self, point, time_s):
        """Return where a point truly is, some seconds after the start."""
        name, body = self.config.points[point], self.body(point)
        if body is None:
            return self.config.anchors[name].coordinates_m + self.off_m.get(name, np.zeros(3))
        if name not in self.arms_m:
            return self.drives[body].place(time_s)
        place, rotation = self.drives[body].pose(time_s)
        return place + rotation @ self.arms_m[name]

    def truth(self, time_s, frame):
        """Return positions (n, 3) and rotations (n, 3, 3) of the robots in a frame."""
        poses = [drive.pose(time_s) for drive in self.drives]
        places, rotations = (np.array(column) for column in zip(*poses, strict=True))
        if frame.kind == 'anchors':
            return places, rotations
        rows = [self.config.points.index(name) for name in frame.points]
        if frame.kind == 'odometry':
            return self._in_odometry_frame(rows[0], time_s, places, rotations)
        origin = places[rows[0]]
        axes = rotations[rows[0]]
        if frame.kind == 'robots':
            axes = axes_along([self.place(row, time_s) - origin for row in rows[1:]])
        return (places - origin) @ axes, axes.T @ rotations

    def _in_odometry_frame(self, robot, time_s, places, rotations):
        """Return a truth in the frame where the newest odometry of a robot states its pose."""
        drive = self.drives[robot]
        sample = self._newest_sample(robot, time_s)
        (place, *angles), (stated, rotation) = drive.true[sample], drive.stated[sample]
        axes = rotation @ attitude(*angles).T
        return (places - place) @ axes.T + stated / drive.scale, axes @ rotations


def axes_along(edges):
    """Return axes as columns: x along the first edge, y on the side of the second."""
    columns = []
    for edge in [*edges, *np.eye(3)]:
        rest = without(columns, edge)
        if np.linalg.norm(rest) > 1e-9 and len(columns) < 2:
            # Again: of points that are nearly in line little is left, and it is not square to x.
            rest = without(columns, rest / np.linalg.norm(rest))
            columns.append(rest / np.linalg.norm(rest))
    return np.column_stack([*columns, cross(*columns)])


def without(columns, edge):
    """Return what is left of an edge without its parts along unit columns."""
    return edge - sum(((edge @ column) * column for column in columns), np.zeros(3))


def draw_mounts(rng):
    """Draw two sensors of a robot, turned in any way."""
    return {
        name: Mount(
            tuple(rng.uniform(-0.4, 0.4, 3)),
            float(rng.choice([0.0, 0.02])),
            tuple(quaternion_of(attitude(*rng.uniform(-3.0, 3.0, 3)))),
        )
        for name in ('left', 'right')
    }


def why_not(placement, places, rotations):
    """Return what of a truth a placement does not hold; nothing where it holds all."""
    low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
    if not np.all((low - TOLERANCE <= places) & (places <= high + TOLERANCE)):
        return 'places'
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    if np.any((apart < placement.lower_m - TOLERANCE) | (apart > placement.upper_m + TOLERANCE)):
        return 'distances'
    for row in np.flatnonzero(placement.heading_known):
        stated = rotation_of_quaternion(placement.orientations_xyzw[row])
        # The arc cosine of `angle_rad` is blind to small angles.
        off_rad = 2.0 * math.asin(min(1.0, np.linalg.norm(stated - rotations[row]) / math.sqrt(8)))
        if off_rad > placement.heading_half_width_rad[row] + TOLERANCE:
            return 'orientations'
    return ''


def play_without_a_loss(history, resets, rate_hz=1):
    """Play a history, with resets if so; return how many steps it had. No truth may be lost."""
    ticks_s = draw_ticks_s(history.rng, SECONDS, rate_hz)

    def between(localizer, time_s):
        if resets and history.rng.random() < 0.15 / rate_hz:
            localizer.reset()
        return localizer

    for time_s, estimate in history.play(localizer_of(history), ticks_s, between):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten, estimate.forgotten
        answers = [(estimate.frame, estimate.placements)] if estimate.placements else []
        answers += [(group.frame, group.placements) for group in estimate.groups]
        for frame, placements in answers:
            truth = history.truth(time_s, frame)
            missing = [why_not(placement, *truth) for placement in placements]
            assert '' in missing, (time_s, str(frame), missing)
    return len(ticks_s)


def play_seed(seed):
    """Play the history of a seed, of an odd one with resets."""
    history = limited(hostile(SpaceHistory.draw_any(seed), seed), seed)
    return play_without_a_loss(history, has_resets(seed), draw_rate_hz(seed))


if __name__ == '__main__':
    play_many(play_seed, __doc__)
