# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A rosbag2, open for reading: its topics and its damage.

A bag is read twice: first to learn what it holds and whether it is whole, then for the messages.
A file is read from its beginning to its end, by the package mcap or by SQLite. The index of an
.mcap is not used: a damaged one hides messages without an error. The checksums of an .mcap are
checked where the recorder wrote them. A .db3 has none.

Of metadata.yaml only the names of the files and the numbers of messages are used, so that a bag
with broken metadata is read as well.
"""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path, PurePath
import re
import shutil
import sqlite3
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from dg_localization.optional import install_hint
from dg_localization.ros.executables import ExecutableError, print_line
from msg_adapters.headers import NS_PER_S, message_class

# Stamps have 32 bits for the seconds.
END_OF_ROS_TIME_NS = 2**31 * NS_PER_S
# How many messages of a topic are tried to find the definition that they were written by.
SAMPLES = 20
# The recorder writes messages in the order of its callbacks, not of their receive times, also
# across the files of a split bag.
OUT_OF_ORDER_NS = NS_PER_S
# After a longer time without any message a bag has a gap.
SILENCE_NS = 60 * NS_PER_S
TYPE_NAME = re.compile(r'[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9]*')
STORAGE_FILE = re.compile(r'.*\.(mcap|db3)(\.zstd?)?')


class Channel(NamedTuple):
    """The record of a topic in a file; definition and profiles are empty if it has none."""

    topic: str
    type_name: str
    encoding: str
    definition: str
    offered_qos: str


class RawMessage(NamedTuple):
    """A message with its receive time in ns, or the begin of a channel if `data` is None."""

    channel: Channel
    time_ns: int = 0
    data: bytes | None = None


def read_file(path: Path, damage: list[str]) -> Iterator[RawMessage]:
    """Yield the records until damage hides the rest; add sentences on the damage."""
    try:
        yield from _read_mcap(path) if path.suffix == '.mcap' else _read_sqlite(path, damage)
    except Exception as error:  # the parsers may raise anything on damaged bytes
        reason = str(error) or type(error).__name__
        damage.append(f'{path.name}: {reason}; what follows is not read')


def _read_mcap(path: Path) -> Iterator[RawMessage]:
    from mcap.records import Channel as McapChannel, DataEnd, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Any] = {}
    known: dict[int, Channel] = {}
    with path.open('rb') as file:
        size = path.stat().st_size
        for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
            if isinstance(record, Message):
                yield RawMessage(known[record.channel_id], record.log_time, record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, McapChannel):
                known[record.id] = _channel_of(record, schemas.get(record.schema_id))
                yield RawMessage(known[record.id])
            elif isinstance(record, DataEnd):
                # The index follows.
                return


def _channel_of(channel: Any, schema: Any) -> Channel:
    encoding, definition, type_name = '', '', ''
    if schema is not None:
        type_name, encoding = schema.name, schema.encoding
        definition = schema.data.decode(errors='replace')
    if channel.message_encoding != 'cdr':
        type_name = f'{type_name} in {channel.message_encoding}'
    qos = channel.metadata.get('offered_qos_profiles', '')
    return Channel(channel.topic, type_name, encoding, definition, qos)


def _read_sqlite(path: Path, damage: list[str]) -> Iterator[RawMessage]:
    for ending in ('-wal', '-journal'):
        left = path.with_name(path.name + ending)
        if left.exists() and left.stat().st_size:
            damage.append(f"{left.name} is not read; 'sqlite3 {path.name} .tables' completes it")
    known: dict[int, Channel] = {}
    with closing(sqlite3.connect(f'{path.absolute().as_uri()}?immutable=1', uri=True)) as base:
        base.row_factory = sqlite3.Row
        definitions: dict[str, tuple[str, str]] = {}
        # Older distributions store no definitions and no profiles.
        if list(base.execute('PRAGMA table_info(message_definitions)')):
            for name, *definition in base.execute(
                'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            ):
                definitions[name] = definition[0], definition[1]
        for row in map(dict, base.execute('SELECT * FROM topics')):
            if not (isinstance(row['name'], str) and isinstance(row['type'], str)):
                damage.append(f'{path.name}: a row of the table topics names no topic or no type')
                continue
            other = '' if row['serialization_format'] == 'cdr' else ' in another format'
            qos = str(row.get('offered_qos_profiles') or '')
            described = definitions.get(row['type'], ('', ''))
            known[row['id']] = Channel(row['name'], row['type'] + other, *described, qos)
            yield RawMessage(known[row['id']])
        n_wrong = 0
        query = 'SELECT topic_id, timestamp, data FROM messages ORDER BY rowid'
        for topic_id, time_ns, data in base.execute(query):
            # SQLite keeps any type of value in any column.
            if isinstance(time_ns, int) and isinstance(data, bytes) and topic_id in known:
                yield RawMessage(known[topic_id], time_ns, data)
            else:
                n_wrong += 1
    if n_wrong:
        damage.append(
            f'{path.name}: {n_wrong} rows of the table messages are no messages of a topic'
        )


def _unpacked_name(name: str) -> str:
    """Return the name of a file of messages without the ending of its compression."""
    return re.sub(r'\.zstd?$', '', name)


class BagError(ExecutableError):
    """The bag cannot be used; the text says why and what to do."""


@dataclass
class Topic:
    """A topic of a bag: its records in the files, and its first messages."""

    name: str
    channels: list[Channel] = field(default_factory=list)
    count: int = 0
    samples: list[bytes] = field(default_factory=list)

    @property
    def type_names(self) -> tuple[str, ...]:
        """The types of its messages, such as 'sensor_msgs/msg/Range'."""
        # Some converters leave out the folder: pkg/Name.
        names = {channel.type_name for channel in self.channels}
        full = {name.replace('/', '/msg/') if name.count('/') == 1 else name for name in names}
        return tuple(sorted(full))

    @property
    def offered_qos(self) -> tuple[Any, ...]:
        """The QoS profiles that its publishers offered, each once."""
        from rosbags.rosbag2.metadata import parse_qos

        profiles: list[Any] = []
        for text in dict.fromkeys(channel.offered_qos for channel in self.channels):
            try:
                profiles += parse_qos(text)
            except Exception:  # its parser may raise anything
                continue
        return tuple(profiles)

    @property
    def latched(self) -> bool:
        """Whether late subscribers get the last messages."""
        return any(qos.durability.name == 'TRANSIENT_LOCAL' for qos in self.offered_qos)

    @property
    def message_class(self) -> type | None:
        """The installed class of its messages, if there is one."""
        name = self.type_names[0]
        try:
            return message_class(name) if TYPE_NAME.fullmatch(name) else None
        except (ImportError, AttributeError):
            return None


class Bag:
    """
    A rosbag2: a bag folder, or a .db3 or .mcap file, compressed or not.

    Compressed files are unpacked into a folder that the caller removes.

    Attributes
    ----------
    topics : dict of str to Topic
        By name.
    start_ns, end_ns : int
        Receive times of the first and the last message.
    reorder_ns : int
        Greatest time by which a message may be earlier than one before it.
    notices, damage : list of str
        Remarks on the bag, and its damage, one sentence each.

    Raises
    ------
    BagError
        If the path is no bag, or no message can be read.

    """

    def __init__(self, path: Path, folder: Path) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.start_ns, self.end_ns = END_OF_ROS_TIME_NS, 0
        self.reorder_ns = OUT_OF_ORDER_NS
        self.notices: list[str] = []
        self.damage: list[str] = []
        self._counts: dict[str, int] = {}
        try:
            self._paths = [self._unpacked(one, folder) for one in self._files()]
            self._scan()
        except OSError as error:
            raise BagError(f'{path} cannot be read: {error.strerror or error}') from error

    def _files(self) -> list[Path]:
        """Return the files that metadata.yaml names, or all files of messages without it."""
        path = self.path
        for package in ('rosbags', 'mcap'):
            if find_spec(package) is None:
                raise BagError(f'bags need the package {package}: {install_hint(package)}')
        if not path.exists():
            raise BagError(f'{path}: there is no such bag')
        if path.suffix == '.bag':
            raise BagError(f'{path} is a ROS 1 bag; convert it with rosbags-convert')
        files: dict[str, Path] = {}
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            if file.is_file() and STORAGE_FILE.fullmatch(file.name):
                first = files.setdefault(_unpacked_name(file.name), file)
                if first is not file:
                    self.notices.append(f'{file.name} is passed over, as a copy of {first.name}')
        if not files:
            raise BagError(
                f'{path} is no rosbag2: it must be a .db3 or .mcap file, or a folder of such '
                'files, which may be compressed as .zst or .zstd; unpack other archives first'
            )
        said = self._metadata() if path.is_dir() else None
        if said is None:
            return [*files.values()]
        names, self._counts = said
        if missing := sorted(names - files.keys()):
            self.damage.append(f'files are missing: {", ".join(missing)}')
        named = [file for name, file in files.items() if name in names]
        if others := [file.name for name, file in files.items() if name not in names]:
            read = 'passed over' if named else 'read all the same'
            self.notices.append(f'metadata.yaml does not name {", ".join(others)}: {read}')
        return named or [*files.values()]

    def _metadata(self) -> tuple[set[str], dict[str, int]] | None:
        """Return the files and the numbers of messages by topic in metadata.yaml, if usable."""
        from ruamel.yaml import YAML

        try:
            text = (self.path / 'metadata.yaml').read_text(encoding='utf-8')
            found = YAML(typ='safe').load(text)['rosbag2_bagfile_information']
            paths = [PurePath(str(name)) for name in found['relative_file_paths']]
            names = {_unpacked_name(path.name) for path in paths}
            topics = found['topics_with_message_count']
            counts = {str(t['topic_metadata']['name']): int(t['message_count']) for t in topics}
        except Exception as error:  # the parser may raise anything on broken metadata
            reason = ' '.join(str(error).split()) or type(error).__name__
            text = f'metadata.yaml cannot be used ({reason}): all files of the folder are read'
            self.notices.append(text)
            return None
        return names, counts

    def _unpacked(self, path: Path, folder: Path) -> Path:
        """Return a file, unpacked first where it is compressed as a whole."""
        if not path.suffix.startswith('.zst'):
            return path
        import zstandard

        unpacked = folder / path.stem
        try:
            with path.open('rb') as source, unpacked.open('wb') as target:
                with zstandard.ZstdDecompressor().stream_reader(source) as stream:
                    shutil.copyfileobj(stream, target)
        except zstandard.ZstdError as error:
            self.damage.append(f'{path.name}: {error}')
        return unpacked

    def _scan(self) -> None:
        """List the contents of the files, and sort them by their first receive times."""
        firsts_ns = {path: self._scan_file(path) for path in self._paths}
        self._paths.sort(key=lambda path: (firsts_ns[path], path))
        if not any(topic.count for topic in self.topics.values()):
            why = '; '.join(self.damage) or 'it has no messages'
            advice = "'ros2 bag reindex' or 'mcap recover' may save what is left"
            raise BagError(f'{self.path}: nothing in the bag can be read: {why}; {advice}')
        for name in sorted({*self._counts, *self.topics} if self._counts else ()):
            held = self.topics[name].count if name in self.topics else 0
            if held != (said := self._counts.get(name, 0)):
                self.damage.append(
                    f'{name}: the files hold {held} messages, metadata.yaml counts {said}'
                )

    def _scan_file(self, path: Path) -> int:
        """
        List the contents of one file, and return its first receive time.

        Topics may be written one after the other; within one topic, times do not go back.
        """
        first_ns, n_wrong = END_OF_ROS_TIME_NS, 0
        latest_of: dict[str, int] = {}
        steps_back: list[tuple[int, int]] = []
        for channel, time_ns, data in read_file(path, self.damage):
            topic = self.topics.setdefault(channel.topic, Topic(channel.topic))
            if data is None:
                # Files and chunks repeat their channels.
                topic.channels = list(dict.fromkeys([*topic.channels, channel]))
                continue
            if not 0 <= time_ns < END_OF_ROS_TIME_NS:
                n_wrong += 1
                continue
            topic.count += 1
            if len(topic.samples) < SAMPLES:
                topic.samples.append(data)
            first_ns = min(first_ns, time_ns)
            self.reorder_ns = max(self.reorder_ns, self.end_ns - time_ns)
            self.start_ns, self.end_ns = min(self.start_ns, time_ns), max(self.end_ns, time_ns)
            before_ns = latest_of.setdefault(channel.topic, time_ns)
            if before_ns - time_ns > OUT_OF_ORDER_NS:
                steps_back.append((before_ns - time_ns, before_ns))
            latest_of[channel.topic] = max(before_ns, time_ns)
        if n_wrong:
            self.damage.append(
                f'{path.name}: receive times of {n_wrong} messages are not within the time of ROS'
            )
        if steps_back:
            back_ns, at_ns = max(steps_back)
            self.damage.append(
                f'{path.name}: receive times go back by up to {back_ns / NS_PER_S:.1f} s, '
                f'after {at_ns / NS_PER_S:.3f} s; {len(steps_back)} messages are out of order'
            )
        return first_ns

    def records(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield topics, receive times and bytes of the messages in the order of the files."""
        for path in self._paths:
            for channel, time_ns, data in read_file(path, []):
                if data is not None and 0 <= time_ns < END_OF_ROS_TIME_NS:
                    yield channel.topic, time_ns, data

    @property
    def duration_s(self) -> float:
        """Time from the first message of the bag to just after the last."""
        return (self.end_ns + 1 - self.start_ns) / NS_PER_S

    @property
    def types(self) -> dict[str, tuple[str, ...]]:
        """The types of messages by topic."""
        return {name: topic.type_names for name, topic in self.topics.items()}


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag for a block; add the damage of the bag to an error of the block."""
    print_line(f'reading {path}')
    with TemporaryDirectory() as folder:
        bag = Bag(path, Path(folder))
        try:
            yield bag
        except BagError as error:
            raise BagError('\n'.join([str(error), *bag.damage])) from error


def in_seconds(time_ns: int) -> float:
    """Return a time of a bag as the clock of the node gives it."""
    return time_ns * 1e-9
