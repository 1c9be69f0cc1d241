# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Intake of measurements: each is checked, counted, and converted to a reading.

A measurement that cannot be used never raises an exception: it becomes a `Rejection`, counted by
reason on its input.
"""

from __future__ import annotations

from collections.abc import Iterable

from numpy.typing import ArrayLike

from dg_localization.fleet.admission import PeerMeasurement, read_peer, rows_of_peers
from dg_localization.fleet.error_models import finite_number, interpret_pose, is_single, quoted
from dg_localization.fleet.measurements import MeasurementStore
from dg_localization.fleet.sensors import SensorBounds
from dg_localization.fleet.vocabulary import (
    LinkKey,
    LinkKind,
    OdometrySample,
    RangeMessage,
    RefusedError,
    Rejection,
    RejectionReason,
)
from dg_localization.interval.environment import default_environment


class MeasurementIntake(MeasurementStore):
    """The measurements of a fleet; every `add_...` accepts one or returns its rejection."""

    @default_environment()
    def add_range(
        self,
        observer: str,
        target: str,
        range_m: float,
        stamp_s: float,
        now_s: float,
        min_range_m: float | None = None,
        max_range_m: float | None = None,
        variance_m2: float | None = None,
        bounds: SensorBounds | None = None,
    ) -> Rejection | None:
        """
        Add a range.

        Parameters
        ----------
        observer, target : str
            The points at the ends of the distance; the observer measured it.
        range_m : float
            In m. As in REP-117, NaN is no reading, +inf is nothing within `max_range_m` and
            -inf is closer than `min_range_m`.
        stamp_s, now_s : float
            Time of the measurement and present time, on the same clock.
        min_range_m, max_range_m : float, optional
            Limits of the sensor; both zero means not given.
        variance_m2 : float, optional
            Variance of the reading.
        bounds : SensorBounds, optional
            Error bounds; by default those of the settings.

        Returns
        -------
        Rejection or None
            The reason why it was not accepted; None if it was.

        """
        key = LinkKey(LinkKind.RANGE, str(observer), str(target))
        message = RangeMessage(range_m, min_range_m, max_range_m, variance_m2)
        return self._add(key, message, stamp_s, now_s, bounds)

    @default_environment()
    def add_bearing(
        self,
        observer: str,
        target: str,
        ray_xyz: ArrayLike,
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds | None = None,
    ) -> Rejection | None:
        """
        Add a bearing.

        Parameters
        ----------
        observer, target : str
            The seeing point and the seen point.
        ray_xyz : array_like, shape (3,)
            Direction in the body frame of the observer, x forward and z up, of any length.
        stamp_s, now_s : float
            Time of the measurement and present time, on the same clock.
        bounds : SensorBounds, optional
            Error bounds; by default those of the settings.

        Returns
        -------
        Rejection or None
            The reason why it was not accepted; None if it was.

        """
        key = LinkKey(LinkKind.BEARING, str(observer), str(target))
        return self._add(key, ray_xyz, stamp_s, now_s, bounds)

    @default_environment()
    def add_range_difference(
        self,
        observer: str,
        first: str,
        second: str,
        difference_m: float,
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds | None = None,
    ) -> Rejection | None:
        """
        Add the difference of the distances to two points, for example from arrival times (TDOA).

        It counts once the observer has odometry, as part of the memory.

        Parameters
        ----------
        observer : str
            The observing robot or sensor.
        first, second : str
            Two anchors, or two points on another robot.
        difference_m : float
            The distance to the second minus that to the first, in m.
        stamp_s, now_s : float
            Time of the measurement and present time, on the same clock.
        bounds : SensorBounds, optional
            Error bounds; by default those of the settings.

        Returns
        -------
        Rejection or None
            The reason why it was not accepted; None if it was.

        """
        key = LinkKey(LinkKind.RANGE_DIFFERENCE, str(observer), str(second), str(first))
        return self._add(key, difference_m, stamp_s, now_s, bounds)

    @default_environment()
    def add_odometry(
        self,
        robot: str,
        position_xyz: ArrayLike,
        orientation_xyzw: ArrayLike,
        stamp_s: float,
        now_s: float,
        frame: str = '',
    ) -> Rejection | None:
        """
        Add an odometry pose, which bounds how far a robot has moved and turned.

        Parameters
        ----------
        robot : str
        position_xyz : array_like, shape (3,)
            In m, in the odometry frame.
        orientation_xyzw : array_like, shape (4,)
            Unit quaternion from body to odometry frame.
        stamp_s, now_s : float
            Time of the measurement and present time, on the same clock.
        frame : str, optional
            The name of the odometry frame. Estimates are in the odometry frame of the reference
            robot only if it has one.

        Returns
        -------
        Rejection or None
            The reason why it was not accepted; None if it was.

        """
        robot = str(robot)
        key = LinkKey(LinkKind.ODOMETRY, robot, '')
        with self._counted(key) as refused:
            self._admission.check_robot(robot)
            stamp = self._admission.checked_stamp(stamp_s, now_s)
            error = self._config.odometry_error_of(robot)
            reported_m, place_m, rotation = interpret_pose(position_xyz, orientation_xyzw, error)
            newest_s = self._inputs[key].newest_stamp_s
            if stamp <= newest_s:
                text = f'stamp {stamp} s is not newer than the odometry before it, {newest_s} s'
                raise RefusedError(RejectionReason.TOO_OLD, text)
            sample = OdometrySample(stamp, place_m, rotation, frame, reported_m=reported_m)
            self._track(robot).append(sample)
            self._inputs[key].count_accepted(stamp, now_s)
        return refused.get(key)

    @default_environment()
    def add_elevation(
        self,
        point: str,
        elevation_m: float,
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds | None = None,
    ) -> Rejection | None:
        """
        Add an elevation reading, which narrows the stated elevation.

        It counts for ranges that are added after it: a range is projected to the plane with the
        elevations known when it is added.

        Parameters
        ----------
        point : str
            A robot, an anchor or a sensor whose elevation the settings state.
        elevation_m : float
            In m, above the same plane as the stated elevations.
        stamp_s, now_s : float
            Time of the measurement and present time, on the same clock.
        bounds : SensorBounds, optional
            Error bounds; by default those of the settings.

        Returns
        -------
        Rejection or None
            The reason why it was not accepted; None if it was. A reading that contradicts the
            known bounds is not, and earlier ones stop counting: either may be wrong.

        """
        key = LinkKey(LinkKind.ELEVATION, str(point), '')
        error = (bounds or self._config.sensor_bounds).elevation_error
        with self._counted(key) as refused:
            self._admission.check_elevated(key.observer)
            stamp = self._admission.checked_stamp(stamp_s, now_s)
            reading_m, text = finite_number(elevation_m), ''
            if reading_m is None:
                text = (
                    f'{quoted(elevation_m)} is not allowed, it must be a finite number of meters'
                )
            elif known_m := self._elevations.add(key.observer, reading_m, error, stamp, now_s):
                text = (
                    f'{reading_m} m contradicts what is known: {known_m[0]:.3f} to '
                    f'{known_m[1]:.3f} m; earlier readings do not count either'
                )
            if text:
                raise RefusedError(RejectionReason.INVALID_ELEVATION, f'elevation {text}')
            self._inputs[key].count_accepted(stamp, now_s)
        return refused.get(key)

    @default_environment()
    def add_peers(
        self,
        observer: str,
        readings: Iterable[PeerMeasurement],
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds | None = None,
    ) -> list[Rejection]:
        """
        Add all measurements of one robot at one time.

        Parameters
        ----------
        observer : str
            The observing robot or sensor.
        readings : iterable of (str, float or array_like of shape (3,))
            The target, and either its distance in m or the ray to it, as for `add_range` and
            `add_bearing`. A target may occur twice, with a distance and with a ray. In place of
            a target there may be two points with a number, as for `add_range_difference`.
        stamp_s, now_s : float
            Time of the measurement and present time, on the same clock.
        bounds : SensorBounds, optional
            Error bounds; by default those of the settings.

        Returns
        -------
        list of Rejection
            The reasons why measurements were not accepted.

        """
        observer, stated = str(observer), bounds or self._config.sensor_bounds
        together = LinkKey(LinkKind.PEERS, observer, '')
        rows: list[PeerMeasurement] = []
        rejections: list[Rejection] = []
        with self._counted(together) as refused:
            self._admission.check_names(observer)
            stamp = self._admission.checked_stamp(stamp_s, now_s)
            for row in rows_of_peers(readings):
                rows.append(row)
            # A message without readings still counts as delivered.
        rejections += refused.values()
        if refused and not rows:
            return rejections
        source = self._inputs[together]
        source.newest_stamp_s = max(source.newest_stamp_s, stamp)
        for row in rows:
            with self._counted(together) as refused:
                target, reference, value = read_peer(row)
                kind = LinkKind.RANGE if is_single(value) else LinkKind.BEARING
                kind = LinkKind.RANGE_DIFFERENCE if reference else kind
                key = LinkKey(kind, observer, target, reference)
                with self._counted(key, again=True):
                    self._admission.check_link(key)
                    message = RangeMessage(value) if kind is LinkKind.RANGE else value
                    self._take(key, message, stamp, now_s, stated)
                source.count_accepted(stamp, now_s)
            rejections += refused.values()
        return rejections

    def _add(
        self,
        key: LinkKey,
        value: RangeMessage | ArrayLike,
        stamp_s: float,
        now_s: float,
        bounds: SensorBounds | None,
    ) -> Rejection | None:
        """Accept a range, a ray or a range difference, or return its rejection."""
        with self._counted(key) as refused:
            self._admission.check_link(key)
            stamp = self._admission.checked_stamp(stamp_s, now_s)
            self._take(key, value, stamp, now_s, bounds or self._config.sensor_bounds)
        return refused.get(key)
