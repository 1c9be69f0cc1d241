# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The interface of the package: measurements in, snapshots and estimates out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
import math
from threading import Lock

from numpy.typing import ArrayLike

from dg_localization.fleet.admission import MOST_BEFORE_S, PeerMeasurement
from dg_localization.fleet.bodies import anchor_geometry
from dg_localization.fleet.checks import require_kind
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.error_models import finite_number
from dg_localization.fleet.estimate import Estimate
from dg_localization.fleet.estimation import estimate_snapshot
from dg_localization.fleet.measurements import MeasurementStore
from dg_localization.fleet.mounts import mount_geometry
from dg_localization.fleet.sensors import SensorBounds
from dg_localization.fleet.snapshot import Snapshot, take_snapshot
from dg_localization.fleet.vocabulary import InputState, LinkKey, LinkKind, RangeMessage, Rejection
from dg_localization.fleet.window.follow import Follower
from dg_localization.interval.environment import default_environment
from dg_localization.solver.options import Cancel

LIMITS = frozenset(
    {
        *('max_age_s', 'max_future_s', 'max_repeats', 'max_hypotheses', 'max_outliers'),
        *('outlier_unit', 'solver', 'memory_max_seconds'),
        *('max_conflict_solves', 'max_conflict_seconds'),
    }
)
"""Settings that say how much is asked and computed, not what a measurement means."""


class Localizer:
    """
    Every placement of a fleet that agrees with its measurements.

    Adding measurements, taking snapshots and `reset` change or read the same store: call them
    from one thread. `estimate` reads nothing but its snapshot and what is kept of the last one,
    and may run in others. What it leaves to the next one is kept when it ends, unless that of a
    later snapshot has begun, or a `reset` came after its own: so one that hangs can be given up.

    After the clock was set back call `reset`: what was measured before is of another time, which
    stamps do not tell.

    Parameters
    ----------
    config : FleetConfig

    Raises
    ------
    ConfigError
        If `config` is no FleetConfig.

    """

    @default_environment()
    def __init__(self, config: FleetConfig) -> None:
        require_kind('config', config, FleetConfig)
        self._config = config
        self._store = MeasurementStore(config)
        self._bodies = anchor_geometry(config), mount_geometry(config)
        self._lock = Lock()
        self._follower = Follower(config.memory_s)
        # That of the estimate that began last, which may still run.
        self._newest = self._follower
        self._snapshots = 0
        # What the estimates of snapshots before this one find counts no more.
        self._first = 0
        self._answered_s = -math.inf

    @property
    def config(self) -> FleetConfig:
        """The settings."""
        return self._config

    @default_environment()
    def configure(self, config: FleetConfig) -> bool:
        """
        Go on with other settings.

        What was measured is kept where limits differ only. It is forgotten where bounds do, which
        it was made with.

        Parameters
        ----------
        config : FleetConfig
            With the same robots, dimension, anchors and mounts.

        Returns
        -------
        bool
            Whether all measurements are kept.

        """
        require_kind('config', config, FleetConfig)
        names = (each.name for each in fields(FleetConfig))
        changed = {name for name in names if getattr(self._config, name) != getattr(config, name)}
        self._config = config
        if changed <= LIMITS:
            self._store.configure(config)
            return True
        self.reset()
        return False

    def reset(self) -> None:
        """Forget all measurements and counts."""
        self._store = MeasurementStore(self._config)
        with self._lock:
            follower = self._follower.started_anew(self._config.memory_s)
            self._newest = self._follower = follower
            self._first = self._snapshots + 1
        self._answered_s = -math.inf

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
            Who measured the distance to whom.
        range_m : float
            In m. As in REP-117, NaN is no reading, +inf is nothing within `max_range_m` and
            -inf is closer than `min_range_m`.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.
        min_range_m, max_range_m : float, optional
            Limits of the sensor; both zero means not given.
        variance_m2 : float, optional
            Variance of the reading.
        bounds : SensorBounds, optional
            Of its error; by default those of the settings.

        Returns
        -------
        Rejection or None
            Why it was not accepted.

        """
        key = LinkKey(LinkKind.RANGE, str(observer), str(target))
        message = RangeMessage(range_m, min_range_m, max_range_m, variance_m2)
        return self._store.add(key, message, stamp_s, now_s, self._or_stated(bounds))

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
            Who saw whom.
        ray_xyz : array_like, shape (3,)
            Direction in the body frame of the observer, x forward and z up, of any length.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.
        bounds : SensorBounds, optional
            Of its error; by default those of the settings.

        Returns
        -------
        Rejection or None
            Why it was not accepted.

        """
        key = LinkKey(LinkKind.BEARING, str(observer), str(target))
        return self._store.add(key, ray_xyz, stamp_s, now_s, self._or_stated(bounds))

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
        Add by how much one point is farther away than another, as of arrivals of radio waves.

        It counts once the observer has odometry, and is remembered.

        Parameters
        ----------
        observer : str
            Who measured: a robot, or a sensor on one.
        first, second : str
            Two anchors, or two points on another robot.
        difference_m : float
            The distance to the second minus that to the first, in m.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.
        bounds : SensorBounds, optional
            Of its error; by default those of the settings.

        Returns
        -------
        Rejection or None
            Why it was not accepted.

        """
        key = LinkKey(LinkKind.RANGE_DIFFERENCE, str(observer), str(second), str(first))
        return self._store.add(key, difference_m, stamp_s, now_s, self._or_stated(bounds))

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
            When it was measured, and the time now, on the same clock.
        frame : str, optional
            The name of the odometry frame. Estimates are in the odometry frame of the reference
            robot only if it has one.

        Returns
        -------
        Rejection or None
            Why it was not accepted.

        """
        key = LinkKey(LinkKind.ODOMETRY, str(robot), '')
        return self._store.add_odometry(key, position_xyz, orientation_xyzw, stamp_s, now_s, frame)

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
        Add an elevation that was read, which narrows the one that is stated.

        It counts for what is added after it: a range in space becomes one in the plane by the
        elevations that are known when it is added.

        Parameters
        ----------
        point : str
            A robot, an anchor or a sensor whose elevation the settings state.
        elevation_m : float
            In m, above the same plane as the stated elevations.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.
        bounds : SensorBounds, optional
            Of its error; by default those of the settings.

        Returns
        -------
        Rejection or None
            Why it was not accepted. One that contradicts what is known is not, and what was read
            before it does not count either: which of them is wrong is not known.

        """
        key = LinkKey(LinkKind.ELEVATION, str(point), '')
        error = self._or_stated(bounds).elevation_error
        return self._store.add_elevation(key, elevation_m, stamp_s, now_s, error)

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
        Add everything that one robot measured of others at one time.

        Parameters
        ----------
        observer : str
            Who measured.
        readings : iterable of (str, float or array_like of shape (3,))
            The target, and either its distance in m or the ray to it, as for `add_range` and
            `add_bearing`. A target may occur twice, with a distance and with a ray. In place of
            a target there may be two points with a number, as for `add_range_difference`.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.
        bounds : SensorBounds, optional
            Of their errors; by default those of the settings.

        Returns
        -------
        list of Rejection
            Why some of the measurements, or all, were not accepted.

        """
        stated = self._or_stated(bounds)
        return self._store.add_peers(str(observer), readings, stamp_s, now_s, stated)

    def _or_stated(self, bounds: SensorBounds | None) -> SensorBounds:
        """Return the bounds that a reading came with, or else those of the settings."""
        return self._config.sensor_bounds if bounds is None else bounds

    def input_states(self, now_s: float) -> list[InputState]:
        """Return what every input has delivered since the start or the last reset."""
        return self._store.input_states(now_s)

    def odometry_restarted_s(self, robot: str) -> float:
        """
        Return when the odometry of a robot last started anew, in s; 0 where it never did.

        Poses of before are in another odometry frame, although that may have the same name.

        Parameters
        ----------
        robot : str
            One whose odometry was accepted.

        """
        return self._store.odometry_restarted_s(robot)

    def answer_time(self, now_s: float) -> float:
        """
        Return the time that an answer is best given for: now, or a little before.

        After its last odometry a robot is bounded by speed and turn rate alone, which blurs all
        that is remembered. So the answer is for the latest time that all odometry covers. Robots
        without odometry of the last `MOST_BEFORE_S` do not count.

        Parameters
        ----------
        now_s : float

        Returns
        -------
        float
            Not before that of an earlier call, as long as time does not go back.

        """
        if self._config.memory_s > 0.0:
            newest_s = self._store.newest_odometry_s()
            known_s = [stamp_s for stamp_s in newest_s if stamp_s >= now_s - MOST_BEFORE_S]
            before_s = min([now_s, *known_s])
            self._answered_s = min(now_s, max(before_s, self._answered_s))
            return self._answered_s
        return now_s

    @default_environment()
    def snapshot(self, now_s: float, tighten_seconds: float = math.inf) -> Snapshot:
        """
        Return what the measurements say at a time; later ones do not change it.

        Parameters
        ----------
        now_s : float
        tighten_seconds : float, optional
            As of the options of the solver, for the estimate of this snapshot; the smaller one
            counts. A caller in a hurry gets wider bounds.

        Returns
        -------
        Snapshot

        Raises
        ------
        ValueError
            If `now_s` is no finite number.

        """
        now = finite_number(now_s)
        if now is None:
            raise ValueError(f'now_s: {now_s!r} is not allowed, it must be a finite number')
        follower = self._follower
        self._snapshots += 1
        taken = take_snapshot(
            self._store, self._bodies, now, follower.forgotten, follower.left_out
        )
        return replace(taken, tighten_seconds=tighten_seconds, number=self._snapshots)

    def estimate(self, snapshot: Snapshot, cancel: Cancel | None = None) -> Estimate:
        """
        Return every placement that agrees with a snapshot.

        A frame other than that of the estimate before is announced in `previous_frame`.

        Parameters
        ----------
        snapshot : Snapshot
        cancel : object with ``is_set()``, optional
            Stops the search when set; what was not examined is part of the answer.

        Returns
        -------
        Estimate

        Raises
        ------
        TypeError
            If `snapshot` is no Snapshot.

        """
        if not isinstance(snapshot, Snapshot):
            raise TypeError(f'snapshot must be of type Snapshot, not {type(snapshot).__name__}')
        follower = self._begun(snapshot)
        if follower.forgotten:
            # An estimate that ended since the snapshot was taken may have forgotten more.
            snapshot = replace(snapshot, window=snapshot.window.without(follower.forgotten))
        estimate, proved = estimate_snapshot(
            snapshot,
            cancel,
            follower.proved_for(snapshot),
            follower.earlier,
        )
        if estimate.conflicts:
            # What contradicts itself now must not cut, or put in doubt, what is remembered.
            follower.earlier = self._follower.earlier.copied()
        follower.forget(snapshot, estimate)
        if cancel is None or not cancel.is_set():
            estimate = follower.follow(snapshot, estimate, proved)
        with self._lock:
            if self._newest is follower:
                self._follower = follower
        return estimate

    def _begun(self, snapshot: Snapshot) -> Follower:
        """Return what the estimate of a snapshot goes on from, for it alone."""
        with self._lock:
            if snapshot.number < self._first:
                return self._follower.started_anew()
            self._first = snapshot.number
            self._newest = self._follower.copied()
            return self._newest

    def step(self, now_s: float) -> Estimate:
        """Return every placement that agrees with the measurements at `now_s`."""
        return self.estimate(self.snapshot(now_s))
