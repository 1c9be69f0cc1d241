# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the diagnostics are made from, and the diagnostics of inputs."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
import math
from operator import attrgetter

from dg_localization.fleet import Estimate, InputState, LinkKey, LinkKind
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from dg_localization.ros.interface.parameters.settings import Settings
from msg_adapters import Level, Status

# What a sensor or a stranger sends may be quoted, and diagnostics are recorded for days.
MOST_CHARACTERS = 300


def shortened(text: str) -> str:
    """Return a text that quotes others, cut to a length that people read."""
    return text if len(text) <= MOST_CHARACTERS else f'{text[: MOST_CHARACTERS - 4]} ...'


def listed(texts: list[str], most: int) -> str:
    """Return the first of some texts, and how many there are besides."""
    more = len(texts) - most
    return f'{", ".join(texts[:most])}{f" and {more} more" if more > 0 else ""}'


@dataclass(frozen=True)
class Malformed:
    """How many messages of a topic could not be read, what was wrong with the last, and when."""

    count: int
    last: str
    last_s: float = -math.inf


NONE_MALFORMED = Malformed(0, '')


@dataclass(frozen=True)
class Report:
    """
    Everything that the diagnostics are made from.

    Attributes
    ----------
    node : str
        Full name of the node; all statuses begin with it.
    settings : Settings
    now_s : float
        The time of the diagnostics.
    estimate : Estimate or None
        The newest one.
    links : tuple of Link
        The inputs the node listens to.
    inputs : mapping of LinkKey to InputState
        What has arrived.
    malformed : mapping of str to Malformed
        By topic, the messages that could not be read.
    wrong_types : mapping of Link to tuple of str
        Inputs whose topic has endpoints of other types, with these types.
    trouble : str
        Why there can be no estimate, such as that the node is inactive; empty when there can.
    failure : str
        What went wrong inside when the last estimate failed; empty when none did.
    warnings : tuple of str
        What an operator must know whatever the estimate is.
    rejecting : mapping of LinkKey to str
        Inputs that have rejected most of their readings lately, with a sentence on why.
    rate_hz : float or None
        How often the fleet has been localized lately; None while that is not known.
    seconds : mapping of str to float
        What the parts of the last answer took.

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
        """Why the estimate is too old to be relied on; empty when it is not."""
        age_s = 0.0 if self.estimate is None else self.now_s - self.estimate.stamp_s
        most_s = self.settings.lifetime_s
        if age_s <= most_s:
            return ''
        return f'late: the last answer is {age_s:.1f} s old, more than {most_s:.1f} s'


def robots_of(key: LinkKey) -> set[str]:
    """Return the ends of a link; for a sensor, the robot that it is on."""
    return {name.partition('/')[0] for name in (key.observer, key.target)}


STALE = Level.WARN, 'stale: nothing acceptable arrived lately'
CONTRADICTS = Level.ERROR, 'contradicts other measurements'


def input_statuses(report: Report) -> Iterator[Status]:
    """
    Yield a status for each input that was named one by one or has ever delivered.

    Others come by the templates, and a topic may exist that nobody uses. Peers have a status
    together, and each of them one of its own.
    """
    contradicting = _contradicting(report)
    mistaken = sorted(report.wrong_types.keys() - set(report.links), key=attrgetter('topic'))
    topics_of = Counter(link.key for link in (*report.links, *mistaken))
    peers_of = _peers_of_observers(report)
    shown: set[LinkKey] = set()
    for link in (*report.links, *mistaken):
        peers = peers_of.get(link.key.observer, {}) if link.key.kind is LinkKind.PEERS else {}
        state = None if link in mistaken else _state_of(report, link)
        malformed = report.malformed.get(link.topic, NONE_MALFORMED)
        if not (link.explicit or state or malformed.count or link in report.wrong_types):
            continue
        found = _input_state(report, link.key, state, malformed)
        if link.key in contradicting or not contradicting.isdisjoint(peers):
            found = CONTRADICTS
        elif link.key.kind is LinkKind.BEARING and not link.explicit and found == STALE:
            found = Level.OK, 'sees nothing now'
        name = f'{link.key} by {link.topic}' if topics_of[link.key] > 1 else str(link.key)
        yield _status(report, name, link, found, state)
        # Two cameras of a robot may see the same one.
        for key in sorted(peers.keys() - shown):
            shown.add(key)
            found = _input_state(report, key, peers[key], NONE_MALFORMED)
            if key in contradicting:
                found = CONTRADICTS
            elif state is not None and state.in_use and found == STALE:
                found = Level.OK, 'not measured now'
            yield _status(report, str(key), replace(link, key=key), found, peers[key])


def _contradicting(report: Report) -> set[LinkKey]:
    if report.estimate is None:
        return set()
    in_links = {link.key for link in report.estimate.links if link.contradicts}
    return in_links.union(*report.estimate.conflicts)


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
    Return a status, with the types that others have on the topic.

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
