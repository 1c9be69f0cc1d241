# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The interface of the package: it takes measurements and returns snapshots and estimates."""

from __future__ import annotations

from dataclasses import fields, replace
import math
from operator import attrgetter
from threading import Lock

from dg_localization.fleet.admission import MOST_BEFORE_S
from dg_localization.fleet.bodies import anchor_geometry
from dg_localization.fleet.checks import require_kind
from dg_localization.fleet.config import OF_SENSORS, FleetConfig
from dg_localization.fleet.error_models import finite_number
from dg_localization.fleet.estimate import Estimate
from dg_localization.fleet.estimation import estimate_snapshot
from dg_localization.fleet.intake import MeasurementIntake
from dg_localization.fleet.mounts import mount_geometry
from dg_localization.fleet.snapshot import Snapshot, take_snapshot
from dg_localization.fleet.window.follow import Follower
from dg_localization.interval.environment import default_environment
from dg_localization.solver.options import Cancel

LIMITS = frozenset(
    {
        *('max_age_s', 'max_future_s', 'max_repeats', 'max_hypotheses', 'max_outliers'),
        *('outlier_unit', 'solver', 'memory_s', 'memory_max_seconds'),
        *('max_conflict_solves', 'max_conflict_seconds', 'stuck_readings', 'drop_stuck'),
    }
)
"""Settings that limit the work and the answer, and do not change any reading."""

MOTION = (
    *('max_speed_m_s', 'robot_max_speed_m_s', 'max_turn_rate_rad_s', 'min_separation_m'),
    *('odometry_error', 'robot_odometry_error', 'stamp_error_s'),
)
"""Settings whose former values hold until no reading from before the change is used any more."""

motion_of = attrgetter(*MOTION)


class Localizer(MeasurementIntake):
    """
    Every placement of a fleet that agrees with its measurements.

    Adding measurements, taking snapshots and `reset` use the same store: call them from one
    thread. `estimate` reads only its snapshot and the state left by the last estimate, and may run
    in another thread. Its own state is kept when it ends, unless the estimate of a later snapshot
    has begun or `reset` was called after its snapshot. So an estimate that hangs can be abandoned.

    Call `reset` after the clock was set back: stamps do not show that earlier measurements belong
    to another time.

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
        super().__init__(config)
        self._stated, self._stated_s = config, -math.inf
        self._bodies = anchor_geometry(config), mount_geometry(config)
        self._lock = Lock()
        self._follower = Follower()
        # The follower of the estimate that began last and may still run.
        self._newest = self._follower
        self._snapshots = 0
        # Results of estimates of snapshots before this number are ignored.
        self._first = 0
        self._answered_s = -math.inf

    @property
    def config(self) -> FleetConfig:
        """The settings."""
        return self._stated

    @default_environment()
    def configure(self, config: FleetConfig) -> bool:
        """
        Change the settings.

        Measurements are kept if only limits differ, and bounds that become narrower: the wider
        bounds of earlier readings still hold. Narrower bounds of odometry, speeds and stamps count
        once no reading from before the change is used any more. Measurements are forgotten
        otherwise, since they depend on the other settings.

        Parameters
        ----------
        config : FleetConfig

        Returns
        -------
        bool
            Whether all measurements are kept.

        """
        require_kind('config', config, FleetConfig)
        names = (each.name for each in fields(FleetConfig))
        changed = {name for name in names if getattr(self._config, name) != getattr(config, name)}
        if motion_of(config) != motion_of(self._stated):
            self._stated_s = math.inf
        self._stated = config
        # Earlier readings keep the bounds of sensors that they were added with.
        if changed <= LIMITS.union(OF_SENSORS, MOTION) and config.is_within(self._config):
            former = dict(zip(MOTION, motion_of(self._config), strict=True))
            self._adopt(replace(config, **former))
            return True
        self._bodies = anchor_geometry(config), mount_geometry(config)
        self.reset()
        return False

    def reset(self) -> None:
        """Forget all measurements and counts."""
        self._forget_all(self._stated)
        with self._lock:
            follower = self._follower.started_anew()
            self._newest = self._follower = follower
            self._first = self._snapshots + 1
        self._answered_s = -math.inf

    def answer_time(self, now_s: float) -> float:
        """
        Return the best time for an answer: now, or a little before.

        After its last odometry a robot is bounded by speed and turn rate alone, which widens all
        carried readings. So the answer is for the latest time that all odometry covers. Robots
        without odometry in the last `MOST_BEFORE_S` do not count.

        Parameters
        ----------
        now_s : float

        Returns
        -------
        float
            A time not before the result of an earlier call, unless time goes back.

        """
        if self._config.memory_s > 0.0:
            newest_s = self.newest_odometry_s()
            known_s = [stamp_s for stamp_s in newest_s if stamp_s >= now_s - MOST_BEFORE_S]
            before_s = min([now_s, *known_s])
            self._answered_s = min(now_s, max(before_s, self._answered_s))
            return self._answered_s
        return now_s

    @default_environment()
    def snapshot(self, now_s: float, tighten_seconds: float = math.inf) -> Snapshot:
        """
        Return a snapshot of the measurements at a time; later measurements do not change it.

        Parameters
        ----------
        now_s : float
        tighten_seconds : float, optional
            Limit of `SolverOptions.tighten_seconds` for the estimate of this snapshot; the smaller
            value counts. A shorter time gives wider bounds.

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
        if motion_of(self._config) != motion_of(self._stated):
            self._adopt_if_due(now)
        follower = self._follower
        self._snapshots += 1
        taken = take_snapshot(self, self._bodies, now, follower.forgotten, follower.left_out)
        return replace(taken, tighten_seconds=tighten_seconds, number=self._snapshots)

    def estimate(self, snapshot: Snapshot, cancel: Cancel | None = None) -> Estimate:
        """
        Return every placement that agrees with a snapshot.

        A change of the frame against the estimate before is announced in `previous_frame`.

        Parameters
        ----------
        snapshot : Snapshot
        cancel : object with ``is_set()``, optional
            Stops the search when set; boxes that were not examined stay in the answer.

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
            # Readings of now that contradict each other must not change sets or doubts.
            follower.earlier = self._follower.earlier.copied()
        follower.forget(snapshot, estimate)
        if cancel is None or not cancel.is_set():
            estimate = follower.follow(snapshot, estimate, proved)
        with self._lock:
            if self._newest is follower:
                self._follower = follower
        return estimate

    def _adopt_if_due(self, now_s: float) -> None:
        """Adopt the stated bounds of motion if all readings are from after their change."""
        # The first answer after the change may be for a time before it.
        self._stated_s = min(self._stated_s, now_s + MOST_BEFORE_S)
        config = self.config_for_clocks()
        late_s = max(config.odometry_error_of(robot).latency_s for robot in config.robots)
        oldest_s = [track.readings[0].stamp_s for track in self._tracks.values()]
        oldest_s.append(now_s - max(config.max_age_s, config.memory_s))
        if min(oldest_s) > self._stated_s + late_s:
            self._adopt(self._stated)
            # A longer `max_age_s` must not bring back readings from before the change.
            self._forget_until(self._stated_s + late_s)

    def _begun(self, snapshot: Snapshot) -> Follower:
        """Return a copy of the follower for the estimate of a snapshot."""
        with self._lock:
            if snapshot.number < self._first:
                return self._follower.started_anew()
            self._first = snapshot.number
            self._newest = self._follower.copied()
            return self._newest

    def step(self, now_s: float) -> Estimate:
        """Return every placement that agrees with the measurements at `now_s`."""
        return self.estimate(self.snapshot(now_s))
