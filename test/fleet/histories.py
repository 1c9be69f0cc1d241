# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Fleets that drive in the plane or fly in space, what they measure, and what is true at any time.

    python test/fleet/histories.py STEPS [--first SEED] [--space]

plays histories of successive seeds until that number of estimates is made, and ends at the first
truth that is lost.
"""

import argparse
import bisect
from dataclasses import dataclass, field, replace
from functools import cached_property
import gc
import math

from drives import DELAYS_S, SAMPLE_S, direction, draw_drive, draw_errors, draw_lost
from habits import Heights, beyond_limits, draw_clocks, draw_habits, has_resets
import numpy as np
from sensing import reading_of
from shapes import attitude, axes_along, in_space, missing, turn

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import Anchor, FleetConfig, Localizer, Mount, RangeErrorModel
from dg_localization.fleet.rotations import quaternion_of, rotation_of_quaternion

MAX_AGE_S = 0.5
LEAST_RAY_M = 1e-4
SECONDS = 8.0
SYNCHRONOUS = 0.2
"""The share of histories in which sensors measure at the samples of odometry."""
EVERY_LONG, LONG_S = 20, 36.0
"""How many histories in the plane there are for a long one, and how long that is."""
RATES_HZ = (1, 5)
"""How often histories of a long run are answered: seldom, or as often as by the node."""
LIMITS_S = (math.inf, 0.02, 0.002)
"""What an estimate of a long run may spend on the memory, and on the search. Where the time is
over in the middle of something, the answer is wider, never wrong."""
CONFLICT_LIMITS_S = (2.0, 0.02, 0.002)
"""What it may spend on each search for what explains a contradiction; the first is the default."""


@dataclass
class History:
    """A fleet with everything it will measure, as calls in the order of their arrival."""

    config: FleetConfig
    drives: list
    start_s: float
    rng: np.random.Generator
    extreme: bool
    pace: float = 1.0
    calls: list = field(default_factory=list)
    arms_m: dict = field(default_factory=dict)
    lost: list = field(default_factory=list)
    """The samples of each robot's odometry that do not arrive."""
    clocks_s: list = field(default_factory=list)
    """How far the clock of each robot is ahead."""
    heights: Heights = field(default_factory=Heights)
    late_s: list = field(default_factory=list)
    """How much later than true the samples of each robot's odometry are stamped."""
    off_m: dict = field(default_factory=dict)
    """Where anchors truly are, seen from where they are said to be."""
    limits: tuple = ()
    """The least and the greatest range of the sensors (m), and the variance of readings (m^2)."""
    bounds: dict = field(default_factory=dict)
    """The error bounds of links that have some of their own, by observer and target."""
    observed: list = field(default_factory=list)
    """The observer, the target and the time of each observation, in the order they are drawn."""
    with_odometry: set = field(default_factory=set)
    """The robots that have some."""
    lies: dict = field(default_factory=dict)
    """By how much (m and rad) some observations are wrong."""
    unranged: set = field(default_factory=set)
    unseen: set = field(default_factory=set)
    """Observers and targets without ranges, and without rays."""
    synchronous: bool = False
    """Whether sensors measure at the samples of odometry."""
    answers_late: bool = False
    """Whether answers are for a time a little before, as those of the node."""
    asked_s: float | None = None
    """When the answer of now was asked for, since the start."""

    @classmethod
    def draw(
        cls,
        seed,
        robots,
        anchors,
        seconds,
        mounted=0,
        dimension=2,
        *,
        error=None,
        steepest_rad=None,
        cameras=None,
        ranged=True,
        pace=1.0,
        odometry=0.9,
        **settings,
    ):
        """
        Draw a history of a seed; `mounted` robots have two sensors each.

        `pace` is how fast robots drive, and `odometry` the share of those that have some.
        """
        rng = np.random.default_rng(np.append(seed, dimension))
        flies, flat = dimension == 3, np.array([1.0, 1.0, dimension - 2.0])
        errors = draw_errors(rng, robots, [0.0, 0.02, 0.1, None] if flies else [None])
        errors = [error or drawn for drawn in errors]
        worst = bool(rng.random() < 0.5)
        count = round(seconds / SAMPLE_S) + 2
        drawn_rad = float(rng.choice([0.0, 0.2, 0.6, 1.3])) * flies
        steepest_rad = drawn_rad if steepest_rad is None else steepest_rad
        drives = [draw_drive(rng, count, one, worst, flat, steepest_rad, pace) for one in errors]
        # Where ranges tell little, a motion that is bounded too narrowly loses no truth.
        scale = 0.05 if rng.random() < 0.4 else 1.0
        high = scale * float(rng.choice([0.01, 0.05, 0.1]))
        stamp_error_s, clocks_s = draw_clocks(rng, robots)
        names = [f'r{i}' for i in range(robots)], [f'a{i}' for i in range(anchors)]
        heights = Heights() if flies else Heights.draw(rng, *names)
        if rng.random() < 0.3:
            flat = np.array([1.0, 1.0, 0.0])
        drawn = {
            'anchors': {
                name: Anchor(tuple((rng.uniform(-5.0, 5.0, 3) * flat)[:dimension]))
                for name in names[1]
            },
            'elevations_m': heights.stated_m,
            'elevation_error': heights.error,
            'mounts': {f'r{i}': draw_mounts(rng, dimension) for i in range(mounted)},
            'max_age_s': MAX_AGE_S,
            'stamp_error_s': stamp_error_s,
            'range_error': RangeErrorModel(
                min_error_relative=-high,
                max_error_relative=0.5 * high,
                max_error_m=0.02 * scale,
                # Robots may be at one place, and read 0.
                min_reading_m=-1.0,
            ),
            'bearing_half_width_rad': float(rng.choice([0.02, 0.1])),
            'max_speed_m_s': 1.0,
            'max_turn_rate_rad_s': 2.0 if flies else 1.3,
            'odometry_error': errors[0],
            'robot_odometry_error': {f'r{i}': error for i, error in enumerate(errors) if i},
            'memory_max_seconds': math.inf,
            'max_hypotheses': 1000,
            'solver': SolverOptions(resolution=0.5, max_boxes=30)
            if flies
            else SolverOptions(resolution=0.2, max_boxes=60),
        }
        config = FleetConfig(names[0], dimension=dimension, **{**drawn, **settings})
        start_s = float(rng.choice([1.0, 1.7e9]))
        history = cls(config, drives, start_s, rng, worst, clocks_s=clocks_s, heights=heights)
        history.pace = pace
        history.arms_m = {name: history.draw_arm(mount) for name, mount in config.sensors.items()}
        history.lost = [draw_lost(rng, count) for _robot in range(robots)]
        history.synchronous = bool(rng.random() < SYNCHRONOUS)
        has_cameras = bool(rng.random() < 0.4)
        cameras = has_cameras if cameras is None else cameras
        history.measure(seconds, cameras, ranged, odometry)
        return history

    def measure(self, seconds, cameras, ranged, odometry):
        """List what is measured; each call is (arrival, call of a localizer)."""
        for robot, drive in enumerate(self.drives):
            if self.rng.random() < odometry:
                self.with_odometry.add(robot)
                heard = [k for k in range(len(drive.true)) if k not in self.lost[robot]]
                self.calls += [self._odometry(robot, k) for k in heard]
        for robot, every_s in self.heights.every_s.items():
            times_s = np.arange(0.0, seconds, every_s)
            self.calls += [self._elevation(robot, time_s) for time_s in times_s]
        places = range(len(self.config.points))
        bodies = [self.body(place) for place in places]
        pairs = [(i, j) for i in places for j in places if ranged and bodies[i] != bodies[j]]
        for observer, target in pairs:
            if self.rng.random() < 0.3:
                continue
            every_s = float(self.rng.choice([0.25, 0.6]))
            offset_s = self.rng.uniform(0.0, every_s)
            times_s = np.arange(offset_s, seconds, every_s)
            if self.synchronous:
                times_s = SAMPLE_S * np.round(times_s / SAMPLE_S)
            for time_s in times_s:
                self.observed.append((observer, target, time_s))
                self.calls.append(self._range(observer, target, time_s))
                if cameras and bodies[observer] is not None:
                    self.calls.append(self._ray(observer, target, time_s))
        self.calls.sort(key=lambda call: call[0])

    def _arrival_s(self, time_s):
        return self.start_s + time_s + DELAYS_S[self.rng.integers(3)]

    def stamp_s(self, point, time_s):
        """Return what the clock of a point shows."""
        body = self.body(point)
        return self.start_s + time_s + (0.0 if body is None else self.clocks_s[body])

    def _share(self):
        """Draw where in its bounds an error is."""
        return (0.001, 0.999)[self.rng.integers(2)] if self.extreme else self.rng.uniform()

    def _odometry(self, robot, sample):
        arrival_s, name = self.start_s + sample * SAMPLE_S, self.config.robots[robot]

        def call(localizer, now_s):
            place, rotation = self.drives[robot].reported(sample)
            stamp_s = self._odometry_stamp_s(robot, sample)
            pose = place, quaternion_of(rotation)
            return localizer.add_odometry(name, *pose, stamp_s, now_s, f'{name}/odom')

        return arrival_s, call

    def _odometry_stamp_s(self, robot, sample):
        """Return what the stamp of a sample says, by a clock that differs, and early or late."""
        late_s = self.late_s[robot][sample] if self.late_s else 0.0
        return self.start_s + sample * SAMPLE_S + self.clocks_s[robot] + late_s

    def _newest_sample(self, robot, time_s):
        """Return the newest sample that has arrived and is not stamped later than a time."""
        stamp_s, drive = self.start_s + time_s, self.drives[robot]
        now_s = self.start_s + (time_s if self.asked_s is None else self.asked_s)
        return max(
            sample
            for sample in range(len(drive.true))
            if sample not in self.lost[robot]
            and self.start_s + sample * SAMPLE_S <= now_s
            and self._odometry_stamp_s(robot, sample) <= stamp_s
        )

    def _elevation(self, robot, time_s):
        share = self._share()

        def call(localizer, now_s):
            reading = self.heights.read_m(robot, time_s, share)
            stamp_s = self.stamp_s(self.config.points.index(robot), time_s)
            return localizer.add_elevation(robot, reading, stamp_s, now_s)

        return self._arrival_s(time_s), call

    def _range(self, observer, target, time_s):
        names = self.config.points[observer], self.config.points[target]
        share = self._share()

        def call(localizer, now_s):
            if (observer, target) in self.unranged:
                return None
            distance = self.distance(observer, target, time_s)
            bounds = self.bounds_of(*names)
            model = bounds.range_error
            deviation_m = math.sqrt(self.limits[2] if self.limits else 0.0)
            more_m = (2.0 * share - 1.0) * model.sigma_factor * deviation_m
            reading = reading_of(distance, model, share, more_m)
            reading = max(0.0, reading + self.lies.get((observer, target, time_s), 0.0))
            if self.limits:
                reading = beyond_limits(reading, *self.limits[:2])
            times_s = self.stamp_s(observer, time_s), now_s
            return localizer.add_range(*names, reading, *times_s, *self.limits, bounds=bounds)

        return self._arrival_s(time_s), call

    def _ray(self, observer, target, time_s):
        names = self.config.points[observer], self.config.points[target]
        share = 2.0 * self._share() - 1.0
        aside = direction(self.rng)

        def call(localizer, now_s):
            gap = self._gap(observer, target, time_s)
            # Straight up or down is no direction in the plane.
            level_m = np.abs(gap[: self.config.dimension]).max()
            if (observer, target) in self.unseen or level_m < LEAST_RAY_M:
                return None
            bounds = self.bounds_of(*names)
            off_rad = share * bounds.bearing_half_width_rad
            lie_rad = self.lies.get((observer, target, time_s), 0.0)
            if self.config.dimension == 2:
                gap = turn(2, off_rad + lie_rad) @ gap
            else:
                across = np.cross(gap, aside)
                across *= math.tan(off_rad) * math.hypot(*gap) / math.hypot(*across)
                gap = turn(2, lie_rad) @ (gap + across)
            _, rotation = self.drives[self.body(observer)].pose(time_s)
            mount = self.config.sensors.get(names[0])
            if mount is not None:
                rotation = rotation @ rotation_of_quaternion(np.array(mount.rotation_xyzw))
            times_s = self.stamp_s(observer, time_s), now_s
            return localizer.add_bearing(*names, rotation.T @ gap, *times_s, bounds)

        return self._arrival_s(time_s), call

    def bounds_of(self, observer, target):
        """Return the error bounds of what one point measures of another, by their names."""
        return self.bounds.get((observer, target), self.config.sensor_bounds)

    def distance(self, observer, target, time_s):
        """Return how far one point is from another, in space."""
        return math.hypot(*self._gap(observer, target, time_s))

    def _gap(self, observer, target, time_s):
        """Return the way in space from one point to another."""
        bodies = [self.config.robot_of(self.config.points[point]) for point in (observer, target)]
        first_m, second_m = (self.heights.at_m(body, time_s) for body in bodies)
        gap = self.place(target, time_s) - self.place(observer, time_s)
        return gap + [0.0, 0.0, second_m - first_m]

    def body(self, point):
        """Return the robot that a point belongs to; None for an anchor."""
        return self._bodies[point]

    @cached_property
    def _bodies(self):
        robots = [self.config.robot_of(point) for point in self.config.points]
        row_of = {robot: row for row, robot in enumerate(self.config.robots)}
        return [None if robot in self.config.anchors else row_of[robot] for robot in robots]

    def draw_arm(self, mount):
        """Return where a sensor truly is in the body frame: anywhere within its bound."""
        off_m = 0.999 * mount.bound_m * direction(self.rng)[: self.config.dimension]
        return in_space(np.array(mount.position_m) + off_m)

    def go_straight(self, robot, rng, pace=None):
        """Let a robot drive straight ahead, level."""
        config, name = self.config, self.config.robots[robot]
        error = config.robot_odometry_error.get(name, config.odometry_error)
        flat, count = np.array([1.0, 1.0, config.dimension - 2.0]), len(self.drives[robot].true)
        pace = self.pace if pace is None else pace
        drive = draw_drive(rng, count, error, self.extreme, flat, pace=pace, turning=0.0)
        self.drives[robot] = drive

    def park(self, robot, rng):
        """Let a robot stand still and be an anchor, whose heading is not known."""
        place_m, bound_m = self.drives[robot].true[0][0], float(rng.choice([0.0, 0.05]))
        self.go_straight(robot, rng, pace=0.0)
        self.drives[robot].start(place_m)
        self.drives[robot].park()
        stated_m = (place_m + 0.999 * bound_m * direction(rng))[:2]
        anchors = {**self.config.anchors, self.config.robots[robot]: Anchor(stated_m, bound_m)}
        self.config = replace(self.config, anchors=anchors)

    def place(self, point, time_s):
        """Return where a point truly is, some seconds after the start; heights are left out."""
        name, body = self.config.points[point], self.body(point)
        if body is None:
            stated_m = self.config.anchors[name].coordinates_m
            return in_space(np.add(stated_m, self.off_m.get(name, 0.0)))
        if name not in self.arms_m:
            return self.drives[body].place(time_s)
        place, rotation = self.drives[body].pose(time_s)
        return place + rotation @ self.arms_m[name]

    def truth(self, time_s, frame):
        """Return places (n, q) and rotations (n, 3, 3) of robots in a frame, places of anchors."""
        n, anchors = len(self.drives), [k for k, body in enumerate(self._bodies) if body is None]
        places = np.array([self.place(point, time_s) for point in (*range(n), *anchors)])
        rotations = np.array([drive.pose(time_s)[1] for drive in self.drives])
        origin, axes, shift = np.zeros(3), np.eye(3), np.zeros(3)
        if frame.kind != 'anchors':
            row, *others = (self.config.points.index(name) for name in frame.points)
            origin, axes = places[row], rotations[row]
        if frame.kind == 'robots':
            edges = [self.place(other, time_s) - origin for other in others]
            axes = axes_along(edges, self.config.dimension)
        elif frame.kind == 'odometry':
            # Where its newest odometry states the pose of the robot.
            assert frame.name == f'{frame.points[0]}/odom'
            drive, sample = self.drives[row], self._newest_sample(row, time_s)
            (origin, *angles), (shift, rotation) = drive.true[sample], drive.reported(sample)
            axes = attitude(*angles) @ rotation.T
        local = ((places - origin) @ axes + shift)[:, : self.config.dimension]
        return local[:n], axes.T @ rotations, local[n:]

    def play(self, localizer, ticks_s, between=lambda localizer, time_s: localizer):
        """Yield the times since the start and the estimates of a localizer."""
        arrivals = [call[0] for call in self.calls]
        done = 0
        for time_s in ticks_s:
            now_s = self.start_s + time_s
            due = bisect.bisect_right(arrivals, now_s)
            for arrival_s, call in self.calls[done:due]:
                assert call(localizer, arrival_s) is None
            done = due
            localizer = between(localizer, time_s)
            self.asked_s = time_s
            if self.answers_late:
                now_s = localizer.answer_time(now_s)
                time_s = now_s - self.start_s
            yield time_s, localizer.step(now_s)


def draw_mounts(rng, dimension):
    """Draw two sensors of a robot, turned in any way."""
    return {
        name: Mount(
            tuple(rng.uniform(-0.4, 0.4, dimension)),
            float(rng.choice([0.0, 0.02])),
            tuple(quaternion_of(attitude(*rng.uniform(-3.0, 3.0, 3 if dimension == 3 else 1)))),
        )
        for name in ('left', 'right')
    }


def truth_is_inside(history, time_s, estimate):
    """Return whether the truth lies in an estimate and in each of its groups."""
    answers = [(estimate.frame, estimate.placements)] if estimate.placements else []
    answers += [(group.frame, group.placements) for group in estimate.groups]
    return all(
        not all(missing(placement, *history.truth(time_s, frame)) for placement in placements)
        for frame, placements in answers
    )


def draw_any(seed, dimension=2, seconds=SECONDS):
    """Draw a history of a seed that also says who is in it and what is remembered."""
    rng = np.random.default_rng([seed, dimension, 1])
    robots = int(rng.integers(1, 5))
    memory_s = rng.choice([0.0, 2.0, 6.0, 30.0] if dimension == 2 else [0.0, 2.0, 6.0])
    return History.draw(
        seed,
        robots,
        int(rng.choice([0, 0, 1, 2, 3] if dimension == 2 else [0, 0, 1, 2, 3, 4, 5])),
        seconds,
        int(rng.choice([0, 0, 1, 2])) if robots > 1 else 0,
        dimension,
        memory_s=float(memory_s),
        window_outliers=int(rng.choice([0, 0, 1, 5])),
    )


def limited(history, rng):
    """Return a history whose localizer has drawn limits of time."""
    memory_s, search_s = (float(rng.choice(LIMITS_S)) for _ in range(2))
    history.config = replace(
        history.config,
        memory_max_seconds=memory_s,
        solver=replace(history.config.solver, max_seconds=search_s),
        max_conflict_seconds=float(rng.choice(CONFLICT_LIMITS_S)),
    )
    return history


def ticks_of(history, seconds, rate_hz=1):
    """Draw the times of answers, since the start."""
    return np.sort(history.rng.uniform(0.3, seconds, round(rate_hz * seconds)))


def play_without_a_loss(history, ticks_s, resets=False):
    """Play a history, now and then with a reset if so; return the last answer, none wrong."""
    rate_hz = len(ticks_s) / ticks_s[-1]

    def between(localizer, time_s):
        if resets and history.rng.random() < 0.15 / rate_hz:
            localizer.reset()
        return localizer

    for time_s, estimate in history.play(Localizer(history.config), ticks_s, between):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten, estimate.forgotten
        assert estimate.n_hypotheses >= len(estimate.placements)
        assert all(np.all(one.lower_m <= one.upper_m) for one in estimate.placements), time_s
        assert truth_is_inside(history, time_s, estimate), time_s
        fits = [one.covariances for one in estimate.placements if one.covariances is not None]
        assert not any((np.diagonal(one, axis1=1, axis2=2) < 0.0).any() for one in fits), time_s
    return estimate


def play_seed(seed, dimension=2):
    """Play the history of a seed, an odd one with resets; return how many answers it had."""
    seconds = LONG_S if dimension == 2 and seed % EVERY_LONG == 0 else SECONDS
    rng = np.random.default_rng([seed, dimension, 9])
    history = limited(draw_habits(draw_any(seed, dimension, seconds), seed), rng)
    ticks_s = ticks_of(history, seconds, int(rng.choice(RATES_HZ)))
    play_without_a_loss(history, ticks_s, has_resets(seed))
    return len(ticks_s)


def main():
    """Play histories of successive seeds, and print how many steps there were."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('steps', type=int)
    parser.add_argument('--first', type=int, default=0, metavar='SEED')
    parser.add_argument('--space', action='store_true')
    arguments = parser.parse_args()
    steps, seed = 0, arguments.first
    while steps < arguments.steps:
        try:
            steps += play_seed(seed, 3 if arguments.space else 2)
        except AssertionError as error:
            raise SystemExit(f'seed {seed}, after {steps} steps: {error}') from error
        seed += 1
        if seed == arguments.first + 1:
            # What numba made takes longer to look through than a history takes to play.
            gc.freeze()
        if seed % 100 == 0:
            print(f'{steps} steps of {seed - arguments.first} histories, none lost', flush=True)
    print(f'{steps} steps of {seed - arguments.first} histories, none lost')


if __name__ == '__main__':
    main()
