# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The messages of some topics of a bag, in the order of their receive times."""

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from heapq import heappop, heappush
from typing import NamedTuple

from dg_localization.ros.bags.bag import END_OF_ROS_TIME_NS, NS_PER_S, Bag, BagError, Topic
from dg_localization.ros.bags.conversions import converter


class BagMessage(NamedTuple):
    """A message: its topic, its receive time in ns, and its CDR bytes for the installed type."""

    topic: str
    time_ns: int
    data: bytes


class Reading:
    """
    Some topics of a bag, to be read.

    Parameters
    ----------
    bag : Bag
    names : iterable of str, optional
        The topics; all by default.

    Attributes
    ----------
    topics : list of Topic
        Those that can be read.
    notices : list of str
        One sentence for each topic that is passed over.
    unreadable : Counter of str
        By topic, the damaged messages that were passed over.

    Raises
    ------
    BagError
        If a topic is not in the bag, or none can be read.

    """

    def __init__(self, bag: Bag, names: Iterable[str] | None = None) -> None:
        self.bag = bag
        self.topics: list[Topic] = []
        self.notices: list[str] = []
        self.unreadable: Counter[str] = Counter()
        self._undecodable: list[str] = []
        self._delivered: Counter[str] = Counter()
        self._converters: dict[str, Callable[[bytes], bytes]] = {}
        wanted = sorted(bag.topics if names is None else set(names))
        if missing := [name for name in wanted if name not in bag.topics]:
            raise BagError(
                f'no topic {", ".join(missing)} in the bag; it has {", ".join(sorted(bag.topics))}'
            )
        passed_over: dict[str, list[str]] = defaultdict(list)
        for name in wanted:
            if reason := self._take(bag.topics[name]):
                passed_over[reason].append(name)
        for reason, over in passed_over.items():
            be = 'is' if len(over) == 1 else 'are'
            self.notices.append(f'{", ".join(over)} {be} passed over: {reason}')
        if not self.topics:
            why = '; '.join([*self.notices, *bag.damage]) or 'it has no topics'
            raise BagError(f'nothing in the bag can be read: {why}')

    def _take(self, topic: Topic) -> str:
        """Take a topic among those to read, or return why not."""
        if not topic.count:
            return 'no message'
        if len(topic.type_names) > 1:
            return 'messages of several types'
        (type_name,) = topic.type_names
        if topic.message_class is None:
            return f'the type {type_name} is not installed'
        convert = converter(topic.channels[0], type_name, topic.samples)
        if convert is None:
            reason = f'the messages do not fit any definition of {type_name}'
            self._undecodable.append(f'{topic.name} is passed over: {reason}')
            return reason
        self._converters[topic.name] = convert
        self.topics.append(topic)
        return ''

    @property
    def damage(self) -> list[str]:
        """What is wrong with the bag and with these topics, as far as they were read."""
        lost = [
            f'{name}: none of its messages could be read'
            for name in self.unreadable
            if not self._delivered[name]
        ]
        return [*self.bag.damage, *self._undecodable, *lost]

    def messages(
        self, start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[BagMessage]:
        """
        Yield the messages in the order of their receive times.

        What was latched before the start comes at the start, as a late subscriber gets it.
        """
        start_ns = self.bag.start_ns + round(start_s * NS_PER_S)
        stop_ns = END_OF_ROS_TIME_NS
        if duration_s is not None:
            stop_ns = start_ns + round(duration_s * NS_PER_S)
        latched = {
            topic.name: deque[BagMessage](maxlen=max(1, sum(q.depth for q in topic.offered_qos)))
            for topic in self.topics
            if topic.latched
        }
        for message in self._in_order(stop_ns):
            if message.time_ns >= start_ns:
                for kept in latched.values():
                    yield from kept
                latched.clear()
                yield message
            elif message.topic in latched:
                latched[message.topic].append(message._replace(time_ns=start_ns))

    def _in_order(self, stop_ns: int) -> Iterator[BagMessage]:
        """Yield the messages before a time in the order of their times."""
        waiting: list[tuple[int, int, BagMessage]] = []
        latest_ns = 0
        for number, (channel, time_ns, data) in enumerate(self.bag.records()):
            if channel.topic not in self._converters or time_ns >= stop_ns:
                continue
            message = self._converted(channel.topic, time_ns, data)
            if message is None:
                continue
            latest_ns = max(latest_ns, time_ns)
            heappush(waiting, (time_ns, number, message))
            while waiting[0][0] < latest_ns - self.bag.reorder_ns:
                yield heappop(waiting)[-1]
        while waiting:
            yield heappop(waiting)[-1]

    def _converted(self, topic: str, time_ns: int, data: bytes) -> BagMessage | None:
        """Return a message for the installed type, or None for a damaged one; count both."""
        try:
            message = BagMessage(topic, time_ns, self._converters[topic](data))
        except Exception:  # whatever the generated code of rosbags stumbles over
            self.unreadable[topic] += 1
            return None
        self._delivered[topic] += 1
        return message
