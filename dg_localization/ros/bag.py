"""
Recorded messages, ready to be published: rosbag2 in .db3 and .mcap, by the package rosbags.

Bytes of a type that has got other fields since the recording are brought up to date:
sensor_msgs/Range has a variance since Iron, and no subscriber of today reads the bytes of before.
"""

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

NS_PER_S = 1_000_000_000
# Where a bag does not hold the definitions of its types, those of a distribution that fit.
DISTRIBUTIONS = ('JAZZY', 'IRON', 'HUMBLE', 'GALACTIC', 'FOXY', 'ELOQUENT', 'DASHING')


class BagError(Exception):
    """The bag cannot be replayed; the text says why and what to do."""


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

    """

    name: str
    message_class: type
    latched: bool


class Bag:
    """
    A rosbag2, open for reading.

    Parameters
    ----------
    path : Path
        A bag folder, or a .db3 or .mcap file.
    topics : sequence of str, optional
        Only these topics; all by default.

    Attributes
    ----------
    topics : list of Topic
        The topics that can be replayed.
    notices : list of str
        One sentence for each topic that is passed over.

    Raises
    ------
    BagError
        If the path is no bag, a wanted topic is not in it, or nothing in it can be replayed.

    """

    def __init__(self, path: Path, topics: Sequence[str] | None = None) -> None:
        self.topics: list[Topic] = []
        self.notices: list[str] = []
        self._connections: list[Any] = []
        self._converters: dict[str, Callable[[bytes], bytes]] = {}
        self._reader = _open(path)
        try:
            self._choose(topics)
        except BagError:
            self.close()
            raise

    def _choose(self, wanted: Sequence[str] | None) -> None:
        """Sort the topics of the bag into those to replay and those to pass over."""
        recorded = self._reader.topics
        missing = sorted(set(wanted or ()) - set(recorded))
        if missing:
            raise BagError(
                f'no topic {", ".join(missing)} in the bag; it has {", ".join(sorted(recorded))}'
            )
        for name in sorted(wanted or recorded):
            reason = self._take(name, recorded[name])
            if reason:
                self.notices.append(f'{name} is passed over: {reason}')
        if not self.topics:
            raise BagError('nothing in the bag can be replayed: ' + '; '.join(self.notices))

    def _take(self, name: str, info: Any) -> str:
        """Take a topic among those to replay, or return why not."""
        if not info.msgcount:
            return 'it holds no message'
        if info.msgtype is None:
            return 'it holds messages of several types'
        message_class = find_message_class(info.msgtype)
        if message_class is None:
            return f'its type {info.msgtype} is not installed'
        converter = self._converter(info)
        if converter is None:
            return f'its messages do not fit any definition of {info.msgtype}'
        self._converters[name] = converter
        self._connections += info.connections
        self.topics.append(Topic(name, message_class, _is_latched(info.connections)))
        return ''

    def _converter(self, info: Any) -> Callable[[bytes], bytes] | None:
        """Return what makes recorded bytes those of the installed type, or None."""
        from rosbags.convert.converter import generate_message_converter
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore

        installed = get_typestore(Stores.ROS2_JAZZY)
        if info.msgtype not in installed.types:
            return bytes
        if info.msgdef.format != MessageDefinitionFormat.NONE:
            candidates = [self._reader.typestore]
        else:
            candidates = [get_typestore(Stores[f'ROS2_{name}']) for name in DISTRIBUTIONS]
        sample = next(self._reader.messages(info.connections))[2]
        for recorded in candidates:
            try:
                recorded.deserialize_cdr(sample, info.msgtype)
            except (SerdeError, KeyError):
                continue
            convert = generate_message_converter(
                recorded, installed, info.msgtype, info.msgtype, {}, src_is2=True, dst_is2=True
            )
            return lambda data: bytes(convert(data))
        return None

    @property
    def start_ns(self) -> int:
        """Receive time of the first message of the bag."""
        return int(self._reader.start_time)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message of the bag."""
        return float(self._reader.duration) / NS_PER_S

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
            One message after the other.

        """
        start_ns = self.start_ns + round(start_s * NS_PER_S)
        stop_ns = None if duration_s is None else start_ns + round(duration_s * NS_PER_S)
        recorded = self._reader.messages(self._connections, start=start_ns, stop=stop_ns)
        for connection, time_ns, data in recorded:
            yield BagMessage(connection.topic, time_ns, self._converters[connection.topic](data))

    def close(self) -> None:
        """Close the files."""
        self._reader.close()


def _open(path: Path) -> Any:
    """Return an open reader."""
    if find_spec('rosbags') is None:
        raise BagError('bags are read with the package rosbags: pip install rosbags')
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise BagError(f'{path}: there is no such bag')
    if path.suffix == '.bag':
        raise BagError(f'{path} is a ROS 1 bag; convert it with rosbags-convert')
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    except (AnyReaderError, OSError) as error:
        raise BagError(f'{path} cannot be read as a rosbag2: {error}') from error
    return reader


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
    package, _, rest = type_name.partition('/')
    try:
        module = import_module(f'{package}.msg')
    except ImportError:
        return None
    message_class: type | None = getattr(module, rest.rpartition('/')[2], None)
    return message_class


def _is_latched(connections: Sequence[Any]) -> bool:
    """Tell whether a recorded publisher kept its last messages for late subscribers."""
    return any(
        profile.durability.name == 'TRANSIENT_LOCAL'
        for connection in connections
        for profile in connection.ext.offered_qos_profiles
    )
