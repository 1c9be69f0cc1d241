# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Diagnostics of an estimate and its inputs: the fleet, each robot, each input."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
import math
from operator import attrgetter

import numpy as np

from dg_localization.fleet import Conflict, Estimate, Group, InputState, LinkKey, LinkKind
from dg_localization.ros.interface.doubts import (
    doubts_of_fleet,
    doubts_of_placements,
    doubts_of_width,
)
from dg_localization.ros.interface.hypotheses import hypothesis_values, robot_values
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from dg_localization.ros.interface.suspects import doubts_of_sensors, suspect_values
from dg_localization.solver.result import Verdict
from msg_adapters import Level, Status

LISTED_GROUPS = 8
# What a sensor or a stranger sends may be quoted, and diagnostics are recorded for days.
MOST_CHARACTERS = 300


def shortened(text: str) -> str:
    """Return a text that quotes others, cut to a length that people read."""
    return text if len(text) <= MOST_CHARACTERS else f'{text[: MOST_CHARACTERS - 4]} ...'


# A smaller fraction of the wanted rate is worth a warning.
TOLERATED_RATE = 0.9


@dataclass(frozen=True)
class Malformed:
    """How many messages of a topic could not be read, and what was wrong with the last."""

    count: int
    last: str

    def and_one(self, wrong: str) -> 'Malformed':
        """Return this with one more."""
        return Malformed(self.count + 1, wrong)


NONE_MALFORMED = Malformed(0, '')


@dataclass(frozen=True)
class Report:
    """
    Everything that the diagnostics are made from.

    Attributes
    ----------
    node : str
        Full name of the node; all statuses begin with it.
    trouble : str
        Why there can be no estimate, such as that the node is inactive; empty when there can.
    failure : str
        What went wrong inside when the last estimate failed; empty when none did.
    warnings : tuple of str
        What an operator must know whatever the estimate is.
    now_s : float
        The time of the diagnostics.
    lifetime_s : float
        How old an estimate may become before it is late.
    estimate : Estimate or None
        The newest one.
    robots : tuple of str
        The fleet.
    links : tuple of Link
        The inputs the node listens to.
    inputs : mapping of LinkKey to InputState
        What has arrived.
    malformed : mapping of str to Malformed
        By topic, the messages that could not be read.
    wrong_types : mapping of Link to tuple of str
        Inputs whose topic has endpoints of other types, with these types.
    wanted_rate_hz : float
        How often the fleet is to be localized.
    rate_hz : float or None
        How often it has been localized lately; None while that is not known.
    localized_width_m : float
        A fleet with a wider enclosure is not called localized.

    """

    node: str
    trouble: str
    failure: str
    warnings: tuple[str, ...]
    now_s: float
    lifetime_s: float
    estimate: Estimate | None
    robots: tuple[str, ...]
    links: tuple[Link, ...]
    inputs: Mapping[LinkKey, InputState]
    malformed: Mapping[str, Malformed]
    wrong_types: Mapping[Link, tuple[str, ...]]
    wanted_rate_hz: float = 0.0
    rate_hz: float | None = None
    localized_width_m: float = math.inf

    @property
    def late(self) -> str:
        """Why the estimate is too old to be relied on; empty when it is not."""
        if self.estimate is None or self.now_s - self.estimate.stamp_s <= self.lifetime_s:
            return ''
        age_s = self.now_s - self.estimate.stamp_s
        return f'late: the last answer is {age_s:.1f} s old, more than {self.lifetime_s:.1f} s'


def statuses(report: Report) -> tuple[Status, ...]:
    """Return the status of the fleet, of each robot, and of each input worth one."""
    return (
        _fleet_status(report),
        *(_robot_status(report, row) for row in range(len(report.robots))),
        *_input_statuses(report),
    )


def _fleet_status(report: Report) -> Status:
    level, message = _fleet_state(report)
    warnings = [*_slowness(report), *doubts_of_sensors(report.estimate), *report.warnings]
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
    return Status(level, f'{report.node}: fleet', message, 'fleet', values)


def _slowness(report: Report) -> Iterator[str]:
    """Yield that estimates do not come as often as wanted."""
    rate_hz, wanted_hz = report.rate_hz, report.wanted_rate_hz
    if rate_hz is not None and rate_hz < TOLERATED_RATE * wanted_hz:
        yield f'localizes at {rate_hz:.2g} Hz, not at the {wanted_hz:g} Hz of `rate`'


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
    doubts = list(doubts_of_fleet(estimate, report.localized_width_m))
    if doubts:
        return Level.WARN, '; '.join(doubts)
    return Level.OK, 'localized: one hypothesis'


def _estimate_values(estimate: Estimate) -> dict[str, str]:
    values = {
        'stamp_s': f'{estimate.stamp_s:.3f}',
        'verdict': estimate.verdict.value if estimate.verdict else 'none',
        'reason': estimate.reason,
        'hypotheses': str(estimate.n_hypotheses),
        'hypotheses_published': str(len(estimate.placements)),
        'hypotheses_proved': str(sum(placement.proved for placement in estimate.placements)),
        'frame': str(estimate.frame) if estimate.frame else '',
    }
    values.update(hypothesis_values(estimate.placements))
    if estimate.rigid_groups:
        texts = (', '.join(group) for group in estimate.rigid_groups)
        values['rigid_groups'] = shortened('; '.join(texts))
    if estimate.ruled_out:
        values['ruled_out'] = shortened('; '.join(estimate.ruled_out))
    if estimate.would_fix:
        values['would_fix'] = shortened('; '.join(estimate.would_fix))
    if estimate.statistics is not None:
        values['boxes'] = str(estimate.statistics.processed)
        values['solve_s'] = f'{estimate.statistics.seconds:.4f}'
    for number, conflict in enumerate(estimate.conflicts):
        values[f'conflict_{number}'] = _conflict_text(conflict)
    values.update(suspect_values(estimate))
    for number, group in enumerate(estimate.groups[:LISTED_GROUPS]):
        values[f'group_{number}'] = shortened(_group_text(group))
    return values


def _group_text(group: Group) -> str:
    return f'{", ".join(group.robots)}: {group.frame}; hypotheses: {group.n_hypotheses}'


def _conflict_text(conflict: Conflict) -> str:
    return ', '.join(str(key) for key in conflict)


def _robot_status(report: Report, row: int) -> Status:
    robot = report.robots[row]
    level, message = _robot_state(report, row)
    values = {}
    if report.estimate is not None and not report.trouble:
        group = _group_of(report.estimate, robot)
        placements = report.estimate.placements if group is None else group.placements
        values = robot_values(placements, row)
    return Status(level, f'{report.node}: robot {robot}', message, robot, values)


def _robot_state(report: Report, row: int) -> tuple[Level, str]:
    estimate, robot = report.estimate, report.robots[row]
    if report.trouble or report.late:
        return Level.WARN, report.trouble or report.late
    group = None if estimate is None else _group_of(estimate, robot)
    if group is not None:
        return Level.WARN, f'not connected to the published frame: placed in {group.frame}'
    if estimate is None or not estimate.placements:
        contradicts = estimate is not None and robot in _ends_of(estimate.conflicts)
        if contradicts:
            return Level.ERROR, 'no placement: measurements of this robot contradict each other'
        return Level.WARN, 'no placement'
    if not _is_measured(estimate, robot):
        if _was_ever_measured(report.inputs.values(), robot):
            return Level.WARN, 'stale: no range or bearing of this robot is in use'
        return Level.WARN, 'never measured: no range or bearing of this robot has been accepted'
    enclosures = [placement.enclosure_m[row] for placement in estimate.placements]
    if not np.isfinite(enclosures).all():
        if not estimate.conflicts and _is_left_out(estimate, robot):
            return Level.WARN, 'in doubt: it contradicts what was measured before'
        return Level.WARN, 'not bounded: too few measurements'
    doubts = [
        *doubts_of_width(estimate, [row], report.localized_width_m),
        *doubts_of_placements(estimate),
    ]
    return (Level.WARN, '; '.join(doubts)) if doubts else (Level.OK, 'localized')


def _group_of(estimate: Estimate, robot: str) -> Group | None:
    return next((group for group in estimate.groups if robot in group.robots), None)


def _ends_of(conflicts: Iterable[Conflict]) -> set[str]:
    keys = [key for conflict in conflicts for key in conflict]
    return {robot for key in keys for robot in _robots_of(key)}


def _robots_of(key: LinkKey) -> set[str]:
    """Return the ends of a link; for a sensor, the robot that it is on."""
    return {name.partition('/')[0] for name in (key.observer, key.target)}


def _is_measured(estimate: Estimate, robot: str) -> bool:
    fresh = [link for link in estimate.links if not link.stale]
    return any(robot in _robots_of(link.key) for link in fresh)


def _is_left_out(estimate: Estimate, robot: str) -> bool:
    return any(link.contradicts and robot in _robots_of(link.key) for link in estimate.links)


def _was_ever_measured(inputs: Iterable[InputState], robot: str) -> bool:
    # Odometry and elevations have no target; peers are counted one by one.
    measured = [state.key for state in inputs if state.accepted and state.key.target]
    return any(robot in _robots_of(key) for key in measured)


def _input_statuses(report: Report) -> Iterator[Status]:
    """
    Yield a status for each input that was named one by one or has ever delivered.

    Others come by the templates, and a topic may exist that nobody uses. Peers have a status
    together, and each of them one of its own.
    """
    contradicting = _contradicting(report.estimate)
    topics_of = Counter(link.key for link in report.links)
    peers_of = _peers_of_observers(report)
    shown: set[LinkKey] = set()
    for link in report.links:
        peers = peers_of.get(link.key.observer, {}) if link.key.kind is LinkKind.PEERS else {}
        state = _state_of(report, link)
        malformed = report.malformed.get(link.topic, NONE_MALFORMED)
        if not (link.explicit or state or malformed.count or link in report.wrong_types):
            continue
        contradicts = link.key in contradicting or not contradicting.isdisjoint(peers)
        name = f'{report.node}: input {link.key}'
        if topics_of[link.key] > 1:
            name += f' by {link.topic}'
        wrong_types = report.wrong_types.get(link, ())
        yield _input_status(name, link, state, malformed, contradicts, wrong_types)
        # Two cameras of a robot may see the same one.
        for key in sorted(peers.keys() - shown):
            shown.add(key)
            name = f'{report.node}: input {key}'
            yield _input_status(name, link, peers[key], NONE_MALFORMED, key in contradicting)
    for link in sorted(report.wrong_types.keys() - set(report.links), key=attrgetter('topic')):
        name = f'{report.node}: input {link.key}'
        if link.key in topics_of:
            name += f' by {link.topic}'
        types = report.wrong_types[link]
        yield _input_status(name, link, None, NONE_MALFORMED, False, types)


def _peers_of_observers(report: Report) -> dict[str, dict[LinkKey, InputState]]:
    """Return for each observer what it measured, of that what has no topic of its own."""
    with_topic = {link.key for link in report.links}
    peers: dict[str, dict[LinkKey, InputState]] = {}
    for key, state in report.inputs.items():
        if key not in with_topic and key.kind is not LinkKind.PEERS:
            has_link = LinkKey(LinkKind.PEERS, key.observer, '') in with_topic
            peers.setdefault(key.observer if has_link else ANY_OBSERVER, {})[key] = state
    return peers


def _state_of(report: Report, link: Link) -> InputState | None:
    """Return what has arrived on a link; where messages name their observer, of all of these."""
    if link.key.observer != ANY_OBSERVER:
        return report.inputs.get(link.key)
    with_link = {other.key for other in report.links}
    states = [
        state
        for key, state in report.inputs.items()
        if key.kind is LinkKind.PEERS and key not in with_link
    ]
    if not states:
        return None
    newest = min(states, key=attrgetter('age_s'))
    rejected = sum((Counter(state.rejected) for state in states), Counter())
    accepted = sum(state.accepted for state in states)
    return replace(newest, key=link.key, accepted=accepted, rejected=dict(rejected))


def _input_status(
    name: str,
    link: Link,
    state: InputState | None,
    malformed: Malformed,
    contradicts: bool,
    wrong_types: tuple[str, ...] = (),
) -> Status:
    level, message = _input_state(state, malformed, contradicts)
    if wrong_types:
        level = max(level, Level.WARN)
        message += (
            f'; wrong type: the topic also has {", ".join(wrong_types)}, '
            f'this input is {link.type_name}'
        )
    values = {'topic': link.topic, 'type': link.type_name, **_input_values(state, malformed)}
    return Status(level, name, message, link.key.observer, values)


def _contradicting(estimate: Estimate | None) -> set[LinkKey]:
    if estimate is None:
        return set()
    in_links = {link.key for link in estimate.links if link.contradicts}
    return in_links.union(*estimate.conflicts)


def _input_state(
    state: InputState | None, malformed: Malformed, contradicts: bool
) -> tuple[Level, str]:
    if contradicts:
        return Level.ERROR, 'contradicts other measurements'
    if state is None:
        wrong = f'malformed: {malformed.last}' if malformed.count else 'nothing received'
        return Level.WARN, wrong
    doubt = state.stuck or state.restart or state.warning
    if doubt:
        return Level.WARN, doubt
    if state.in_use:
        return Level.OK, 'in use'
    if state.accepted:
        return Level.WARN, 'stale: nothing acceptable arrived lately'
    return Level.WARN, f'nothing acceptable received: {shortened(state.last_reason_text)}'


def _input_values(state: InputState | None, malformed: Malformed) -> dict[str, str]:
    values = {'accepted': '0', 'rejected': '0'}
    if state is not None:
        values['accepted'] = str(state.accepted)
        values['rejected'] = str(sum(state.rejected.values()))
        values['age_s'] = f'{state.age_s:.3f}'
        for reason, count in state.rejected.items():
            values[f'rejected_{reason.value}'] = str(count)
        if state.last_reason_text:
            values['last_rejection'] = shortened(state.last_reason_text)
    if malformed.count:
        values['malformed'] = str(malformed.count)
        values['last_malformed'] = malformed.last
    return values
