# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The interface of the package: measurements in, snapshots and estimates out."""

from __future__ import annotations

from dataclasses import fields, replace
import math
from threading import Lock

from dg_localization.fleet.admission import MOST_BEFORE_S
from dg_localization.fleet.bodies import anchor_geometry
from dg_localization.fleet.checks import require_kind
from dg_localization.fleet.config import FleetConfig
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
        *('outlier_unit', 'solver', 'memory_max_seconds'),
        *('max_conflict_solves', 'max_conflict_seconds'),
    }
)
"""Settings that say how much is asked and computed, not what a measurement means."""


class Localizer(MeasurementIntake):
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
        super().__init__(config)
        self._bodies = anchor_geometry(config), mount_geometry(config)
        self._lock = Lock()
        self._follower = Follower()
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
        self._set_limits(config)
        if changed <= LIMITS:
            return True
        self.reset()
        return False

    def reset(self) -> None:
        """Forget all measurements and counts."""
        self._forget_all(self._config)
        with self._lock:
            follower = self._follower.started_anew()
            self._newest = self._follower = follower
            self._first = self._snapshots + 1
        self._answered_s = -math.inf

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
            newest_s = self.newest_odometry_s()
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
        taken = take_snapshot(self, self._bodies, now, follower.forgotten, follower.left_out)
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
