# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Diagnostics of an estimate and its inputs: the fleet, each robot, each input."""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from operator import attrgetter

import numpy as np

from dg_localization.fleet import Estimate, Group, InputState, LinkKey, LinkKind, Placement
from dg_localization.fleet.rotations import yaw_of
from dg_localization.ros.interface.intake import (
    LEAST_OFFENCES,
    NONE_MALFORMED,
    Malformed,
    shortened,
)
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from dg_localization.ros.interface.parameters.settings import Settings
from dg_localization.solver.result import Verdict
from dg_localization.texts import LISTED, listed
from msg_adapters import Level, Status

# A smaller fraction of the wanted rate gives a warning.
TOLERATED_RATE = 0.9


@dataclass(frozen=True)
class Report:
    """
    The inputs of the diagnostics.

    Attributes
    ----------
    node : str
        Full name of the node; all statuses begin with it.
    settings : Settings
    now_s : float
        The time of the diagnostics.
    estimate : Estimate or None
        The newest estimate.
    links : tuple of Link
        The inputs that the node subscribes to.
    inputs : mapping of LinkKey to InputState
        The states of all inputs.
    malformed : mapping of str to Malformed
        The messages that could not be read, by topic.
    wrong_types : mapping of Link to tuple of str
        By input, the other types that its topic has.
    trouble : str
        Why there is no estimate, for example because the node is inactive; else empty.
    failure : str
        The internal error of the last estimate; empty if there was none.
    warnings : tuple of str
        Warnings for the operator beside the state of the estimate.
    rejecting : mapping of LinkKey to str
        Inputs that rejected most of their recent readings, each with the reason.
    rate_hz : float or None
        The recent rate of estimates; None while it is unknown.
    seconds : mapping of str to float
        The times of the stages of the last answer.

    """

    node: str
    settings: Settings
    now_s: float
    estimate: Estimate | None
    links: tuple[Link, ...]
    inputs: Mapping[LinkKey, InputState]
    malformed: Mapping[str, Malformed]
    wrong_types: Mapping[Link, tuple[str, ...]]
    trouble: str = ''
    failure: str = ''
    warnings: tuple[str, ...] = ()
    rejecting: Mapping[LinkKey, str] = field(default_factory=dict)
    rate_hz: float | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def late(self) -> str:
        """Why the estimate is too old to be used; empty if it is not."""
        age_s = 0.0 if self.estimate is None else self.now_s - self.estimate.stamp_s
        most_s = self.settings.lifetime_s
        if age_s <= most_s:
            return ''
        return f'late: the last answer is {age_s:.1f} s old, more than {most_s:.1f} s'


def robots_of(key: LinkKey) -> set[str]:
    """Return the robots and anchors that a link measures; for a sensor, its robot."""
    return {name.partition('/')[0] for name in key.points}


def statuses(report: Report) -> tuple[Status, ...]:
    """Return the status of the fleet, of each robot, and of each relevant input."""
    return (
        _fleet_status(report),
        *(_robot_status(report, row) for row in range(len(report.settings.fleet.robots))),
        *_input_statuses(report),
    )


def _fleet_status(report: Report) -> Status:
    level, message = _fleet_state(report)
    warnings = list(_fleet_warnings(report))
    if warnings:
        level, message = max(level, Level.WARN), '; '.join([message, *warnings])
    # Peers are counted one by one.
    inputs = {link.key for link in report.links}.union(report.inputs)
    inputs = {key for key in inputs if key.kind is not LinkKind.PEERS}
    delivering = sum(key in inputs and state.in_use for key, state in report.inputs.items())
    values = {'inputs': str(len(inputs)), 'inputs_in_use': str(delivering)}
    if report.rate_hz is not None:
        values['rate_hz'] = f'{report.rate_hz:.2f}'
    if report.estimate is not None:
        values.update(_estimate_values(report.estimate))
    values.update({name: f'{seconds:.4f}' for name, seconds in report.seconds.items()})
    return Status(level, f'{report.node}: fleet', message, 'fleet', values)


def _fleet_warnings(report: Report) -> Iterator[str]:
    """Yield warnings for the operator beside the state of the fleet."""
    rate_hz, wanted_hz = report.rate_hz, report.settings.rate_hz
    if rate_hz is not None and rate_hz < TOLERATED_RATE * wanted_hz:
        yield f'localizes at {rate_hz:.2g} Hz, not at the {wanted_hz:g} Hz of `rate`'
    for offender in report.estimate.offenders[:LISTED] if report.estimate else ():
        # A single wrong reading is no reason to name a sensor.
        if max(LEAST_OFFENCES, offender.contradictions / 2) <= offender.count:
            yield str(offender)
    if report.rejecting:
        key, reason = next(iter(report.rejecting.items()))
        number = len(report.rejecting)
        yield shortened(f'inputs that reject readings: {number}, such as {key}: {reason}')
    yield from report.warnings


def _fleet_state(report: Report) -> tuple[Level, str]:
    estimate = report.estimate
    if report.trouble:
        return Level.WARN, report.trouble
    if report.failure:
        return Level.ERROR, report.failure
    if report.late:
        return Level.WARN, report.late
    if estimate is None:
        return Level.WARN, 'no estimate yet'
    if estimate.verdict is Verdict.INFEASIBLE:
        return Level.ERROR, f'contradiction: {estimate.reason}'
    if not estimate.placements:
        return Level.WARN, estimate.reason
    problems = [
        *_too_wide(report, estimate, range(len(estimate.robots))),
        *_not_bounded(estimate),
        *_not_settled(estimate),
        *filter(None, (estimate.frame_change, estimate.frame_doubt)),
    ]
    if estimate.groups:
        problems.append(f'{len(estimate.groups)} more in frames of their own')
    text = '; '.join(problems) or 'localized: one hypothesis'
    return Level.WARN if problems else Level.OK, text


def _too_wide(report: Report, estimate: Estimate, rows: Iterable[int]) -> Iterator[str]:
    """Yield a sentence if one hypothesis is left whose enclosures are wide."""
    if estimate.n_hypotheses != 1:
        return
    enclosures = estimate.placements[0].enclosure_m[list(rows)]
    # Robots that are not connected have their own warning.
    widths = [float(np.ptp(box, axis=0).max()) for box in enclosures if np.isfinite(box).all()]
    width_m = max(widths, default=0.0)
    if width_m > report.settings.localized_width_m:
        yield f'one hypothesis, {width_m:.1f} m wide'


def _not_bounded(estimate: Estimate) -> Iterator[str]:
    """Yield which robots are not bounded, apart from those that a group places."""
    grouped = {robot for group in estimate.groups for robot in group.robots}
    bounded = [np.isfinite(one.enclosure_m).all(axis=(1, 2)) for one in estimate.placements]
    rows = np.flatnonzero(~np.all(bounded, axis=0))
    names = [estimate.robots[row] for row in rows if estimate.robots[row] not in grouped]
    if names:
        yield f'not bounded: {listed(names)}'


def _not_settled(estimate: Estimate) -> Iterator[str]:
    """Yield reasons why the placements do not localize the fleet."""
    if any(placement.dropped for placement in estimate.placements):
        yield 'contradicting inputs dropped'
    if estimate.n_hypotheses > 1:
        yield f'ambiguous: {estimate.n_hypotheses} hypotheses'
    if any(placement.flexible for placement in estimate.placements):
        yield 'flexible: robots may be able to move without any measurement changing'
    if estimate.verdict is Verdict.OUT_OF_BUDGET:
        yield 'out of budget: the hypotheses hold every placement, but may be too many or too wide'
    for forgotten in estimate.forgotten:
        yield f'forgotten: {forgotten.text}'
    if estimate.misfits:
        yield f'bounds look too narrow: {listed(estimate.misfits)}'


def _estimate_values(estimate: Estimate) -> dict[str, str]:
    placements = estimate.placements
    proved = [placement for placement in placements if placement.proved]
    values = {
        'stamp_s': f'{estimate.stamp_s:.3f}',
        'verdict': estimate.verdict.value if estimate.verdict else 'none',
        'reason': estimate.reason,
        'hypotheses': str(estimate.n_hypotheses),
        'hypotheses_published': str(len(placements)),
        'hypotheses_proved': str(len(proved)),
        'frame': str(estimate.frame) if estimate.frame else '',
        'frame_changes': str(estimate.frame_changes),
        'hypothesis_numbers': ' '.join(str(placement.number) for placement in placements),
        'proved_numbers': ' '.join(str(placement.number) for placement in proved),
    }
    for placement in placements[:LISTED]:
        proof, width = 'proved' if placement.proved else 'not proved', 'not bounded'
        if np.isfinite(placement.enclosure_m).all():
            width = f'{np.ptp(placement.enclosure_m, axis=1).max():.2f} m wide'
        values[f'hypothesis_{placement.number}'] = f'{proof}, {width}'
    texts = {
        'rigid_groups': '; '.join(', '.join(group) for group in estimate.rigid_groups),
        'ruled_out': '; '.join(estimate.ruled_out),
        'would_fix': '; '.join(estimate.would_fix),
        'suspects': listed(estimate.suspects),
        'suspects_in_window': listed(estimate.suspects_in_window),
    }
    values |= {name: shortened(text) for name, text in texts.items() if text}
    if estimate.statistics is not None:
        values['boxes'] = str(estimate.statistics.processed)
        values['solve_s'] = f'{estimate.statistics.seconds:.4f}'
    links = {link.key: link for link in estimate.links}
    for number, conflict in enumerate(estimate.conflicts):
        values[f'conflict_{number}'] = ', '.join(str(links.get(key, key)) for key in conflict)
    for number, offender in enumerate(estimate.offenders[:LISTED]):
        values[f'offender_{number}'] = str(offender)
    for number, group in enumerate(estimate.groups[:LISTED]):
        text = f'{", ".join(group.robots)}: {group.frame}; hypotheses: {group.n_hypotheses}'
        values[f'group_{number}'] = shortened(text)
    return values


def _robot_status(report: Report, row: int) -> Status:
    robot, estimate = report.settings.fleet.robots[row], report.estimate
    level, message = _robot_state(report, row)
    values = {} if level is Level.OK else {'problem': message}
    if estimate is not None and not report.trouble:
        group = _group_of(estimate, robot)
        values.update(_robot_values((group or estimate).placements, row))
        is_bounded = all(np.isfinite(one.enclosure_m[row]).all() for one in estimate.placements)
        if estimate.placements and is_bounded and group is None and not report.late:
            values.update(_quality(estimate, row))
            texts = [
                f'within {values[name]} m ({name[:-2]})'
                for name in ('typical_m', 'guaranteed_m')
                if name in values
            ]
            message = f'{message}: {", ".join([*texts, values["heard"]])} neighbours heard'
    return Status(level, f'{report.node}: robot {robot}', message, robot, values)


def _robot_values(placements: Sequence[Placement], row: int) -> dict[str, str]:
    """Return the places of one robot in the first hypotheses, and its pose in the first."""
    values = {}
    if placements:
        values['position_m'] = ' '.join(f'{x:.2f}' for x in placements[0].positions_m[row])
        if placements[0].heading_known[row]:
            orientations, half_widths_rad = placements[0].best_headings
            yaw_deg, off_deg = np.degrees([yaw_of(orientations[row]), half_widths_rad[row]])
            values['yaw_deg'] = f'{yaw_deg:.0f} +- {off_deg:.0f}'
    for placement in placements[:LISTED]:
        position = ' '.join(f'{x:.3f}' for x in placement.positions_m[row])
        width = ' '.join(f'{x:.3f}' for x in np.ptp(placement.enclosure_m[row], axis=0))
        values[f'hypothesis_{placement.number}'] = f'at {position} m, enclosure {width} m wide'
    return values


def _robot_state(report: Report, row: int) -> tuple[Level, str]:
    estimate, robot = report.estimate, report.settings.fleet.robots[row]
    if report.trouble or report.late:
        return Level.WARN, report.trouble or report.late
    if estimate is None:
        return Level.WARN, 'no placement'
    if group := _group_of(estimate, robot):
        return Level.WARN, f'not connected to the published frame: placed in {group.frame}'
    if not estimate.placements:
        if any(robot in robots_of(key) for conflict in estimate.conflicts for key in conflict):
            return Level.ERROR, 'no placement: measurements of this robot contradict each other'
        return Level.WARN, 'no placement'
    own_links = [link for link in estimate.links if robot in robots_of(link.key)]
    if all(link.stale for link in own_links):
        what = 'no range, bearing or range difference of this robot'
        if own_links:
            return Level.WARN, f'stale: {what} is in use'
        return Level.WARN, f'never measured: {what} has been accepted'
    enclosures = [placement.enclosure_m[row] for placement in estimate.placements]
    if not np.isfinite(enclosures).all():
        if not estimate.conflicts and any(link.contradicts for link in own_links):
            return Level.WARN, 'in doubt: it contradicts what was measured before'
        return Level.WARN, 'not bounded: too few measurements'
    problems = [*_too_wide(report, estimate, [row]), *_not_settled(estimate)]
    return (Level.WARN, '; '.join(problems)) if problems else (Level.OK, 'localized')


def _quality(estimate: Estimate, row: int) -> dict[str, str]:
    """Return the typical and the greatest error of the pose of a robot, and its partners."""
    values = {}
    if estimate.n_hypotheses == 1:
        placement = estimate.placements[0]
        position_m, enclosure_m = placement.positions_m[row], placement.enclosure_m[row]
        q = len(position_m)
        if placement.covariances is not None:
            typical_m = math.sqrt(max(0.0, float(np.trace(placement.covariances[row, :q, :q]))))
            if math.isfinite(typical_m):
                values['typical_m'] = f'{typical_m:.2f}'
        farthest_m = float(np.linalg.norm(np.abs(enclosure_m - position_m).max(axis=0)))
        values['guaranteed_m'] = f'{farthest_m:.2f}'
    own = estimate.robots[row]
    links = [(robots_of(link.key), link.stale) for link in estimate.links]
    known = {name for ends, _ in links if own in ends for name in ends - {own}}
    heard = {name for ends, stale in links if own in ends and not stale for name in ends - {own}}
    values['heard'] = f'{len(heard)} of {len(known)}'
    return values


def _group_of(estimate: Estimate, robot: str) -> Group | None:
    return next((group for group in estimate.groups if robot in group.robots), None)


STALE = Level.WARN, 'stale: nothing acceptable arrived lately'
CONTRADICTS = Level.ERROR, 'contradicts other measurements'


def _input_statuses(report: Report) -> Iterator[Status]:
    """
    Yield a status for each explicit input and each that has ever delivered.

    Other inputs come from templates, and their topics may exist without a publisher. The peers of
    an input have one common status, and each of them has its own.
    """
    contradicting = set[LinkKey]()
    if report.estimate is not None:
        contradicting.update(link.key for link in report.estimate.links if link.contradicts)
        contradicting.update(*report.estimate.conflicts)
    mistaken = sorted(report.wrong_types.keys() - set(report.links), key=attrgetter('topic'))
    topics_of = Counter(link.key for link in (*report.links, *mistaken))
    with_topic = {link.key for link in report.links}
    came_by: dict[LinkKey, dict[LinkKey, InputState]] = defaultdict(dict)
    for key in report.inputs:
        came_by[key_of_topic(key, with_topic)][key] = report.inputs[key]
    shown: set[LinkKey] = set()
    for link in (*report.links, *mistaken):
        # The peers of the observer of the link; of every observer where the messages name it.
        found = came_by.get(link.key, {})
        together = [one for key, one in found.items() if key.kind is link.key.kind]
        peers = {key: one for key, one in found.items() if key.kind is not link.key.kind}
        is_heard = together and link not in mistaken
        state = _joined(link.key, together) if is_heard else None
        malformed = report.malformed.get(link.topic, NONE_MALFORMED)
        if not (link.explicit or state or malformed.count or link in report.wrong_types):
            continue
        what = _input_state(report, link.key, state, malformed)
        if not contradicting.isdisjoint({link.key, *peers}):
            what = CONTRADICTS
        elif link.key.kind is LinkKind.BEARING and not link.explicit and what == STALE:
            what = Level.OK, 'sees nothing now'
        name = f'{link.key} by {link.topic}' if topics_of[link.key] > 1 else str(link.key)
        yield _status(report, name, link, what, state)
        # Two cameras of a robot may see the same peer.
        for key in sorted(peers.keys() - shown):
            shown.add(key)
            what = _input_state(report, key, peers[key], NONE_MALFORMED)
            if key in contradicting:
                what = CONTRADICTS
            elif state is not None and state.in_use and what == STALE:
                what = Level.OK, 'not measured now'
            yield _status(report, str(key), replace(link, key=key), what, peers[key])


def key_of_topic(key: LinkKey, with_topic: Collection[LinkKey]) -> LinkKey:
    """Return the key of the link by which an input came: its own, or that of peers."""
    together = (LinkKey(LinkKind.PEERS, name, '') for name in (key.observer, ANY_OBSERVER))
    return next((one for one in (key, *together) if one in with_topic), key)


def _joined(key: LinkKey, states: Sequence[InputState]) -> InputState:
    """Return the joined state of several inputs."""
    newest = min(states, key=attrgetter('age_s'))
    rejected = sum((Counter(state.rejected) for state in states), Counter())
    accepted = sum(state.accepted for state in states)
    return replace(newest, key=key, accepted=accepted, rejected=dict(rejected))


def _input_state(
    report: Report, key: LinkKey, state: InputState | None, malformed: Malformed
) -> tuple[Level, str]:
    if state is None:
        wrong = f'malformed: {malformed.last}' if malformed.count else 'nothing received'
        return Level.WARN, wrong
    warning = state.stuck or state.restart or state.warning
    if warning:
        return Level.WARN, warning
    if not state.in_use and malformed.last_s > report.now_s - state.age_s:
        return Level.WARN, f'malformed: {malformed.last}'
    if state.accepted and key in report.rejecting:
        return Level.WARN, shortened(report.rejecting[key])
    if state.in_use:
        return Level.OK, 'in use'
    if state.accepted:
        return STALE
    return Level.WARN, f'nothing acceptable received: {shortened(state.last_reason_text)}'


def _status(
    report: Report, name: str, link: Link, found: tuple[Level, str], state: InputState | None
) -> Status:
    """
    Return a status, with the types of other endpoints of the topic.

    Messages that could not be read count for the topic, not for its peers.
    """
    level, text = found
    if types := report.wrong_types.get(link):
        level = max(level, Level.WARN)
        text += (
            f'; wrong type: the topic also has {", ".join(types)}, this input is {link.type_name}'
        )
    values = {'topic': link.topic, 'type': link.type_name, 'accepted': '0', 'rejected': '0'}
    if state is not None:
        values['accepted'] = str(state.accepted)
        values['rejected'] = str(sum(state.rejected.values()))
        values['age_s'] = f'{state.age_s:.3f}'
        for reason, count in state.rejected.items():
            values[f'rejected_{reason.value}'] = str(count)
        if state.last_reason_text:
            values['last_rejection'] = shortened(state.last_reason_text)
    malformed = report.malformed.get(link.topic, NONE_MALFORMED)
    if malformed.count and link in report.links:
        values['malformed'] = str(malformed.count)
        values['last_malformed'] = malformed.last
    return Status(level, f'{report.node}: input {name}', text, link.key.observer, values)
