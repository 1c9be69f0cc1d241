# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The messages of topics of a bag in the order of receive times, converted to the installed types.

sensor_msgs/Range has a variance since Iron, and no current subscriber reads the older bytes.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, redirect_stdout, suppress
from functools import cache
from heapq import heappop, heappush
from io import StringIO
from typing import Any, NamedTuple

from dg_localization.ros.bags.bag import NS_PER_S, Bag, BagError, Channel, Topic
from dg_localization.ros.executables import make_progress
from dg_localization.texts import listed

DISTRIBUTIONS = ('JAZZY', 'IRON', 'HUMBLE', 'GALACTIC', 'FOXY', 'ELOQUENT', 'DASHING')
"""Distributions whose definitions are tried if a bag holds no definition of a type."""


class BagMessage(NamedTuple):
    """A message: its topic, its receive time in ns, and its CDR bytes for the installed type."""

    topic: str
    time_ns: int
    data: bytes


class Reading:
    """
    Topics of a bag (default: all) to be read in a part of its time (default: all).

    Attributes
    ----------
    start_ns, stop_ns : int
        The part to be read.
    topics : list of Topic
        The topics that can be read.
    notices : list of str
        A sentence on the skipped topics, if any.
    unreadable : Counter of str
        The number of skipped damaged messages by topic.

    Raises
    ------
    BagError
        If a topic is not in the bag, or none can be read.

    """

    def __init__(
        self,
        bag: Bag,
        names: Iterable[str] | None = None,
        start_s: float = 0.0,
        duration_s: float | None = None,
    ) -> None:
        self.bag = bag
        self.start_ns, self.stop_ns = bag.start_ns + round(start_s * NS_PER_S), bag.end_ns + 1
        if duration_s is not None:
            self.stop_ns = self.start_ns + round(duration_s * NS_PER_S)
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
        reasons = [(name, self._take(bag.topics[name])) for name in wanted]
        if over := [f'{name}: {reason}' for name, reason in reasons if reason]:
            self.notices.append(f'topics passed over: {len(over)} ({listed(over)})')
        if not self.topics:
            why = '; '.join([*self.notices, *self.damage]) or 'it has no topics'
            raise BagError(f'nothing in the bag can be read: {why}')

    def _take(self, topic: Topic) -> str:
        """Add a topic to those to read or to the damage, or return why it is passed over."""
        if not topic.count:
            return 'no message'
        if len(topic.type_names) > 1:
            return 'messages of several types'
        if topic.message_class is None:
            return f'the type {topic.type_names[0]} is not installed'
        convert = converter(topic)
        if convert is None:
            reason = f'the messages do not fit any definition of {topic.type_names[0]}'
            self._undecodable.append(f'{topic.name} is passed over: {reason}')
            return ''
        self._converters[topic.name] = convert
        self.topics.append(topic)
        return ''

    @property
    def damage(self) -> list[str]:
        """The damage of the bag and of these topics, as far as they were read."""
        lost = [name for name in self.unreadable if not self._delivered[name]]
        texts = [f'{name}: none of its messages could be read' for name in lost]
        return [*self.bag.damage, *self._undecodable, *texts]

    def shown(self) -> Iterator[BagMessage]:
        """Yield the messages with a progress bar over the time of the bag."""
        done_ns = self.start_ns
        left_ns = max(0, min(self.bag.end_ns + 1, self.stop_ns) - done_ns)
        with closing(make_progress(left_ns / NS_PER_S)) as progress:
            for message in self.messages():
                yield message
                progress.update((message.time_ns - done_ns) / NS_PER_S)
                done_ns = message.time_ns

    def messages(self) -> Iterator[BagMessage]:
        """
        Yield the messages in the order of their receive times.

        Messages latched before the start come at the start, as for a late subscriber.
        """
        latched = {
            topic.name: deque[BagMessage](maxlen=max(1, sum(q.depth for q in topic.offered_qos)))
            for topic in self.topics
            if topic.latched
        }
        for message in self._in_order():
            if message.time_ns >= self.start_ns:
                for kept in latched.values():
                    yield from kept
                latched.clear()
                yield message
            elif message.topic in latched:
                latched[message.topic].append(message._replace(time_ns=self.start_ns))

    def _in_order(self) -> Iterator[BagMessage]:
        """Yield the messages before a time in the order of their times."""
        waiting: list[tuple[int, int, BagMessage]] = []
        latest_ns = 0
        for number, (topic, time_ns, data) in enumerate(self.bag.records()):
            if topic not in self._converters or time_ns >= self.stop_ns:
                continue
            try:
                message = BagMessage(topic, time_ns, self._converters[topic](data))
            except Exception:  # the generated code of rosbags may raise anything
                self.unreadable[topic] += 1
                continue
            self._delivered[topic] += 1
            latest_ns = max(latest_ns, time_ns)
            heappush(waiting, (time_ns, number, message))
            while waiting[0][0] < latest_ns - self.bag.reorder_ns:
                yield heappop(waiting)[-1]
        while waiting:
            yield heappop(waiting)[-1]


def converter(topic: Topic) -> Callable[[bytes], bytes] | None:
    """Return the conversion of recorded bytes to the installed type; None where none fits."""
    (name,) = topic.type_names
    installed = _typestore('JAZZY')
    if name not in installed.types:
        return decompressed

    def n_fitting(store: Any) -> int:
        """Return the number of the first messages that a definition can read."""
        count = 0
        for data in topic.samples:
            with suppress(Exception):  # the generated code of rosbags may raise anything
                store.deserialize_cdr(decompressed(data), name)
                count += 1
        return count

    recorded = _recorded(topic.channels[0], name)
    stores = [recorded] if recorded else [_typestore(one) for one in DISTRIBUTIONS]
    # The definition that reads the most samples: some may be damaged.
    best = max((s for s in stores if _is_known(s, installed, name)), key=n_fitting, default=None)
    return _conversion(best, name) if best and n_fitting(best) else None


@cache
def _conversion(recorded: Any, type_name: str) -> Callable[[bytes], bytes]:
    """Return the conversion from a definition to the installed one."""
    from rosbags.convert.converter import generate_message_converter

    with redirect_stdout(StringIO()):  # it prints the name of every type it converts
        convert = generate_message_converter(
            recorded, _typestore('JAZZY'), type_name, type_name, {}, src_is2=True, dst_is2=True
        )
    return lambda data: bytes(convert(decompressed(data)))


@cache
def _typestore(distribution: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[f'ROS2_{distribution}'])


@cache
def _recorded(channel: Channel, type_name: str) -> Any:
    """Return the definition in the bag; None if there is none that can be parsed."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        if channel.encoding == 'ros2msg':
            store.register(get_types_from_msg(channel.definition, type_name))
        else:
            for part in filter(str.strip, channel.definition.split('=' * 80 + '\n')):
                first, _, rest = part.partition('\n')
                store.register(get_types_from_idl(rest if first[:4] == 'IDL:' else part))
    except Exception:  # the parsers may raise anything
        return None
    return store if type_name in store.fielddefs else None


def _is_known(recorded: Any, installed: Any, type_name: str) -> bool:
    """
    Return whether the installed definition has all fields of a recorded one.

    A converter drops unknown fields, and leaves zero in the field that they should have filled.
    """
    if type_name not in recorded.fielddefs:
        return False
    names, known = (
        {name for name, _ in store.fielddefs[type_name][1]} for store in (recorded, installed)
    )
    return names <= known


def decompressed(data: bytes) -> bytes:
    """Return the bytes of a message that the recorder may have compressed."""
    if data[:4] != b'\x28\xb5\x2f\xfd':
        return data
    import zstandard

    return zstandard.ZstdDecompressor().decompressobj().decompress(data)
