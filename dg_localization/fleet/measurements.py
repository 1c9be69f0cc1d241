# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The store of measurements: each is checked, counted, and kept while it is young.

A measurement that cannot be used never raises an exception: it becomes a `Rejection`, counted by
reason on its input.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import math

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.fleet.admission import MOST_BEFORE_S, Admission, is_young
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.contradictions.stuck import FrozenWatch, StuckWatch
from dg_localization.fleet.elevations import Elevations
from dg_localization.fleet.error_models import (
    finite_number,
    in_body_frame,
    interpret_range,
    interpret_ray,
    leaves_plane,
    likeliest_distance_m,
    projected_half_width_rad,
    quoted,
    required_number,
)
from dg_localization.fleet.motion import OdometryTrack
from dg_localization.fleet.sensors import DifferenceErrorModel, RangeErrorModel, SensorBounds
from dg_localization.fleet.vocabulary import (
    DistanceReading,
    InputState,
    LinkKey,
    LinkKind,
    OdometrySample,
    RangeMessage,
    RayReading,
    RefusedError,
    Rejection,
    RejectionReason,
)
from dg_localization.fleet.window.memory import MOST_OBSERVATIONS, STAMP_S, Memory
from dg_localization.interval.bounds import sum_down, sum_up
from dg_localization.texts import listed

CLOCK_STEP_S = 0.005
"""A `stamp_error_s` that stamps refute is raised to the next multiple of this."""

SILENT_S = 0.25
"""Older odometry is called silent."""


@dataclass
class _Input:
    """The state of one input: its newest readings, oldest first, and its counts."""

    readings: list[DistanceReading | RayReading] = field(default_factory=list)
    newest_stamp_s: float = -math.inf
    accepted: int = 0
    rejected: Counter[RejectionReason] = field(default_factory=Counter)
    last_reason_text: str = ''
    ahead_s: float = 0.0
    out_of_plane: bool = False

    def count_accepted(self, stamp_s: float, now_s: float) -> None:
        """Count an accepted measurement, and record how far its stamp is ahead of its arrival."""
        self.accepted += 1
        self.newest_stamp_s = max(self.newest_stamp_s, stamp_s)
        self.ahead_s = max(self.ahead_s, stamp_s - now_s)

    def keep(self, reading: DistanceReading | RayReading, most: int, answered_s: float) -> None:
        """
        Add a reading; keep the newest `most` readings up to a time, and the later readings.

        Later readings must not displace those that an answer for that time needs.
        """
        insort(self.readings, reading, key=STAMP_S)
        n_before = bisect_right(self.readings, answered_s, key=STAMP_S)
        # Their number is limited, since it would grow while a clock stands still.
        n_later = len(self.readings) - n_before
        del self.readings[: max(0, n_before - most, n_later - MOST_OBSERVATIONS)]


class MeasurementStore:
    """
    All inputs of a fleet.

    Parameters
    ----------
    config : FleetConfig

    Attributes
    ----------
    memory : Memory
        Recent ranges and bearings.

    """

    def __init__(self, config: FleetConfig) -> None:
        self._forget_all(config)

    def _forget_all(self, config: FleetConfig) -> None:
        """Start without measurements."""
        self._inputs: defaultdict[LinkKey, _Input] = defaultdict(_Input)
        self._tracks: dict[str, OdometryTrack] = {}
        self._stuck = StuckWatch(config)
        self._frozen = FrozenWatch()
        self._elevations = Elevations(config)
        self.memory = Memory(config)
        self._adopt(config)

    def _adopt(self, config: FleetConfig) -> None:
        """Adopt settings that change no stored reading."""
        self._config = self._clock_config = self._stuck.config = self._elevations.config = config
        self._admission = Admission(config)
        self.memory.adopt(config)
        for track in self._tracks.values():
            track.adopt(config)

    def _forget_until(self, stamp_s: float) -> None:
        """Forget the readings up to a time outside the memory; their links are stale."""
        self._elevations.forget_until(stamp_s)
        for source in self._inputs.values():
            source.readings = [one for one in source.readings if one.stamp_s > stamp_s]

    def _take(
        self,
        key: LinkKey,
        value: RangeMessage | ArrayLike,
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds,
    ) -> None:
        """Accept a measurement whose link and stamp were checked."""
        reading: DistanceReading | RayReading
        if key.reference:
            reading = self._difference_reading(key, value, stamp_s, bounds.range_difference_error)
        elif isinstance(value, RangeMessage):
            reading = self._distance_reading(key, value, stamp_s, now_s, bounds.range_error)
        else:
            reading = self._ray_reading(key, value, stamp_s, now_s, bounds)
        source = self._inputs[key]
        source.keep(reading, self._config.max_repeats, now_s - MOST_BEFORE_S)
        source.count_accepted(stamp_s, now_s)
        self.memory.add(reading, now_s)

    def _distance_reading(
        self,
        key: LinkKey,
        message: RangeMessage,
        stamp_s: float,
        now_s: float,
        model: RangeErrorModel,
    ) -> DistanceReading:
        """Return the reading of a range."""
        bounds = interpret_range(model, message)
        reading_m = required_number(message.range_m, 'range')
        self._check_stuck(key, (reading_m,), stamp_s)
        likeliest_m = likeliest_distance_m(model, reading_m)
        reading = DistanceReading(key, stamp_s, *bounds, likeliest_m)
        poses = self._newest_poses(key)
        if poses and len(poses) == len(self._stuck.movable(key)):
            self._frozen.add(reading, poses)
        return self._elevations.in_plane(reading, now_s) if self._config.elevations_m else reading

    def _difference_reading(
        self, key: LinkKey, difference_m: object, stamp_s: float, error: DifferenceErrorModel
    ) -> DistanceReading:
        """Return the reading of a range difference."""
        reading_m = finite_number(difference_m)
        if reading_m is None:
            text = f'range difference {quoted(difference_m)} must be a finite number of meters'
            raise RefusedError(RejectionReason.INVALID_RANGE, text)
        self._check_stuck(key, (reading_m,), stamp_s)
        lower_m = sum_down(reading_m, -error.max_error_m)
        return DistanceReading(key, stamp_s, lower_m, sum_up(reading_m, -error.min_error_m))

    def _ray_reading(
        self,
        key: LinkKey,
        ray_xyz: ArrayLike,
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds,
    ) -> RayReading:
        """Return the reading of a ray."""
        config = self._config
        ray = in_body_frame(config.sensors.get(key.observer), ray_xyz)
        direction = interpret_ray(ray, config.dimension)
        values = tuple(np.asarray(ray_xyz, dtype=float).reshape(-1).tolist())
        self._check_stuck(key, values, stamp_s)
        half_width_rad = bounds.bearing_half_width_rad
        rises = config.elevations_m and self._elevations.squared_rise_m2(*key.ends, stamp_s, now_s)
        body_ray = np.asarray(ray, dtype=float).reshape(-1)
        leaves = config.dimension == 2 and leaves_plane(body_ray, half_width_rad)
        # The error of a tilted ray may be smaller than the error of its projection.
        is_bent = half_width_rad > 0.5 * math.pi and body_ray[2] != 0.0 and config.dimension == 2
        may_rise = bool(rises and rises[1] > 0.0)
        self._inputs[key].out_of_plane = leaves and not may_rise
        if may_rise or leaves or is_bent:
            half_width_rad = projected_half_width_rad(body_ray, half_width_rad)
        expected_rad = bounds.bearing_expected_error_rad
        return RayReading(key, stamp_s, direction, half_width_rad, expected_rad)

    @contextmanager
    def _counted(self, key: LinkKey, *, again: bool = False) -> Iterator[dict[LinkKey, Rejection]]:
        """
        Count a refused measurement on its input, and put the rejection into the dict.

        With `again`, the refusal is raised again for the enclosing input.
        """
        refused: dict[LinkKey, Rejection] = {}
        try:
            yield refused
        except RefusedError as error:
            source, refused[key] = self._inputs[key], error.rejection
            source.rejected[error.rejection.reason] += 1
            source.last_reason_text = error.rejection.text
            if again:
                raise

    def young_readings(self, now_s: float) -> dict[LinkKey, list[DistanceReading | RayReading]]:
        """Return the readings that count at `now_s` by link, in the order of the keys."""
        config = self._config

        def young(source: _Input) -> list[DistanceReading | RayReading]:
            found = [r for r in source.readings if is_young(config, r.stamp_s, now_s)]
            return found[-config.max_repeats :]

        return {
            key: young(self._inputs[key])
            for key in sorted(self._inputs)
            if key.target and self._inputs[key].accepted
        }

    def newest_stamp_s(self, key: LinkKey) -> float:
        """Return the stamp of the newest measurement of an input; -inf if there is none."""
        source = self._inputs.get(key)
        return -math.inf if source is None else source.newest_stamp_s

    def odometry_readings(self, now_s: float) -> dict[str, tuple[OdometrySample, ...]]:
        """Return the odometry of every robot that has some, oldest first, for an answer."""
        for track in self._tracks.values():
            track.answered_s = now_s
        return {robot: track.readings for robot, track in self._tracks.items()}

    def newest_odometry_s(self) -> list[float]:
        """Return the time of the newest odometry of every robot that has some."""
        return [track.newest.stamp_s for track in self._tracks.values()]

    def input_states(self, now_s: float) -> list[InputState]:
        """Return the state of every input, in the order of the keys."""
        return [
            InputState(
                key=key,
                accepted=source.accepted,
                rejected=dict(source.rejected),
                last_reason_text=source.last_reason_text,
                age_s=now_s - source.newest_stamp_s,
                in_use=is_young(self._config, source.newest_stamp_s, now_s),
                stuck=self._stuck.sentence(key),
                restart=self._restart(key, now_s),
                warning='; '.join(self._warnings(key, source)),
            )
            for key, source in sorted(self._inputs.items())
        ]

    def _warnings(self, key: LinkKey, source: _Input) -> Iterator[str]:
        """Yield warnings about the settings or the readings of an input."""
        if key.kind is LinkKind.ODOMETRY and (frozen := self._frozen.sentence(key.observer)):
            yield frozen
        if self._is_ahead(source):
            yield (
                f'stamps are up to {source.ahead_s:.3f} s ahead of their arrival, stamp_error is '
                f'{self._config.stamp_error_s:g} s: answers allow for it; check the clocks'
            )
        if source.out_of_plane:
            yield (
                'the newest ray points up or down by more than its error: its target is not in '
                'the plane; state the elevations of both ends'
            )

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield one sentence for each kind of warning about the inputs."""
        ahead = [key for key, source in self._inputs.items() if self._is_ahead(source)]
        if ahead:
            most_s = max(self._inputs[key].ahead_s for key in ahead)
            yield (
                f'stamps are up to {most_s:.3f} s in the future, more than stamp_error: '
                f'{listed(ahead)}'
            )
        bent = [key for key, source in self._inputs.items() if source.out_of_plane]
        if bent:
            yield f'targets of rays are not in the plane: {listed(bent)}'
        for robot, track in self._tracks.items():
            if frozen := self._frozen.sentence(robot):
                yield f'odometry of {robot} is frozen: {frozen}'
            silent_s = now_s - track.newest.stamp_s
            if SILENT_S < silent_s <= max(self._config.max_age_s, self._config.memory_s):
                yield f'odometry of {robot} is silent for {silent_s:.1f} s'

    def _is_ahead(self, source: _Input) -> bool:
        """Return whether stamps of an input refute `stamp_error_s`."""
        return source.ahead_s > self._config.stamp_error_s

    def config_for_clocks(self) -> FleetConfig:
        """Return the configuration with a `stamp_error_s` that the stamps so far do not refute."""
        ahead_s = max((source.ahead_s for source in self._inputs.values()), default=0.0)
        if ahead_s <= self._clock_config.stamp_error_s:
            return self._clock_config
        steps = math.ceil(ahead_s / CLOCK_STEP_S)
        self._clock_config = replace(self._config, stamp_error_s=steps * CLOCK_STEP_S)
        return self._clock_config

    def _restart(self, key: LinkKey, now_s: float) -> str:
        """Return why odometry restarted within `max_age_s`; empty if it did not."""
        track = self._tracks.get(key.observer) if key.kind is LinkKind.ODOMETRY else None
        if track is None or not is_young(self._config, track.newest.restarted_s, now_s):
            return ''
        return track.restart

    def _track(self, robot: str) -> OdometryTrack:
        """Return the odometry of `robot`, made on first use."""
        if robot not in self._tracks:
            self._tracks[robot] = OdometryTrack(self._config, robot)
        return self._tracks[robot]

    def _newest_poses(self, key: LinkKey) -> dict[str, OdometrySample]:
        """Return the newest odometry of the robots at the ends of a link that can move."""
        if not self._tracks:
            return {}
        robots = [robot for robot in self._stuck.movable(key) if robot in self._tracks]
        return {robot: self._tracks[robot].newest for robot in robots}

    def _check_stuck(self, key: LinkKey, value: tuple[float, ...], stamp_s: float) -> None:
        """Record a reading; refuse it if it is stuck and stuck readings are dropped."""
        self._stuck.add(key, value, stamp_s, self._newest_poses(key))
        if self._config.drop_stuck and (sentence := self._stuck.sentence(key)):
            raise RefusedError(RejectionReason.STUCK, sentence)
