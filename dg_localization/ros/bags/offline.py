# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the node does, without the node: in the time of a bag, into another bag."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
import math
from pathlib import Path
from typing import Any

from rclpy.node import Node

from dg_localization.fleet import Cancel, Estimate, Localizer
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.ros.bags.bag import NS_PER_S, BagError
from dg_localization.ros.bags.reading import BagMessage
from dg_localization.ros.bags.writer import BagWriter
from dg_localization.ros.hidden_node import hidden_localizer
from dg_localization.ros.interface.diagnostics import Report, statuses
from dg_localization.ros.interface.discovery import TopicFinder
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.links import Link
from dg_localization.ros.interface.outputs import (
    DIAGNOSTICS,
    estimate_messages,
    estimate_outputs,
    outline,
)
from dg_localization.ros.interface.parameters.settings import Settings, declare_settings
from msg_adapters import Diagnostics, Status
from msg_adapters.diagnostics import diagnostics_to_cdr

DIAGNOSTICS_HZ = 1.0

SILENCE_S = 60.0
"""A bag without a message of any input for longer has a gap: nothing is answered in it."""

AFTER_LAST_S = 10.0
"""For how long into a gap answers go on, so that the last ones are not taken to be fresh."""


@dataclass(frozen=True)
class Task:
    """
    What is to be done, as the node would do it.

    Attributes
    ----------
    settings : Settings
        The parameters, without limits that depend on a clock.
    node : str
        Full name of the node, without the first slash.
    topics : mapping of str to str
        Full names of the outputs.

    """

    settings: Settings
    node: str
    topics: Mapping[str, str]


def read_task(params: Path, arguments: Sequence[str]) -> Task:
    """Read a file of parameters, and arguments that win over it, exactly as the node does."""
    with hidden_localizer(params, arguments) as node:
        return _task_of(node)


def _task_of(node: Node) -> Task:
    settings = declare_settings(node)
    fleet = settings.fleet
    outputs = [*estimate_outputs(fleet.robots), DIAGNOSTICS]
    return Task(
        settings=replace(
            settings,
            fleet=replace(
                fleet,
                memory_max_seconds=math.inf,
                solver=replace(fleet.solver, max_seconds=math.inf, tighten_seconds=math.inf),
                max_conflict_seconds=math.inf,
            ),
        ),
        node=node.get_fully_qualified_name().lstrip('/'),
        topics={output.name: node.resolve_topic_name(output.name) for output in outputs},
    )


@dataclass(frozen=True)
class Inputs:
    """
    Which topics of a bag are inputs.

    Attributes
    ----------
    links : tuple of Link
        All inputs; those named one by one may be missing from the bag.
    notices : tuple of str
        A sentence for each input that cannot be read.
    topics : tuple of str
        Those to read.
    wrong_types : dict of Link to tuple of str
        Inputs whose topics have other types, with these.

    """

    links: tuple[Link, ...]
    notices: tuple[str, ...]
    topics: tuple[str, ...]
    wrong_types: dict[Link, tuple[str, ...]]


def find_inputs(settings: Settings, recorded: Mapping[str, Sequence[str]]) -> Inputs:
    """Find the inputs of a fleet among recorded topics, each with the types of its messages."""
    finder = TopicFinder(settings.templates, settings.links, settings.fleet.points)
    found = finder.find(sorted((topic, list(kinds)) for topic, kinds in recorded.items()))
    links = (*settings.links, *found)
    others = [link for link in finder.wrong_types if link not in links]
    notices = tuple(filter(None, (_wrong_with(link, recorded) for link in (*links, *others))))
    topics = tuple(link.topic for link in links if not _wrong_with(link, recorded))
    if not topics:
        names = ', '.join(f"'{template.text}'" for template in settings.templates) or 'none'
        what = (
            'no topic of the bag is an input of this fleet: '
            f'its points are {", ".join(settings.fleet.points)}, '
            f'there are {len(settings.links)} links, the templates are {names}, '
            f'and the bag has {", ".join(sorted(recorded)) or "no topics"}'
        )
        raise BagError('; '.join([what, *notices]))
    return Inputs(links, notices, topics, dict(finder.wrong_types))


def _wrong_with(link: Link, recorded: Mapping[str, Sequence[str]]) -> str:
    """Return why a link cannot be read, empty when it can."""
    kinds = recorded.get(link.topic)
    if kinds is None:
        return f'{link.topic} of the links is not in the bag'
    if tuple(kinds) != (link.type_name,):
        says = 'the link' if link.explicit else 'its name'
        return (
            f'{link.topic} is passed over: {says} says {link.type_name}, '
            f'the bag {" and ".join(kinds)}'
        )
    return ''


class BagLocalizer:
    """
    Does what the node does, at the times that the caller gives.

    Parameters
    ----------
    task : Task
    inputs : Inputs
    writer : BagWriter
        Where the answers go.
    copied : collection of str
        Topics whose messages go there too.

    Attributes
    ----------
    intake : Intake
    snapshot : Snapshot or None
        What the last answer is to; None before the first.
    statuses : tuple of Status
        What the node would say at the last answer.

    """

    def __init__(
        self, task: Task, inputs: Inputs, writer: BagWriter, copied: Collection[str] = ()
    ) -> None:
        self._task = task
        self._inputs = inputs
        self._links = {link.topic: link for link in inputs.links}
        self._writer = writer
        self._copied = copied
        self._localizer = Localizer(task.settings.fleet)
        self.snapshot: Snapshot | None = None
        self.statuses: tuple[Status, ...] = ()
        self._estimate: Estimate | None = None
        self._outline: Any = None
        settings = task.settings
        self.intake = Intake(self._localizer, settings.use_header_stamp, settings.ids)
        for output in (*estimate_outputs(task.settings.fleet.robots), DIAGNOSTICS):
            writer.add_output(task.topics[output.name], output.message_class, output.qos)

    def take(self, message: BagMessage) -> None:
        """Take one recorded message."""
        if message.topic in self._copied:
            self._writer.copy(message.topic, message.time_ns, message.data)
        link = self._links[message.topic]
        self.intake.take(link, message.data, in_seconds(message.time_ns))

    def tick(self, time_ns: int, cancel: Cancel) -> Estimate | None:
        """Localize and write the answer; None, and nothing written, when it is cancelled."""
        answer_s = self._localizer.answer_time(in_seconds(time_ns))
        snapshot = self._localizer.snapshot(answer_s)
        estimate = self._localizer.estimate(snapshot, cancel)
        if cancel.is_set():
            return None
        self._estimate, self.snapshot = estimate, snapshot
        settings = self._task.settings
        for name, message in estimate_messages(
            estimate, settings.fixed_frame, settings.lifetime_s, settings.covariance
        ):
            self._writer.write(self._task.topics[name], time_ns, message)
        diagnostics = self._diagnose(time_ns)
        self.statuses = diagnostics.statuses
        if outline(diagnostics) != self._outline:
            self._write(time_ns, diagnostics)
        return estimate

    def write_diagnostics(self, time_ns: int) -> None:
        """Write the diagnostics."""
        self._write(time_ns, self._diagnose(time_ns))

    def _write(self, time_ns: int, diagnostics: Diagnostics) -> None:
        self._outline = outline(diagnostics)
        message = diagnostics_to_cdr(diagnostics)
        self._writer.write(self._task.topics[DIAGNOSTICS.name], time_ns, message)

    def _diagnose(self, time_ns: int) -> Diagnostics:
        now_s = in_seconds(time_ns)
        report = Report(
            node=self._task.node,
            trouble='',
            failure='',
            warnings=(),
            now_s=now_s,
            lifetime_s=self._task.settings.lifetime_s,
            localized_width_m=self._task.settings.localized_width_m,
            estimate=self._estimate,
            robots=self._task.settings.fleet.robots,
            links=tuple(self._links.values()),
            inputs=self.intake.states(now_s),
            malformed=self.intake.malformed,
            wrong_types=self._inputs.wrong_types,
        )
        return Diagnostics(now_s, tuple(map(_without_time_taken, statuses(report))))


def _without_time_taken(status: Status) -> Status:
    """Leave out what depends on the machine."""
    values = {name: value for name, value in status.values.items() if name != 'solve_s'}
    return replace(status, values=values)


def in_seconds(time_ns: int) -> float:
    """Return a time of a bag as the clock of the node gives it."""
    return time_ns * 1e-9


class Event(Enum):
    """What happens in the time of a bag."""

    MESSAGE = 'message'
    TICK = 'tick'
    DIAGNOSTICS = 'diagnostics'
    GAP = 'gap'


def timeline(
    messages: Iterable[BagMessage], start_ns: int, end_ns: int, rate_hz: float
) -> Iterator[tuple[int, Event, BagMessage | None]]:
    """
    Yield messages, ticks and times for diagnostics in order; at the same time in this order.

    The first tick is one period after the start, the last not after the end. A gap is yielded at
    its end.
    """
    beats = _Beats(start_ns, rate_hz)
    silence_ns, after_ns = round(SILENCE_S * NS_PER_S), round(AFTER_LAST_S * NS_PER_S)
    last_ns = start_ns
    for message in messages:
        if message.time_ns - last_ns > silence_ns:
            yield from beats.until(last_ns + after_ns)
            yield message.time_ns, Event.GAP, None
            beats.skip_to(message.time_ns)
        yield from beats.until(message.time_ns)
        yield message.time_ns, Event.MESSAGE, message
        last_ns = max(last_ns, message.time_ns)
    if end_ns - last_ns > silence_ns:
        yield from beats.until(last_ns + after_ns)
        yield end_ns, Event.GAP, None
    else:
        yield from beats.until(end_ns + 1)


class _Beats:
    """The times of ticks and diagnostics, one period after the start and so on."""

    def __init__(self, start_ns: int, rate_hz: float) -> None:
        self._start_ns = start_ns
        self._rates_hz = {Event.TICK: rate_hz, Event.DIAGNOSTICS: DIAGNOSTICS_HZ}
        self._numbers = dict.fromkeys(self._rates_hz, 1)

    def _next_ns(self, event: Event) -> int:
        return self._start_ns + round(self._numbers[event] * NS_PER_S / self._rates_hz[event])

    def until(self, stop_ns: int) -> Iterator[tuple[int, Event, None]]:
        """Yield the times that come next, before another time."""
        while True:
            event = min(self._rates_hz, key=self._next_ns)
            time_ns = self._next_ns(event)
            if time_ns >= stop_ns:
                return
            self._numbers[event] += 1
            yield time_ns, event, None

    def skip_to(self, time_ns: int) -> None:
        """Leave out the times before another time."""
        for event, rate_hz in self._rates_hz.items():
            number = math.ceil((time_ns - self._start_ns) / NS_PER_S * rate_hz)
            self._numbers[event] = max(self._numbers[event], number)
