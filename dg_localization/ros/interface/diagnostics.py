"""Diagnostics of an estimate and its inputs: the fleet, each robot, each input."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dg_localization.fleet import Conflict, Estimate, InputState, LinkKey, LinkKind
from dg_localization.ros.interface.links import Link
from dg_localization.solver.result import Verdict
from msg_adapters import Level, Status

# The topics hold every placement; the diagnostics show a person the first few.
LISTED_HYPOTHESES = 8

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
    solver_warnings : tuple of str
        Why the solver is slower than it could be.
    wanted_rate_hz : float
        How often the fleet is to be localized.
    rate_hz : float or None
        How often it has been localized lately; None while that is not known.

    """

    node: str
    trouble: str
    failure: str
    estimate: Estimate | None
    robots: tuple[str, ...]
    links: tuple[Link, ...]
    inputs: Mapping[LinkKey, InputState]
    malformed: Mapping[str, Malformed]
    solver_warnings: tuple[str, ...] = ()
    wanted_rate_hz: float = 0.0
    rate_hz: float | None = None


def statuses(report: Report) -> tuple[Status, ...]:
    """Return the status of the fleet, of each robot, and of each input worth one."""
    return (
        _fleet_status(report),
        *(_robot_status(report, row) for row in range(len(report.robots))),
        *_input_statuses(report),
    )


def _fleet_status(report: Report) -> Status:
    level, message = _fleet_state(report)
    slowness = list(_slowness(report))
    if slowness:
        level, message = max(level, Level.WARN), '; '.join([message, *slowness])
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
    """Yield that estimates do not come as often as wanted, and why the solver is slow."""
    rate_hz, wanted_hz = report.rate_hz, report.wanted_rate_hz
    if rate_hz is not None and rate_hz < TOLERATED_RATE * wanted_hz:
        yield f'localizes at {rate_hz:.2g} Hz, not at the {wanted_hz:g} Hz of `rate`'
    yield from report.solver_warnings


def _fleet_state(report: Report) -> tuple[Level, str]:
    estimate = report.estimate
    if report.trouble:
        return Level.WARN, report.trouble
    if report.failure:
        return Level.ERROR, report.failure
    if estimate is None:
        return Level.WARN, 'no estimate yet'
    if estimate.verdict is Verdict.INFEASIBLE:
        return Level.ERROR, f'contradiction: {estimate.reason}'
    if not estimate.placements:
        return Level.WARN, estimate.reason
    doubts = list(_doubts(estimate))
    if doubts:
        return Level.WARN, '; '.join(doubts)
    return Level.OK, 'localized: one hypothesis'


def _doubts(estimate: Estimate) -> Iterator[str]:
    """Yield why the placements do not settle where the fleet is."""
    if any(placement.dropped for placement in estimate.placements):
        yield 'contradicting inputs dropped'
    if estimate.n_hypotheses > 1:
        yield f'ambiguous: {estimate.n_hypotheses} hypotheses'
    if any(placement.flexible for placement in estimate.placements):
        yield 'flexible: robots could move without any measurement changing'
    if estimate.verdict is Verdict.OUT_OF_BUDGET:
        yield 'out of budget: the hypotheses hold every placement, but may be too many or too wide'


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
    if estimate.statistics is not None:
        values['boxes'] = str(estimate.statistics.processed)
        values['solve_s'] = f'{estimate.statistics.seconds:.4f}'
    for number, conflict in enumerate(estimate.conflicts):
        values[f'conflict_{number}'] = _conflict_text(conflict)
    return values


def _conflict_text(conflict: Conflict) -> str:
    return ', '.join(str(key) for key in conflict)


def _robot_status(report: Report, row: int) -> Status:
    robot = report.robots[row]
    level, message = _robot_state(report, row)
    values = {}
    if report.estimate is not None and not report.trouble:
        for number, placement in enumerate(report.estimate.placements[:LISTED_HYPOTHESES]):
            position = ' '.join(f'{x:.3f}' for x in placement.positions_m[row])
            width = ' '.join(f'{x:.3f}' for x in np.ptp(placement.enclosure_m[row], axis=0))
            values[f'hypothesis_{number}'] = f'at {position} m, enclosure {width} m wide'
    return Status(level, f'{report.node}: robot {robot}', message, robot, values)


def _robot_state(report: Report, row: int) -> tuple[Level, str]:
    estimate = report.estimate
    if report.trouble:
        return Level.WARN, report.trouble
    if estimate is None or not estimate.placements:
        robot = report.robots[row]
        contradicts = estimate is not None and robot in _ends_of(estimate.conflicts)
        if contradicts:
            return Level.ERROR, 'no placement: measurements of this robot contradict each other'
        return Level.WARN, 'no placement'
    if not _is_measured(estimate, report.robots[row]):
        return Level.WARN, 'stale: no measurement of this robot is in use'
    enclosures = [placement.enclosure_m[row] for placement in estimate.placements]
    if not np.isfinite(enclosures).all():
        return Level.WARN, 'not bounded: too few measurements'
    doubts = list(_doubts(estimate))
    return (Level.WARN, '; '.join(doubts)) if doubts else (Level.OK, 'localized')


def _ends_of(conflicts: Iterable[Conflict]) -> set[str]:
    keys = [key for conflict in conflicts for key in conflict]
    return {name for key in keys for name in (key.observer, key.target)}


def _is_measured(estimate: Estimate, robot: str) -> bool:
    fresh = [link for link in estimate.links if not link.stale]
    return any(robot in (link.key.observer, link.key.target) for link in fresh)


def _input_statuses(report: Report) -> Iterator[Status]:
    """
    Yield a status for each input that was named one by one or has ever delivered.

    Others come by the templates, and a topic may exist that nobody uses. Peers have a status
    together, and each of them one of its own.
    """
    contradicting = _contradicting(report.estimate)
    topics_of = Counter(link.key for link in report.links)
    peers_of = _peers_of_observers(report)
    for link in report.links:
        peers = peers_of.get(link.key.observer, {}) if link.key.kind is LinkKind.PEERS else {}
        state = report.inputs.get(link.key)
        malformed = report.malformed.get(link.topic, NONE_MALFORMED)
        if not (link.explicit or state or malformed.count):
            continue
        contradicts = link.key in contradicting or not contradicting.isdisjoint(peers)
        name = f'{report.node}: input {link.key}'
        if topics_of[link.key] > 1:
            name += f' by {link.topic}'
        yield _input_status(name, link, state, malformed, contradicts)
        for key, peer in peers.items():
            name = f'{report.node}: input {key}'
            yield _input_status(name, link, peer, NONE_MALFORMED, key in contradicting)


def _peers_of_observers(report: Report) -> dict[str, dict[LinkKey, InputState]]:
    """Return for each observer what it measured, of that what has no topic of its own."""
    with_topic = {link.key for link in report.links}
    peers: dict[str, dict[LinkKey, InputState]] = {}
    for key, state in report.inputs.items():
        if key not in with_topic and key.kind is not LinkKind.PEERS:
            peers.setdefault(key.observer, {})[key] = state
    return peers


def _input_status(
    name: str, link: Link, state: InputState | None, malformed: Malformed, contradicts: bool
) -> Status:
    level, message = _input_state(state, malformed, contradicts)
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
    if state.in_use:
        return Level.OK, 'in use'
    if state.accepted:
        return Level.WARN, 'stale: nothing acceptable arrived lately'
    return Level.WARN, f'nothing acceptable received: {state.last_reason_text}'


def _input_values(state: InputState | None, malformed: Malformed) -> dict[str, str]:
    values = {'accepted': '0', 'rejected': '0'}
    if state is not None:
        values['accepted'] = str(state.accepted)
        values['rejected'] = str(sum(state.rejected.values()))
        values['age_s'] = f'{state.age_s:.3f}'
        for reason, count in state.rejected.items():
            values[f'rejected_{reason.value}'] = str(count)
        if state.last_reason_text:
            values['last_rejection'] = state.last_reason_text
    if malformed.count:
        values['malformed'] = str(malformed.count)
        values['last_malformed'] = malformed.last
    return values
