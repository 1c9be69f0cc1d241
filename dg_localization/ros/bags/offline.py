# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The work of the node on the messages of a bag, in the time of the bag, into another bag.

The output is an .mcap, written by the package rosbags: equal messages give equal bytes.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
import math
import os
from pathlib import Path
import shutil
from typing import Any, NamedTuple, Self

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from dg_localization.fleet import Cancel, Estimate, Localizer, Snapshot
from dg_localization.ros.bags.bag import NS_PER_S, SILENCE_NS, Bag, BagError, in_seconds
from dg_localization.ros.bags.reading import BagMessage, Reading
from dg_localization.ros.bags.truth import read_truth
from dg_localization.ros.executables import writing
from dg_localization.ros.interface.diagnostics import Report, statuses
from dg_localization.ros.interface.discovery import TopicFinder
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.outputs import (
    DIAGNOSTICS,
    DiagnosticsStream,
    estimate_messages,
    estimate_outputs,
)
from dg_localization.ros.interface.parameters.settings import Settings, declare_settings
from dg_localization.ros.spinning import ros_arguments_checked
from dg_localization.texts import listed
from msg_adapters import Diagnostics, Status

AFTER_LAST_NS = 10 * NS_PER_S
"""Time for which answers continue into a gap, so that the last ones do not look fresh."""

# The encoding of an infinite duration in rosbag2.
FOREVER = (2**31 - 1, 2**32 - 1)

DISCOVERY = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


class Task(NamedTuple):
    """The parameters without time limits, the name of the node, and the names of its outputs."""

    settings: Settings
    node: str
    topics: Mapping[str, str]


def read_task(params: Path, arguments: Sequence[str]) -> Task:
    """Read a file of parameters, and arguments that override it, exactly as the node does."""
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
    """Make a node with the name of the localizer for its parameters, hidden from other nodes."""
    context, before = Context(), os.environ.get(DISCOVERY)
    with ExitStack() as made:
        made.callback(os.environ.update, {} if before is None else {DISCOVERY: before})
        made.callback(os.environ.pop, DISCOVERY)
        os.environ[DISCOVERY] = 'OFF'
        made.callback(context.try_shutdown)
        with ros_arguments_checked():
            rclpy.init(
                args=['--ros-args', '--params-file', str(params), '--', *arguments],
                context=context,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            node = Node(
                'localizer', context=context, enable_rosout=False, start_parameter_services=False
            )
        made.callback(node.destroy_node)
        yield node


class Recording:
    """
    The parts of a bag that a command line names: the inputs of a fleet, and the ground truth.

    Attributes
    ----------
    links : dict of str to Link
        All inputs by topic; explicit links may be missing from the bag.
    wrong_types : dict of Link to tuple of str
        Inputs whose topics have other types, with these types.
    truth : FleetTruth or None
    reading : Reading
        The readable inputs.
    notices : list of str
        Sentences on inputs that cannot be read, and other remarks.

    """

    def __init__(self, options: argparse.Namespace, settings: Settings, bag: Bag) -> None:
        finder = TopicFinder(settings.templates, settings.links, settings.fleet.points)
        found = finder.find(sorted((topic, list(kinds)) for topic, kinds in bag.types.items()))
        links = (*settings.links, *found)
        present = [link for link in links if link.topic in bag.types]
        topics = [link.topic for link in present if link not in finder.wrong_types]
        notices = [
            f'{link.topic} of the links is not in the bag' for link in links if link not in present
        ]
        notices += [
            f'{link.topic} is passed over: {"the link" if link.explicit else "its name"} says '
            f'{link.type_name}, the bag {" and ".join(bag.types[link.topic])}'
            for link in finder.wrong_types
        ]
        if not topics:
            names = ', '.join(f"'{template.text}'" for template in settings.templates) or 'none'
            points, topics_text = ', '.join(settings.fleet.points), ', '.join(sorted(bag.types))
            what = (
                f'no topic of the bag is an input of {points} by the templates {names} and '
                f'{len(settings.links)} links; it has {topics_text}'
            )
            raise BagError('; '.join([what, *notices]))
        self.links = {link.topic: link for link in links}
        self.wrong_types = finder.wrong_types
        self._bag, self.rate_hz = bag, settings.rate_hz
        self._truth = read_truth(options.truth, settings, bag)
        self.truth = self._truth.of_fleet(settings.fleet) if options.truth else None
        self.reading = Reading(bag, topics, options.start, options.duration)
        known = {link.topic for link in (*links, *finder.wrong_types)} | self._truth.topics
        if others := sorted(bag.types.keys() - known):
            notices.append(f'topics that are no input: {len(others)} ({listed(others)})')
        notices += [*self.reading.notices, *self._truth.notices]
        self.notices = list(dict.fromkeys([*bag.notices, *notices]))

    def span_ns(self) -> tuple[int, int]:
        """Return the first and the last time to read."""
        start_ns, end_ns = self.reading.start_ns, min(self._bag.end_ns, self.reading.stop_ns)
        span_s = (end_ns - start_ns) / NS_PER_S
        if span_s < 1.0 / self.rate_hz:
            whole_s, read_s = self._bag.duration_s, max(0.0, span_s)
            raise BagError(
                f'{read_s:.1f} s of the {whole_s:.1f} s of the bag are to be read, less than '
                f"{1.0 / self.rate_hz:g} s, one period of 'rate'"
            )
        return start_ns, end_ns

    def timeline(self, gaps_ns: list[tuple[int, int]]) -> Iterator[tuple[int, BagMessage | None]]:
        """
        Yield messages, and times of answers with None, in order; at equal times messages first.

        The first answer is one period after the start, the last not after the end. Long times
        without messages are left out and added to `gaps_ns`.
        """
        (start_ns, end_ns), rate_hz = self.span_ns(), self.rate_hz
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

        for message in self.reading.shown():
            yield from answers(message.time_ns)
            yield message.time_ns, message
            last_ns = max(last_ns, message.time_ns)
        yield from answers(end_ns + 1)

    @property
    def damage(self) -> list[str]:
        """The damage of the bag, without repetitions: a topic may be both input and truth."""
        return list(dict.fromkeys((*self.reading.damage, *self._truth.damage)))


class BagWriter:
    """Writes serialized messages into a new bag, which is kept if an exception ends it."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        # Jazzy uses version 9.
        self._writer: Any = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._path, self._is_empty = path, True
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Self:
        with writing(self._path):
            self._writer.open()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            with writing(self._path):
                self._writer.close()
        elif self._is_empty:
            self._writer.abort()
            shutil.rmtree(self._path, ignore_errors=True)
        else:
            # On a full disk the end of the file cannot be written either.
            with suppress(OSError):
                self._writer.close()

    def add_output(self, topic: str, message_class: type, profile: QoSProfile) -> None:
        """Add a topic, offered with `profile` when the bag is played."""
        package = message_class.__module__.partition('.')[0]
        self._connections[topic] = self._writer.add_connection(
            topic,
            f'{package}/msg/{message_class.__name__}',
            typestore=self._types,
            offered_qos_profiles=[_recorded_qos(profile)],
        )

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Write a serialized message on a topic that was added."""
        with writing(self._path):
            self._writer.write(self._connections[topic], time_ns, data)
        self._is_empty = False


def _recorded_qos(profile: QoSProfile) -> Any:
    """Return a profile in the format of a bag."""
    from rosbags import interfaces

    kept = interfaces.QosHistory.KEEP_LAST, profile.depth
    reliability = interfaces.QosReliability[profile.reliability.name]
    durability = interfaces.QosDurability[profile.durability.name]
    forever, alive = interfaces.QosTime(*FOREVER), interfaces.QosLiveliness.AUTOMATIC
    how = *kept, reliability, durability
    return interfaces.Qos(*how, forever, forever, alive, forever, False)


class BagLocalizer:
    """
    Does the work of the node at the times that the caller gives.

    Attributes
    ----------
    intake : Intake

    """

    def __init__(self, task: Task, recording: Recording, writer: BagWriter) -> None:
        self._task, self._recording, self._writer = task, recording, writer
        settings = task.settings
        self._localizer = Localizer(settings.fleet)
        self._stream, self._second = DiagnosticsStream(), 0
        self.intake = Intake(self._localizer, settings.use_header_stamp, settings.ids)
        for output in (*estimate_outputs(settings.fleet.robots), DIAGNOSTICS):
            writer.add_output(task.topics[output.name], output.message_class, output.qos)

    def take(self, message: BagMessage) -> None:
        """Take one recorded message."""
        link = self._recording.links[message.topic]
        self.intake.take(link, message.data, in_seconds(message.time_ns))

    def tick(
        self, time_ns: int, cancel: Cancel
    ) -> tuple[Estimate, Snapshot, Sequence[Status]] | None:
        """
        Localize and write the answer; return None and write nothing if it is cancelled.

        Return the estimate, its snapshot, and the statuses that the node would publish.
        """
        now_s = in_seconds(time_ns)
        snapshot = self._localizer.snapshot(self._localizer.answer_time(now_s))
        estimate = self._localizer.estimate(snapshot, cancel)
        if cancel.is_set():
            return None
        settings = self._task.settings
        for name, message in estimate_messages(estimate, settings):
            self._writer.write(self._task.topics[name], time_ns, message)
        report = Report(
            node=self._task.node,
            settings=settings,
            now_s=now_s,
            estimate=estimate,
            links=tuple(self._recording.links.values()),
            inputs=self.intake.states(now_s),
            malformed=self.intake.malformed,
            wrong_types=self._recording.wrong_types,
            rejecting=self.intake.rejecting(now_s),
        )
        diagnostics = Diagnostics(now_s, statuses(report))
        for status in diagnostics.statuses:
            # This value depends on the machine.
            status.values.pop('solve_s', None)
        # Like the node, on a change and every second.
        before, self._second = self._second, time_ns // NS_PER_S
        for name, message in self._stream.messages(diagnostics, self._second != before):
            self._writer.write(self._task.topics[name], time_ns, message)
        return estimate, snapshot, diagnostics.statuses
