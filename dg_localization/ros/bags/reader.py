# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Recorded messages, by the package rosbags: rosbag2 in .db3 and .mcap.

Bytes of a type that has got other fields since the recording are brought up to date:
sensor_msgs/Range has a variance since Iron, and no subscriber of today reads the bytes of before.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from heapq import heappop, heappush
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from operator import index
from pathlib import Path
import re
from typing import Any, NamedTuple

from dg_localization.optional import install_hint
from dg_localization.ros.bags.conversions import Conversions
from dg_localization.ros.executables import ExecutableError

NS_PER_S = 1_000_000_000
# So many messages of a topic show by which definition they were written.
SAMPLES = 20
# They are sought among so many messages of all topics; then among those of the others alone.
MOST_SAMPLED = 50_000
TYPE_NAME = re.compile(r'[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9]*')
STORAGE_ENDINGS = ('.db3', '.mcap')
# The recorder hands over messages in the order of callbacks, not of their receive times, and a
# file of a split bag ends among them.
MOST_OUT_OF_ORDER_NS = NS_PER_S
RESCUE = "'ros2 bag reindex' or 'mcap recover' may save what is left"


class BagError(ExecutableError):
    """The bag cannot be used; the text says why and what to do."""


class BagMessage(NamedTuple):
    """A message: its topic, its receive time in ns, and its CDR bytes for the installed type."""

    topic: str
    time_ns: int
    data: bytes


class Topic(NamedTuple):
    """
    A topic of a bag.

    Attributes
    ----------
    name : str
        Its name.
    message_class : type
        The installed class of its messages.
    latched : bool
        Whether late subscribers get the last messages.
    type_name : str
        Such as 'sensor_msgs/msg/Range'.
    offered_qos : tuple of rosbags.interfaces.Qos
        What the recorded publishers offered.

    """

    name: str
    message_class: type
    latched: bool
    type_name: str
    offered_qos: tuple[Any, ...]


class Bag:
    """
    A rosbag2, open for reading.

    Parameters
    ----------
    path : Path
        A bag folder, or a .db3 or .mcap file.
    topics : sequence of str, optional
        Only these topics; all by default.
    span_ns : tuple of int, optional
        The first and the last receive time; what the index of the bag says by default.

    Attributes
    ----------
    topics : list of Topic
        The topics that can be read.
    notices : list of str
        One sentence for each topic that is passed over.
    damaged : list of str
        Those of the notices that are about damage.
    start_ns, end_ns : int
        Receive times of the first and the last message of the bag.
    delivered, unreadable : Counter of str
        By topic, the messages that were read so far, and the damaged ones passed over.

    Raises
    ------
    BagError
        If the path is no bag, a wanted topic is not in it, or nothing in it can be read.

    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[str] | None = None,
        span_ns: tuple[int, int] | None = None,
    ) -> None:
        self.topics: list[Topic] = []
        self.notices: list[str] = []
        self.damaged: list[str] = []
        self.delivered: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()
        self._connections: list[Any] = []
        self._converters: dict[str, Callable[[bytes], bytes]] = {}
        self._path = path
        self._reader = _open(path)
        self._conversions = Conversions(self._reader.typestore)
        try:
            with _damage_reported(path):
                self.start_ns, self.end_ns = span_ns or self.index_span_ns
                self._choose(topics)
        except BagError:
            self.close()
            raise

    def _choose(self, wanted: Sequence[str] | None) -> None:
        """Sort the topics of the bag into those to read and those to pass over."""
        recorded = self._reader.topics
        missing = sorted(set(wanted or ()) - set(recorded))
        if missing:
            raise BagError(
                f'no topic {", ".join(missing)} in the bag; it has {", ".join(sorted(recorded))}'
            )
        chosen = sorted(wanted or recorded)
        samples = self._samples({name: recorded[name] for name in chosen})
        for name in chosen:
            reason = self._take(name, recorded[name], samples[name])
            if reason:
                self.notices.append(f'{name} is passed over: {reason}')
        if not self.topics:
            why = '; '.join(self.notices) or 'it has no topics'
            raise BagError(f'nothing in the bag can be read: {why}')

    def _take(self, name: str, info: Any, samples: Sequence[bytes]) -> str:
        """Take a topic among those to read, or return why not."""
        if not info.msgcount:
            return 'it holds no message'
        if info.msgtype is None:
            return 'it holds messages of several types'
        message_class = find_message_class(info.msgtype)
        if message_class is None:
            return f'its type {info.msgtype} is not installed'
        converter = self._conversions.of(info, samples)
        if converter is None:
            reason = f'its messages do not fit any definition of {info.msgtype}'
            self.damaged.append(f'{name} is passed over: {reason}')
            return reason
        self._converters[name] = converter
        self._connections += info.connections
        offered = tuple(qos for c in info.connections for qos in c.ext.offered_qos_profiles)
        latched = any(qos.durability.name == 'TRANSIENT_LOCAL' for qos in offered)
        self.topics.append(Topic(name, message_class, latched, info.msgtype, offered))
        return ''

    def _samples(self, infos: Mapping[str, Any]) -> Mapping[str, Sequence[bytes]]:
        """
        Return the first messages of each topic, without those behind damage of the file.

        One pass over the beginning of the bag serves most topics, another one what comes late.
        """
        samples = self._first_of_each(infos, MOST_SAMPLED)
        wanted = {name: min(SAMPLES, info.msgcount) for name, info in infos.items()}
        late = {name: infos[name] for name in infos if len(samples[name]) < wanted[name]}
        samples |= self._first_of_each(late, None)
        for name, info in late.items():
            # What damage hides from all together may be reached alone.
            if len(samples[name]) < wanted[name]:
                samples |= self._first_of_each({name: info}, None)
        return samples

    def _first_of_each(self, infos: Mapping[str, Any], most: int | None) -> dict[str, list[bytes]]:
        """Return the first messages of each topic, found in one pass over `most` messages."""
        samples: dict[str, list[bytes]] = {name: [] for name in infos}
        missing = {name for name, info in infos.items() if info.msgcount}
        if not missing:
            return samples
        for topic, data in self._first_messages(infos.values(), most):
            if len(samples[topic]) == SAMPLES:
                continue
            samples[topic].append(data)
            if len(samples[topic]) == min(SAMPLES, infos[topic].msgcount):
                missing.discard(topic)
                if not missing:
                    break
        return samples

    def _first_messages(
        self, infos: Iterable[Any], most: int | None
    ) -> Iterator[tuple[str, bytes]]:
        """Yield topics and messages in the order of the bag, up to the first damage."""
        connections = [connection for info in infos for connection in info.connections]
        try:
            for connection, _, data in islice(self._reader.messages(connections), most):
                yield connection.topic, data
        except Exception:  # it comes again, and is reported, when the messages are read
            return

    @property
    def index_span_ns(self) -> tuple[int, int]:
        """The first and the last receive time, as the index of the bag says."""
        return int(self._reader.start_time), int(self._reader.end_time) - 1

    @property
    def index_counts(self) -> dict[str, int]:
        """By topic the number of messages, as the index of the bag says."""
        return {name: info.msgcount for name, info in self._reader.topics.items()}

    @property
    def duration_s(self) -> float:
        """Time from the first message of the bag to just after the last."""
        return (self.end_ns + 1 - self.start_ns) / NS_PER_S

    def messages(
        self, start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[BagMessage]:
        """
        Read the messages of the chosen topics in the order of their receive times.

        Parameters
        ----------
        start_s : float
            Where to begin, from the start of the bag.
        duration_s : float or None
            How much to read; to the end by default.

        Yields
        ------
        BagMessage
            One message after the other; those that are damaged are passed over and counted.

        Raises
        ------
        BagError
            Where the file itself is damaged, and where a time is more than
            `MOST_OUT_OF_ORDER_NS` before another one that came earlier.

        """
        start_ns = self.start_ns + round(start_s * NS_PER_S)
        stop_ns = None if duration_s is None else start_ns + round(duration_s * NS_PER_S)
        waiting: list[tuple[int, int, BagMessage]] = []
        damage = None
        last_ns = start_ns
        try:
            for number, message in enumerate(self._recorded(start_ns, stop_ns)):
                self._check_order(message, last_ns)
                last_ns = max(last_ns, message.time_ns)
                heappush(waiting, (message.time_ns, number, message))
                while waiting[0][0] < last_ns - MOST_OUT_OF_ORDER_NS:
                    yield heappop(waiting)[-1]
        except BagError as error:
            damage = error
        while waiting:
            yield heappop(waiting)[-1]
        if damage is not None:
            raise damage

    def _recorded(self, start_ns: int, stop_ns: int | None) -> Iterator[BagMessage]:
        """Yield the messages in the order of the file."""
        recorded = self._reader.messages(self._connections, start=start_ns, stop=stop_ns)
        with _damage_reported(self._path):
            for connection, time_ns, data in recorded:
                message = self._converted(connection.topic, time_ns, data)
                if message is not None:
                    yield message

    def _check_order(self, message: BagMessage, last_ns: int) -> None:
        """Raise a BagError where a message is too far before the latest one of those so far."""
        if message.time_ns < last_ns - MOST_OUT_OF_ORDER_NS:
            raise BagError(
                f'{self._path}: a message of {message.topic} received at '
                f'{message.time_ns / NS_PER_S:.3f} s comes after one of {last_ns / NS_PER_S:.3f} s'
            )

    def _converted(self, topic: str, time_ns: Any, data: Any) -> BagMessage | None:
        """Return a message for the installed type, or None for a damaged one; count both."""
        try:
            # SQLite keeps any type of value in any column.
            message = BagMessage(topic, index(time_ns), self._converters[topic](data))
        except Exception:  # whatever the generated code of rosbags stumbles over
            self.unreadable[topic] += 1
            return None
        self.delivered[topic] += 1
        return message

    def close(self) -> None:
        """Close the files."""
        self._reader.close()


def recorded_types(path: Path) -> dict[str, tuple[str, ...]]:
    """
    Return the topics of a bag, with the type of their messages or the several types.

    Parameters
    ----------
    path : Path
        A bag folder, or a .db3 or .mcap file.

    Raises
    ------
    BagError
        If the path is no bag.

    """
    types: dict[str, set[str]] = defaultdict(set)
    with closing(_open(path)) as reader, _damage_reported(path):
        for connection in reader.connections:
            types[str(connection.topic)].add(str(connection.msgtype))
    return {topic: tuple(sorted(kinds)) for topic, kinds in types.items()}


@contextmanager
def _damage_reported(path: Path) -> Iterator[None]:
    """Make a BagError of whatever rosbags stumbles over in damaged bytes."""
    try:
        yield
    except BagError:
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise BagError(f'{path} is damaged: {reason}; {RESCUE}') from error


def _open(path: Path) -> Any:
    """Return an open reader."""
    if find_spec('rosbags') is None:
        raise BagError(f'bags are read with the package rosbags: {install_hint("rosbags")}')
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise BagError(f'{path}: there is no such bag')
    if path.suffix == '.bag':
        raise BagError(f'{path} is a ROS 1 bag; convert it with rosbags-convert')
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    except KeyError as error:
        # rosbags 0.11 knows no definition without an encoding, which a recorder writes that has
        # not got the package of a type.
        raise BagError(
            f'{path} cannot be read as a rosbag2: a topic has no definition of its messages '
            f"({error}); 'ros2 bag convert' writes a bag without that topic; {RESCUE}"
        ) from error
    except Exception as error:  # on damaged files whatever its parsers raise
        raise BagError(
            f'{path} cannot be read as a rosbag2: {str(error) or type(error).__name__}; '
            f'{_advice(path)}'
        ) from error
    return reader


def _advice(path: Path) -> str:
    """Return what to do about a path that cannot be read as a rosbag2."""
    files = list(path.iterdir()) if path.is_dir() else [path]
    if not any(ending in STORAGE_ENDINGS for file in files for ending in file.suffixes):
        return 'a bag is a folder with metadata.yaml, or a .db3 or .mcap file'
    return RESCUE


def find_message_class(type_name: str) -> type | None:
    """
    Import a message class by its type name.

    Parameters
    ----------
    type_name : str
        Such as 'sensor_msgs/msg/Range'.

    Returns
    -------
    type or None
        None when the package is not installed or has no such message.

    """
    if not TYPE_NAME.fullmatch(type_name):
        return None
    package, _, rest = type_name.partition('/')
    try:
        module = import_module(f'{package}.msg')
    except ImportError:
        return None
    message_class: type | None = getattr(module, rest.rpartition('/')[2], None)
    return message_class
