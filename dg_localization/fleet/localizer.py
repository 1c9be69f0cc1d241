"""The door of the fleet room: measurements in, snapshots and estimates out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from numpy.typing import ArrayLike

from dg_localization.fleet.anchors import anchor_geometry
from dg_localization.fleet.answers import (
    Answer,
    Cancel,
    add_statistics,
    answer,
    check_elsewhere,
)
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.conflicts import Explanation, Links, explain
from dg_localization.fleet.constraints import Constraints, constrain
from dg_localization.fleet.estimate import (
    Conflict,
    Estimate,
    InputState,
    LinkKey,
    LinkKind,
    LinkState,
    Rejection,
)
from dg_localization.fleet.frames import FramePlan, plan_frames
from dg_localization.fleet.measurements import MeasurementStore, PeerReading
from dg_localization.fleet.snapshot import Snapshot, take_snapshot
from dg_localization.interval.environment import default_environment
from dg_localization.solver.result import Statistics, Verdict

EXPLANATION_BOXES = 32
"""Most boxes of one problem of an explanation: a contradiction shows early or hardly ever."""


class Localizer:
    """
    Every placement of a fleet that agrees with its measurements.

    Adding measurements, taking snapshots and `reset` change or read the same store: call them
    from one thread. `estimate` reads nothing but its snapshot and may run in any other.

    Parameters
    ----------
    config : FleetConfig

    """

    @default_environment()
    def __init__(self, config: FleetConfig) -> None:
        self._config = config
        self._store = MeasurementStore(config)
        self._anchors = anchor_geometry(config)

    @property
    def config(self) -> FleetConfig:
        """The settings."""
        return self._config

    def reset(self) -> None:
        """Forget all measurements and counts."""
        self._store = MeasurementStore(self._config)

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
    ) -> Rejection | None:
        """
        Take a range.

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

        Returns
        -------
        Rejection or None
            Why it was not taken.

        """
        key = LinkKey(LinkKind.RANGE, observer, target)
        return self._store.add_range(
            key, range_m, stamp_s, now_s, min_range_m, max_range_m, variance_m2
        )

    @default_environment()
    def add_bearing(
        self, observer: str, target: str, ray_xyz: ArrayLike, stamp_s: float, now_s: float
    ) -> Rejection | None:
        """
        Take a bearing.

        Parameters
        ----------
        observer, target : str
            Who saw whom.
        ray_xyz : array_like, shape (3,)
            Direction in the body frame of the observer, x forward and z up, of any length.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.

        Returns
        -------
        Rejection or None
            Why it was not taken.

        """
        key = LinkKey(LinkKind.BEARING, observer, target)
        return self._store.add_bearing(key, ray_xyz, stamp_s, now_s)

    @default_environment()
    def add_odometry(
        self,
        robot: str,
        position_xyz: ArrayLike,
        orientation_xyzw: ArrayLike,
        stamp_s: float,
        now_s: float,
    ) -> Rejection | None:
        """
        Take an odometry pose, which bounds how far a robot has moved and turned.

        Parameters
        ----------
        robot : str
        position_xyz : array_like, shape (3,)
            In m, in the odometry frame.
        orientation_xyzw : array_like, shape (4,)
            Unit quaternion from body to odometry frame.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.

        Returns
        -------
        Rejection or None
            Why it was not taken.

        """
        key = LinkKey(LinkKind.ODOMETRY, robot, '')
        return self._store.add_odometry(key, position_xyz, orientation_xyzw, stamp_s, now_s)

    @default_environment()
    def add_peers(
        self, observer: str, readings: Iterable[PeerReading], stamp_s: float, now_s: float
    ) -> list[Rejection]:
        """
        Take what one robot measured of others at one time.

        Parameters
        ----------
        observer : str
            Who measured.
        readings : iterable of (str, float or ndarray of shape (3,))
            The target, and either its distance in m or the ray to it, as for `add_range` and
            `add_bearing`. A target may come twice, with a distance and with a ray.
        stamp_s, now_s : float
            When it was measured, and the time now, on the same clock.

        Returns
        -------
        list of Rejection
            Why some of it, or all, was not taken.

        """
        return self._store.add_peers(observer, readings, stamp_s, now_s)

    def input_states(self, now_s: float) -> list[InputState]:
        """Return what every input has delivered since the start or the last reset."""
        return self._store.input_states(now_s)

    @default_environment()
    def snapshot(self, now_s: float) -> Snapshot:
        """Return what the measurements say at `now_s`; later ones do not change it."""
        return take_snapshot(self._store, self._config, self._anchors, now_s)

    def estimate(self, snapshot: Snapshot, cancel: Cancel | None = None) -> Estimate:
        """
        Return every placement that agrees with a snapshot.

        Parameters
        ----------
        snapshot : Snapshot
        cancel : object with ``is_set()``, optional
            Stops the search when set; what was not examined is part of the answer.

        Returns
        -------
        Estimate

        """
        return estimate_snapshot(snapshot, cancel)

    def step(self, now_s: float) -> Estimate:
        """Return every placement that agrees with the measurements at `now_s`."""
        return self.estimate(self.snapshot(now_s))


@default_environment()
def estimate_snapshot(snapshot: Snapshot, cancel: Cancel | None = None) -> Estimate:
    """Return every placement that agrees with a snapshot, or the reason why there is none."""
    if not snapshot.keys:
        return _without_placements(snapshot, None, _no_data_reason(snapshot))
    constraints = constrain(snapshot)
    plans = plan_frames(snapshot, constraints, [constraints])
    if isinstance(plans, str):
        found = check_elsewhere(constraints, (), snapshot.config.solver, cancel)
    else:
        found = answer(snapshot, constraints, plans[0], snapshot.config.solver, cancel=cancel)
    if found.verdict is Verdict.INFEASIBLE:
        return _explained(snapshot, constraints, found.statistics, cancel)
    if isinstance(plans, str):
        return _without_placements(snapshot, None, plans)
    return _with_placements(snapshot, found, plans[0])


def _no_data_reason(snapshot: Snapshot) -> str:
    """Return why there is nothing to solve."""
    if not snapshot.links:
        return 'no usable measurement has arrived yet'
    youngest_s = min(link.age_s for link in snapshot.links)
    return (
        f'all measurements are stale: the youngest is {youngest_s:.2f} s old, '
        f'max_age is {snapshot.config.max_age_s:g} s'
    )


def _without_placements(
    snapshot: Snapshot,
    verdict: Verdict | None,
    reason: str,
    statistics: Statistics | None = None,
    conflicts: tuple[Conflict, ...] = (),
) -> Estimate:
    """Return an estimate that is empty, for a reason."""
    return Estimate(
        stamp_s=snapshot.stamp_s,
        robots=snapshot.config.robots,
        verdict=verdict,
        reason=reason,
        statistics=statistics,
        links=_marked_links(snapshot, conflicts),
        conflicts=conflicts,
        landmarks=snapshot.config.landmarks,
    )


def _with_placements(
    snapshot: Snapshot, found: Answer, plan: FramePlan, conflicts: tuple[Conflict, ...] = ()
) -> Estimate:
    """Return an estimate with placements, as many as may be listed."""
    config = snapshot.config
    return Estimate(
        stamp_s=snapshot.stamp_s,
        robots=config.robots,
        verdict=found.verdict,
        reason=_reason(snapshot, found, plan),
        placements=found.placements[: config.max_hypotheses],
        n_hypotheses=found.n_hypotheses,
        statistics=found.statistics,
        links=_marked_links(snapshot, conflicts),
        conflicts=conflicts,
        landmarks=config.landmarks,
        frame=plan.frame,
    )


def _marked_links(snapshot: Snapshot, conflicts: tuple[Conflict, ...]) -> tuple[LinkState, ...]:
    """Return the links of a snapshot, those in a conflict marked."""
    guilty = {key for conflict in conflicts for key in conflict}
    return tuple(
        replace(link, contradicts=LinkKey(link.kind, link.observer, link.target) in guilty)
        for link in snapshot.links
    )


def _reason(snapshot: Snapshot, found: Answer, plan: FramePlan) -> str:
    """Return a sentence on what the placements are."""
    config = snapshot.config
    count = found.n_hypotheses
    parts = ['1 placement' if count == 1 else f'{count} placements']
    if found.verdict is Verdict.OUT_OF_BUDGET:
        parts.append('the search stopped at its budget, what it left open is among them')
    if count > config.max_hypotheses:
        parts.append(f'only {config.max_hypotheses} are listed (max_hypotheses)')
    if any(placement.flexible for placement in found.placements):
        parts.append('the fleet can still move without any measurement changing')
    dropped = sorted({str(key) for place in found.placements for key in place.dropped})
    if dropped:
        parts.append(f'contradicting links are left out: {", ".join(dropped)}')
    lost = [robot for i, robot in enumerate(config.robots) if i not in plan.points]
    if lost:
        parts.append(f'not connected: {", ".join(lost)}')
    stale = sum(link.stale for link in snapshot.links)
    if stale:
        parts.append('1 link is stale' if stale == 1 else f'{stale} links are stale')
    return '; '.join(parts)


def _explained(
    snapshot: Snapshot, constraints: Constraints, statistics: Statistics, cancel: Cancel | None
) -> Estimate:
    """Return what can be said when no placement agrees with all measurements."""
    config = snapshot.config
    explanation = _explanation(snapshot, cancel)
    corrections = explanation.corrections if explanation.complete else ()
    alternatives = [constrain(snapshot, dropped) for dropped in corrections]
    plans = plan_frames(snapshot, constraints, alternatives) if alternatives else ''
    if isinstance(plans, str):
        reason = _contradiction_reason(config, explanation, plans)
        return _without_placements(
            snapshot, Verdict.INFEASIBLE, reason, statistics, explanation.conflicts
        )
    answers = [
        answer(snapshot, alternative, plan, config.solver, dropped, cancel)
        for alternative, plan, dropped in zip(alternatives, plans, corrections, strict=True)
    ]
    for found in answers:
        statistics = add_statistics(statistics, found.statistics)
    verdicts = {found.verdict for found in answers}
    union = Answer(
        verdict=next(v for v in _WORST_FIRST if v in verdicts),
        placements=tuple(place for found in answers for place in found.placements),
        n_hypotheses=sum(found.n_hypotheses for found in answers),
        statistics=statistics,
    )
    return _with_placements(snapshot, union, plans[0], explanation.conflicts)


_WORST_FIRST = (Verdict.OUT_OF_BUDGET, Verdict.COVERED, Verdict.INFEASIBLE)


def _explanation(snapshot: Snapshot, cancel: Cancel | None) -> Explanation:
    """Return which links of a snapshot contradict each other."""
    config = snapshot.config
    everything = frozenset(snapshot.keys)
    boxes = min(EXPLANATION_BOXES, config.solver.max_boxes)
    brief = replace(config.solver, max_boxes=boxes, tighten_slices=0)

    def is_contradiction(links: Links, thorough: bool) -> bool:
        dropped = everything - links
        options = config.solver if thorough else brief
        constraints = constrain(snapshot, dropped)
        plans = plan_frames(snapshot, constraints, [constraints])
        if isinstance(plans, str):
            found = check_elsewhere(constraints, (), options, cancel)
        else:
            found = answer(snapshot, constraints, plans[0], options, dropped, cancel)
        return found.verdict is Verdict.INFEASIBLE

    return explain(
        snapshot.keys,
        is_contradiction,
        config.max_outliers,
        config.max_conflict_solves,
        config.max_conflict_seconds,
        cancel,
    )


def _contradiction_reason(config: FleetConfig, explanation: Explanation, frame: str) -> str:
    """Return why a contradiction leaves no placements."""
    text = 'the measurements contradict each other'
    if explanation.conflicts:
        text += ': ' + '; '.join(
            ', '.join(str(key) for key in conflict) for conflict in explanation.conflicts
        )
    if not explanation.complete:
        text += ' (the search for the cause stopped at its budget)'
    elif frame:
        text += f'; without them, {frame}'
    elif config.max_outliers:
        text += f'; no {config.max_outliers} links can be dropped to make the rest agree'
    return text
