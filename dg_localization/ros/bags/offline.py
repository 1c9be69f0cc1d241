# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the node does, without the node: in the time of a bag, into another bag."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
import math
import os
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dg_localization.fleet import Cancel, Estimate, Localizer
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.ros.bags.bag import NS_PER_S, BagError, in_seconds
from dg_localization.ros.bags.reading import BagMessage
from dg_localization.ros.bags.writer import BagWriter
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
from dg_localization.ros.spinning import ros_arguments_checked
from msg_adapters import Diagnostics, Status
from msg_adapters.diagnostics import diagnostics_to_cdr

SILENCE_NS = 60 * NS_PER_S
"""A bag without a message of any input for longer has a gap: nothing is answered in it."""

AFTER_LAST_NS = 10 * NS_PER_S
"""For how long into a gap answers go on, so that the last ones are not taken to be fresh."""

NO_DISCOVERY = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}


@dataclass(frozen=True)
class Task:
    """The parameters without limits of time, the name of the node, and those of its outputs."""

    settings: Settings
    node: str
    topics: Mapping[str, str]


def read_task(params: Path, arguments: Sequence[str]) -> Task:
    """Read a file of parameters, and arguments that win over it, exactly as the node does."""
    with _hidden_localizer(params, arguments) as node:
        settings = declare_settings(node)
        fleet = settings.fleet
        outputs = [*estimate_outputs(fleet.robots), DIAGNOSTICS]
        unlimited = replace(
            fleet,
            memory_max_seconds=math.inf,
            solver=replace(fleet.solver, max_seconds=math.inf, tighten_seconds=math.inf),
            max_conflict_seconds=math.inf,
        )
        return Task(
            replace(settings, fleet=unlimited),
            node.get_fully_qualified_name().lstrip('/'),
            {output.name: node.resolve_topic_name(output.name) for output in outputs},
        )


@contextmanager
def _hidden_localizer(params: Path, arguments: Sequence[str]) -> Iterator[Node]:
    """Make a node of the name of the localizer that no fleet at work sees, for its parameters."""
    before = dict(os.environ)
    os.environ.update(NO_DISCOVERY)
    context = Context()
    try:
        with ros_arguments_checked():
            rclpy.init(
                args=['--ros-args', '--params-file', str(params), '--', *arguments],
                context=context,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            node = Node(
                'localizer', context=context, enable_rosout=False, start_parameter_services=False
            )
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()
        for name in NO_DISCOVERY:
            os.environ.pop(name)
            os.environ.update({name: before[name]} if name in before else {})


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

    Attributes
    ----------
    intake : Intake
    snapshot : Snapshot or None
        What the last answer is to; None before the first.
    statuses : tuple of Status
        What the node would say at the last answer.

    """

    def __init__(self, task: Task, inputs: Inputs, writer: BagWriter) -> None:
        self._task = task
        self._inputs = inputs
        self._links = {link.topic: link for link in inputs.links}
        self._writer = writer
        self._localizer = Localizer(task.settings.fleet)
        self.snapshot: Snapshot | None = None
        self.statuses: tuple[Status, ...] = ()
        self._outline: object = None
        settings = task.settings
        self.intake = Intake(self._localizer, settings.use_header_stamp, settings.ids)
        for output in (*estimate_outputs(task.settings.fleet.robots), DIAGNOSTICS):
            writer.add_output(task.topics[output.name], output.message_class, output.qos)

    def take(self, message: BagMessage) -> None:
        """Take one recorded message."""
        link = self._links[message.topic]
        self.intake.take(link, message.data, in_seconds(message.time_ns))

    def tick(self, time_ns: int, cancel: Cancel) -> Estimate | None:
        """Localize and write the answer; None, and nothing written, when it is cancelled."""
        answer_s = self._localizer.answer_time(in_seconds(time_ns))
        snapshot = self._localizer.snapshot(answer_s)
        estimate = self._localizer.estimate(snapshot, cancel)
        if cancel.is_set():
            return None
        self.snapshot = snapshot
        settings = self._task.settings
        for name, message in estimate_messages(
            estimate, settings.fixed_frame, settings.lifetime_s, settings.least_deviation_m
        ):
            self._writer.write(self._task.topics[name], time_ns, message)
        diagnostics = self._diagnose(estimate, in_seconds(time_ns))
        self.statuses = diagnostics.statuses
        # As the node does, on a change and every second.
        second = time_ns // NS_PER_S
        if (second, outline(diagnostics)) != self._outline:
            self._outline = second, outline(diagnostics)
            data = diagnostics_to_cdr(diagnostics)
            self._writer.write(self._task.topics[DIAGNOSTICS.name], time_ns, data)
        return estimate

    def _diagnose(self, estimate: Estimate, now_s: float) -> Diagnostics:
        settings = self._task.settings
        report = Report(
            node=self._task.node,
            trouble='',
            failure='',
            warnings=(),
            now_s=now_s,
            lifetime_s=settings.lifetime_s,
            localized_width_m=settings.localized_width_m,
            estimate=estimate,
            robots=settings.fleet.robots,
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


def timeline(
    messages: Iterable[BagMessage],
    span_ns: tuple[int, int],
    rate_hz: float,
    gaps_ns: list[tuple[int, int]],
) -> Iterator[tuple[int, BagMessage | None]]:
    """
    Yield messages, and times of answers with None, in order; messages first at the same time.

    The first answer is one period after the start, the last not after the end. Times without a
    message for long are left out, and added to the gaps.
    """
    start_ns, end_ns = span_ns
    number, last_ns = 1, start_ns

    def answers(until_ns: int) -> Iterator[tuple[int, None]]:
        """Yield the times of answers before the next message."""
        nonlocal number
        is_gap = until_ns - last_ns > SILENCE_NS
        stop_ns = last_ns + AFTER_LAST_NS if is_gap else until_ns
        while (time_ns := start_ns + round(number * NS_PER_S / rate_hz)) < stop_ns:
            number += 1
            yield time_ns, None
        if is_gap:
            gaps_ns.append((last_ns, min(until_ns, end_ns)))
            number = max(number, math.ceil((until_ns - start_ns) / NS_PER_S * rate_hz))

    for message in messages:
        yield from answers(message.time_ns)
        yield message.time_ns, message
        last_ns = max(last_ns, message.time_ns)
    yield from answers(end_ns + 1)
