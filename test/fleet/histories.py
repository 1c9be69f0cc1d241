# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Fleets that drive about in the plane, what they measure, and what is true at any time.

    python test/fleet/histories.py STEPS [--first SEED]

plays histories of successive seeds until so many estimates were made, and ends at the first truth
that is lost.
"""

import bisect
from dataclasses import dataclass, field, replace
from functools import cached_property
import math

from drives import SAMPLE_S, draw_drive, draw_errors, draw_lost
from formations import draw_formation
from habits import draw_habits, has_resets
from heights import Heights
from long_run import play_many
import numpy as np
from offsets import at_its_bounds, draw_clocks

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import Anchor, FleetConfig, Localizer, Mount, RangeErrorModel

MAX_AGE_S = 0.5
DELAYS_S = (0.0, 0.05, 0.3)
SECONDS = 8.0
SYNCHRONOUS = 0.2
"""In so many histories the sensors of robots measure when their odometry does."""
EVERY_FOLLOWED, FOLLOWED_S = 20, 36.0
"""So many histories have one that is long enough for filters to answer."""
RATES_HZ = (1, 5)
"""How often histories of a long run are answered: seldom, or as often as by the node."""
LIMITS_S = (math.inf, 0.02, 0.002)
"""What an estimate of a long run may spend on the memory, and on the search. Where the time is
over in the middle of something, the answer is wider, never wrong."""
CONFLICT_LIMITS_S = (2.0, 0.02, 0.002)
"""What it may spend on each search for what explains a contradiction; the first is the default."""
TOLERANCE = 1e-7


def wrapped(angle):
    return math.remainder(angle, 2.0 * math.pi)


@dataclass
class History:
    """A fleet with everything it will measure, as calls in the order of their arrival."""

    config: FleetConfig
    drives: list
    start_s: float
    rng: np.random.Generator
    extreme: bool
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
    synchronous: bool = False
    """Whether sensors measure at the samples of odometry."""
    answers_late: bool = False
    """Whether answers are for a time a little before, as those of the node."""
    asked_s: float | None = None
    """When the answer of now was asked for, since the start."""

    @classmethod
    def draw(cls, seed, robots, anchors, seconds, mounted=0, synchronous=False, **settings):
        """Draw a history of a seed; `mounted` robots have two sensors each."""
        rng = np.random.default_rng(seed)
        constants = np.random.default_rng(np.append(seed, 3))
        own = np.random.default_rng(np.append(seed, 2))
        errors = draw_errors(rng, robots, own, constants)
        worst = bool(rng.random() < 0.5)
        count = round(seconds / SAMPLE_S) + 1
        drives = [draw_drive(rng, count, error, worst, constants) for error in errors]
        high = float(rng.choice([0.01, 0.05, 0.1]))
        # Where ranges tell little, a motion that is bounded too narrowly loses no truth.
        scale = 0.05 if np.random.default_rng(np.append(seed, 5)).random() < 0.4 else 1.0
        stamp_error_s, clocks_s = draw_clocks(np.append(seed, 6), robots)
        names = [f'r{i}' for i in range(robots)], [f'a{i}' for i in range(anchors)]
        heights = Heights.draw(np.append(seed, 8), *names)
        config = FleetConfig(
            robots=names[0],
            anchors={name: Anchor(tuple(rng.uniform(-5.0, 5.0, 2))) for name in names[1]},
            elevations_m=heights.stated_m,
            elevation_error=heights.error,
            mounts={f'r{i}': draw_mounts(rng) for i in range(mounted)},
            max_age_s=MAX_AGE_S,
            stamp_error_s=stamp_error_s,
            range_error=RangeErrorModel(
                min_error_relative=-scale * high,
                max_error_relative=0.5 * scale * high,
                max_error_m=0.02 * scale,
            ),
            bearing_half_width_rad=float(rng.choice([0.02, 0.1])),
            max_speed_m_s=1.0,
            max_turn_rate_rad_s=1.3,
            odometry_error=errors[0],
            robot_odometry_error={f'r{i}': error for i, error in enumerate(errors) if i},
            memory_max_seconds=math.inf,
            max_hypotheses=1000,
            solver=SolverOptions(resolution=0.2, max_boxes=60),
            **settings,
        )
        start_s = float(rng.choice([1.0, 1.7e9]))
        history = cls(config, drives, start_s, rng, worst, clocks_s=clocks_s, heights=heights)
        history.arms_m = {name: history.draw_arm(mount) for name, mount in config.sensors.items()}
        history.lost = [draw_lost(np.append(seed, [7, robot]), count) for robot in range(robots)]
        history.synchronous = synchronous
        history.measure(seconds, cameras=bool(rng.random() < 0.4))
        return history

    def measure(self, seconds, cameras):
        """List what is measured; each call is (arrival, call of a localizer)."""
        for robot, drive in enumerate(self.drives):
            if self.rng.random() < 0.9:
                self.with_odometry.add(robot)
                heard = [k for k in range(len(drive.true)) if k not in self.lost[robot]]
                self.calls += [self._odometry(robot, k) for k in heard]
        for robot, every_s in self.heights.every_s.items():
            self.calls += [
                self._elevation(robot, at_s) for at_s in np.arange(0.0, seconds, every_s)
            ]
        places = range(len(self.config.points))
        bodies = [self.body(place) for place in places]
        pairs = [(i, j) for i in places for j in places if bodies[i] != bodies[j]]
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

    def _stamp_s(self, point, time_s):
        """Return what the clock of a point shows."""
        body = self.body(point)
        return self.start_s + time_s + (0.0 if body is None else self.clocks_s[body])

    def _odometry(self, robot, sample):
        arrival_s = self.start_s + sample * SAMPLE_S
        name = self.config.robots[robot]

        def call(localizer, now_s):
            x, y, yaw = self.drives[robot].reported(sample)
            orientation = [0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)]
            stamp_s = self._odometry_stamp_s(robot, sample)
            return localizer.add_odometry(
                name, [x, y, 0.0], orientation, stamp_s, now_s, f'{name}/odom'
            )

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
        share = (0.001, 0.999)[self.rng.integers(2)] if self.extreme else self.rng.uniform()

        def call(localizer, now_s):
            reading = self.heights.read_m(robot, time_s, share)
            stamp_s = self._stamp_s(self.config.points.index(robot), time_s)
            return localizer.add_elevation(robot, reading, stamp_s, now_s)

        return self._arrival_s(time_s), call

    def _range(self, observer, target, time_s):
        names = self.config.points[observer], self.config.points[target]
        share = (0.001, 0.999)[self.rng.integers(2)] if self.extreme else self.rng.uniform()

        def call(localizer, now_s):
            distance = math.hypot(*self._gap(observer, target, time_s))
            bounds = self.bounds_of(*names)
            model = bounds.range_error
            absolute = model.min_error_m + share * (model.max_error_m - model.min_error_m)
            relative = model.min_error_relative + share * (
                model.max_error_relative - model.min_error_relative
            )
            if self.limits:
                deviation = math.sqrt(self.limits[2])
                absolute += (2.0 * share - 1.0) * model.sigma_factor * deviation
            reading = (distance + absolute) / (1.0 - relative)
            reading = max(0.01, reading + self.lies.get((observer, target, time_s), 0.0))
            if self.limits:
                reading = beyond_limits(reading, *self.limits[:2])
            stamp_s = self._stamp_s(observer, time_s)
            times_s = stamp_s, now_s
            return localizer.add_range(*names, reading, *times_s, *self.limits, bounds=bounds)

        return self._arrival_s(time_s), call

    def _ray(self, observer, target, time_s):
        names = self.config.points[observer], self.config.points[target]
        share = (-0.999, 0.999)[self.rng.integers(2)] if self.extreme else self.rng.uniform(-1, 1)

        def call(localizer, now_s):
            gap = self._gap(observer, target, time_s)
            # Straight up or down is no direction in the plane.
            if not gap[:2].any():
                return None
            bounds = self.bounds_of(*names)
            off = share * bounds.bearing_half_width_rad
            off += self.lies.get((observer, target, time_s), 0.0)
            yaw = self.drives[self.body(observer)].pose(time_s)[2]
            if names[0] in self.config.sensors:
                *_, z, w = self.config.sensors[names[0]].rotation_xyzw
                yaw += 2.0 * math.atan2(z, w)
            angle = math.atan2(gap[1], gap[0]) - yaw + off
            far = math.hypot(gap[0], gap[1])
            ray = [far * math.cos(angle), far * math.sin(angle), gap[2]]
            times_s = self._stamp_s(observer, time_s), now_s
            return localizer.add_bearing(*names, ray, *times_s, bounds)

        return self._arrival_s(time_s), call

    def bounds_of(self, observer, target):
        """Return the error bounds of what one point measures of another, by their names."""
        return self.bounds.get((observer, target), self.config.sensor_bounds)

    def _gap(self, observer, target, time_s):
        """Return the way in space from one point to another."""
        bodies = [self.config.robot_of(self.config.points[point]) for point in (observer, target)]
        first_m, second_m = (self.heights.at_m(body, time_s) for body in bodies)
        return np.append(
            self.place(target, time_s) - self.place(observer, time_s), second_m - first_m
        )

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
        angle = self.rng.uniform(-math.pi, math.pi)
        off_m = 0.999 * mount.bound_m * np.array([math.cos(angle), math.sin(angle)])
        return np.array(mount.position_m) + off_m

    def error_of(self, robot):
        """Return the errors that the odometry of a robot was drawn with."""
        config = self.config
        return config.robot_odometry_error.get(config.robots[robot], config.odometry_error)

    def go_straight(self, robot, rng):
        """Let a robot drive straight ahead."""
        count = len(self.drives[robot].true) - 1
        error = self.error_of(robot)
        self.drives[robot] = draw_drive(rng, count, error, self.extreme, rng, turning=0.0)

    def park(self, robot, rng):
        """Let a robot stand still and be an anchor, whose heading is not known."""
        place_m = self.drives[robot].true[0, :2]
        count, bound_m = len(self.drives[robot].true) - 1, float(rng.choice([0.0, 0.05]))
        error = self.error_of(robot)
        drive = draw_drive(rng, count, error, self.extreme, rng, pace=0.0, turning=0.0)
        drive.start(place_m)
        drive.true[:] = drive.true[0]
        self.drives[robot] = drive
        angle = rng.uniform(-math.pi, math.pi)
        stated_m = place_m + 0.999 * bound_m * np.array([math.cos(angle), math.sin(angle)])
        anchors = {**self.config.anchors, self.config.robots[robot]: Anchor(stated_m, bound_m)}
        self.config = replace(self.config, anchors=anchors)

    def place(self, point, time_s):
        """Return where a point truly is, some seconds after the start."""
        name, body = self.config.points[point], self.body(point)
        if body is None:
            return self.config.anchors[name].coordinates_m + self.off_m.get(name, np.zeros(2))
        x, y, yaw = self.drives[body].pose(time_s).tolist()
        if name not in self.arms_m:
            return np.array([x, y])
        (ahead, aside), c, s = self.arms_m[name].tolist(), math.cos(yaw), math.sin(yaw)
        return np.array([x + c * ahead - s * aside, y + s * ahead + c * aside])

    def truth(self, time_s, frame):
        """Return positions (n, 2) and yaws (n,) of the robots in a frame."""
        points = self.config.points
        places = np.array([self.place(i, time_s) for i in range(len(points))])
        yaws = np.array([drive.pose(time_s)[2] for drive in self.drives])
        if frame.kind == 'anchors':
            return places[: len(yaws)], yaws
        rows = [points.index(name) for name in frame.points]
        if frame.kind == 'odometry':
            assert frame.name == f'{frame.points[0]}/odom'
            return self._in_odometry_frame(rows[0], time_s, places[: len(yaws)], yaws)
        angle = 0.0
        if frame.kind == 'heading':
            angle = yaws[rows[0]]
        elif len(rows) > 1:
            edge = places[rows[1]] - places[rows[0]]
            angle = math.atan2(edge[1], edge[0])
        c, s = math.cos(angle), math.sin(angle)
        local = (places - places[rows[0]]) @ np.array([[c, -s], [s, c]])
        return local[: len(yaws)], yaws - angle

    def _in_odometry_frame(self, robot, time_s, places, yaws):
        """Return a truth in the frame where the newest odometry of a robot states its pose."""
        sample = self._newest_sample(robot, time_s)
        true, stated = self.drives[robot].true[sample], self.drives[robot].reported(sample)
        c, s = math.cos(stated[2] - true[2]), math.sin(stated[2] - true[2])
        moved = (places - true[:2]) @ np.array([[c, s], [-s, c]]) + stated[:2]
        return moved, yaws + stated[2] - true[2]

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


def draw_synchronous(seed):
    """Draw whether the sensors of a history measure when its odometry does."""
    return bool(np.random.default_rng(seed).random() < SYNCHRONOUS)


def beyond_limits(reading_m, least_m, most_m):
    """Return what a sensor of limited range reads, as in REP-117."""
    if least_m <= reading_m <= most_m:
        return reading_m
    return math.copysign(math.inf, reading_m - least_m)


def draw_mounts(rng):
    """Draw two sensors of a robot."""
    return {
        name: Mount(tuple(rng.uniform(-0.4, 0.4, 2)), bound_m=float(rng.choice([0.0, 0.02])))
        for name in ('left', 'right')
    }


def localizer_of(history):
    return Localizer(history.config)


def holds(placement, places, yaws):
    """Return whether a truth lies in a placement: places, headings and distances."""
    low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
    if not np.all((low - TOLERANCE <= places) & (places <= high + TOLERANCE)):
        return False
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    if np.any((apart < placement.lower_m - TOLERANCE) | (apart > placement.upper_m + TOLERANCE)):
        return False
    for row in np.flatnonzero(placement.heading_known):
        z, w = placement.orientations_xyzw[row, 2:]
        off = abs(wrapped(2.0 * math.atan2(z, w) - yaws[row]))
        if off > placement.heading_half_width_rad[row] + TOLERANCE:
            return False
    return True


def truth_is_inside(history, time_s, estimate):
    """Return whether the truth lies in an estimate and in each of its groups."""
    answers = [(estimate.frame, estimate.placements)] if estimate.placements else []
    answers += [(group.frame, group.placements) for group in estimate.groups]
    return all(
        any(holds(placement, *history.truth(time_s, frame)) for placement in placements)
        for frame, placements in answers
    )


def draw_followed(seed, seconds):
    """Draw a history of a seed whose robots are followed by filters: long, and long remembered."""
    rng = np.random.default_rng([seed, 4])
    robots, anchors = (2, 0) if rng.random() < 0.3 else (int(rng.integers(1, 4)), 3)
    outliers = int(rng.choice([0, 1])) if anchors else 0
    mounted = min(robots, int(rng.choice([0, 0, 1, 2])))
    return History.draw(
        seed, robots, anchors, seconds, mounted, memory_s=0.8 * seconds, window_outliers=outliers
    )


def draw_any(seed, seconds):
    """Draw a history of a seed that also says who is in it and what is remembered."""
    rng = np.random.default_rng([seed, 1])
    robots = int(rng.integers(1, 5))
    return History.draw(
        seed,
        robots,
        int(rng.choice([0, 0, 1, 2, 3])),
        seconds,
        mounted=int(rng.choice([0, 0, 1, 2])) if robots > 1 else 0,
        synchronous=draw_synchronous([seed, 16]),
        memory_s=float(rng.choice([0.0, 2.0, 6.0, 30.0])),
        window_outliers=int(rng.choice([0, 0, 1])),
    )


def limited(history, seed):
    """Return a history whose localizer has the limits of time that a seed draws."""
    rng, config = np.random.default_rng([seed, 9]), history.config
    memory_s, search_s = float(rng.choice(LIMITS_S)), float(rng.choice(LIMITS_S))
    history.config = replace(
        config,
        memory_max_seconds=memory_s,
        solver=replace(config.solver, max_seconds=search_s),
        max_conflict_seconds=float(np.random.default_rng([seed, 15]).choice(CONFLICT_LIMITS_S)),
    )
    return history


def draw_rate_hz(seed):
    """Draw how often the history of a seed is answered."""
    return int(np.random.default_rng([seed, 12]).choice(RATES_HZ))


def draw_ticks_s(rng, seconds, rate_hz):
    """Draw when a history is answered."""
    return np.sort(rng.uniform(0.3, seconds, round(rate_hz * seconds)))


def play_without_a_loss(history, seconds, resets, rate_hz=1):
    """Play a history, with resets if so; return how many steps it had. No truth may be lost."""
    ticks_s = draw_ticks_s(history.rng, seconds, rate_hz)

    def between(localizer, time_s):
        if resets and history.rng.random() < 0.15 / rate_hz:
            localizer.reset()
        return localizer

    for time_s, estimate in history.play(localizer_of(history), ticks_s, between):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert estimate.n_hypotheses == len(estimate.placements)
        assert truth_is_inside(history, time_s, estimate), time_s
    return len(ticks_s)


def hostile(history, seed):
    """Return a history with all that a seed draws besides: shapes, offsets, habits."""
    return draw_habits(at_its_bounds(draw_formation(history, seed), seed), seed)


def play_seed(seed):
    """Play the history of a seed; every so many are long enough for filters."""
    seconds, draw = SECONDS, draw_any
    if seed % EVERY_FOLLOWED == 0:
        seconds, draw = FOLLOWED_S, draw_followed
    history = limited(hostile(draw(seed, seconds), seed), seed)
    return play_without_a_loss(history, seconds, has_resets(seed), draw_rate_hz(seed))


if __name__ == '__main__':
    play_many(play_seed, __doc__)
