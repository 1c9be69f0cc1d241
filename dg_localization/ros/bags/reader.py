"""
Recorded messages, by the package rosbags: rosbag2 in .db3 and .mcap.

Bytes of a type that has got other fields since the recording are brought up to date:
sensor_msgs/Range has a variance since Iron, and no subscriber of today reads the bytes of before.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, redirect_stdout
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from dg_localization.optional import install_hint
from dg_localization.ros.executables import ExecutableError

NS_PER_S = 1_000_000_000
# Where a bag does not hold the definitions of its types, those of a distribution that fit.
DISTRIBUTIONS = ('JAZZY', 'IRON', 'HUMBLE', 'GALACTIC', 'FOXY', 'ELOQUENT', 'DASHING')


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

    Attributes
    ----------
    topics : list of Topic
        The topics that can be read.
    notices : list of str
        One sentence for each topic that is passed over.
    unreadable : Counter of str
        By topic, the damaged messages that were passed over so far.

    Raises
    ------
    BagError
        If the path is no bag, a wanted topic is not in it, or nothing in it can be read.

    """

    def __init__(self, path: Path, topics: Sequence[str] | None = None) -> None:
        self.topics: list[Topic] = []
        self.notices: list[str] = []
        self.unreadable: Counter[str] = Counter()
        self._connections: list[Any] = []
        self._converters: dict[str, Callable[[bytes], bytes]] = {}
        self._path = path
        self._reader = _open(path)
        try:
            with _damage_reported(path):
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
        for name in sorted(wanted or recorded):
            reason = self._take(name, recorded[name])
            if reason:
                self.notices.append(f'{name} is passed over: {reason}')
        if not self.topics:
            raise BagError('nothing in the bag can be read: ' + '; '.join(self.notices))

    def _take(self, name: str, info: Any) -> str:
        """Take a topic among those to read, or return why not."""
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
        offered = tuple(qos for c in info.connections for qos in c.ext.offered_qos_profiles)
        latched = any(qos.durability.name == 'TRANSIENT_LOCAL' for qos in offered)
        self.topics.append(Topic(name, message_class, latched, info.msgtype, offered))
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
            with redirect_stdout(StringIO()):  # it prints the name of every type it converts
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
    def end_ns(self) -> int:
        """Receive time of the last message of the bag."""
        return int(self._reader.end_time) - 1

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
            One message after the other; those that are damaged are passed over and counted.

        Raises
        ------
        BagError
            Where the file itself is damaged.

        """
        start_ns = self.start_ns + round(start_s * NS_PER_S)
        stop_ns = None if duration_s is None else start_ns + round(duration_s * NS_PER_S)
        recorded = self._reader.messages(self._connections, start=start_ns, stop=stop_ns)
        with _damage_reported(self._path):
            for connection, time_ns, data in recorded:
                message = self._converted(connection.topic, time_ns, data)
                if message is not None:
                    yield message

    def _converted(self, topic: str, time_ns: int, data: bytes) -> BagMessage | None:
        """Return a message for the installed type, or None, counted, for a damaged one."""
        try:
            return BagMessage(topic, time_ns, self._converters[topic](data))
        except Exception:  # whatever the generated code of rosbags stumbles over
            self.unreadable[topic] += 1
            return None

    def close(self) -> None:
        """Close the files."""
        self._reader.close()


def recorded_types(path: Path) -> dict[str, str]:
    """
    Return the topics of a bag with their types, without those that hold several types.

    Parameters
    ----------
    path : Path
        A bag folder, or a .db3 or .mcap file.

    Raises
    ------
    BagError
        If the path is no bag.

    """
    with closing(_open(path)) as reader:
        return {name: info.msgtype for name, info in reader.topics.items() if info.msgtype}


@contextmanager
def _damage_reported(path: Path) -> Iterator[None]:
    """Make a BagError of whatever rosbags stumbles over in damaged bytes."""
    try:
        yield
    except BagError:
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise BagError(
            f'{path} is damaged: {reason}; '
            "'ros2 bag reindex' or 'mcap recover' may save what is left"
        ) from error


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
    except Exception as error:  # on damaged files whatever its parsers raise
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
