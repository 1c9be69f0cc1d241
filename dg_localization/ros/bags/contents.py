# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What the files of a bag hold, read from end to end and apart from what its indexes say.

An index that is damaged hides messages without a word, and rosbags follows the index. What is
found here is compared with what rosbags delivers, so that nothing is lost silently.

An .mcap has checksums where the recorder wrote them (`ros2 bag record` does unless told not to);
the package mcap checks them. SQLite has none: in a .db3 the structure is checked, the bytes of a
message cannot be.
"""

from array import array
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
import sqlite3
import struct
from typing import Any, TypeAlias
import zlib

import numpy as np
from numpy.typing import NDArray

from dg_localization.optional import install_hint
from dg_localization.ros.bags.reader import NS_PER_S, Bag, BagError
from dg_localization.ros.executables import ExecutableError
from dg_localization.ros.terminal import told_while_waiting

# After the field of its checksum a file has its magic; the checksum has 4 bytes.
MCAP_MAGIC_BYTES = 8
MCAP_CHECKSUM_BYTES = 4
# A record begins with its opcode and its length; a message with channel, sequence and two times.
MCAP_RECORD = struct.Struct('<BQ')
MCAP_MESSAGE = struct.Struct('<HIQ')
MCAP_MESSAGE_BYTES = 22
LAST_NS = 2**63 - 1
# Rows that rosbags and the readers of rosbag2 take for something else, or pass over.
SQLITE_CHECKS = (
    ('topics', "typeof(id) != 'integer' OR typeof(name) != 'text' OR typeof(type) != 'text'"),
    ('messages', "typeof(timestamp) != 'integer'"),
    ('messages', "typeof(data) != 'blob'"),
    ('messages', 'topic_id IS NULL OR topic_id NOT IN (SELECT id FROM topics)'),
)

# Of int64: a fifth of the memory of a list.
Times: TypeAlias = 'array[int]'


def _no_times() -> Times:
    return array('q')


@dataclass
class Contents:
    """
    What the files of a bag hold.

    Attributes
    ----------
    times_ns : dict of str to numpy.ndarray of int64
        By topic, the receive times of its messages, in order.
    damage : list of str
        What is wrong, a sentence each.
    checksums : bool
        Whether every message is protected by one, so that a flipped bit is noticed.
    known : bool
        Whether the files could be looked into; those compressed as a whole are not.

    """

    times_ns: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    checksums: bool = True
    known: bool = True

    def span_ns(self) -> tuple[int, int] | None:
        """Return the first and the last receive time; None without a message."""
        ends = [(int(t[0]), int(t[-1])) for t in self.times_ns.values() if t.size]
        return (min(e[0] for e in ends), max(e[1] for e in ends)) if ends else None

    def count(self, topic: str, start_ns: int, stop_ns: int) -> int:
        """Return how many messages a topic holds from `start_ns` until before `stop_ns`."""
        times_ns = self.times_ns.get(topic)
        if times_ns is None:
            return 0
        return int(np.diff(np.searchsorted(times_ns, (start_ns, stop_ns)))[0])

    def add(self, times_ns: Mapping[str, Times]) -> None:
        """Add the messages of one file, by topic."""
        for topic, times in times_ns.items():
            before = self.times_ns.get(topic, np.empty(0, np.int64))
            self.times_ns[topic] = np.sort(np.append(before, np.frombuffer(times, np.int64)))


def read_contents(path: Path) -> Contents:
    """
    Read a bag from end to end.

    Parameters
    ----------
    path : Path
        A bag folder, or a .db3 or .mcap file.

    Returns
    -------
    Contents
        Empty where there is no such path: whoever opens the bag says so.

    Raises
    ------
    BagError
        If the package mcap is needed and not installed.

    """
    contents = Contents()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if not file.is_file():
            continue
        if file.suffix == '.zstd':
            return Contents(checksums=False, known=False)
        if file.suffix == '.mcap':
            _read_mcap(file, contents)
        elif file.suffix == '.db3':
            _read_sqlite(file, contents)
    return contents


@contextmanager
def contents_of(path: Path) -> Iterator[Contents]:
    """
    Read a bag from end to end, for a block that works with it.

    Parameters
    ----------
    path : Path
        A bag folder, or a .db3 or .mcap file.

    Yields
    ------
    Contents

    Raises
    ------
    ExecutableError
        If the block cannot read or write: of a damaged bag with all that is wrong with it.

    """
    contents = Contents()
    try:
        with told_while_waiting(f'checking {path}'):
            contents = read_contents(path)
        yield contents
    except BagError as error:
        raise BagError('\n'.join([str(error), *contents.damage])) from error
    except (OSError, sqlite3.Error) as error:
        raise ExecutableError(str(error)) from error


def damage_of(bag: Bag, contents: Contents, read_ns: tuple[int, int] | None) -> Iterator[str]:
    """
    Yield what is wrong with a bag, a sentence each.

    Parameters
    ----------
    bag : Bag
        After it was read.
    contents : Contents
    read_ns : tuple of int or None
        The first and the last time that was read; None where the reading ended before.

    """
    yield from contents.damage
    yield from bag.damaged
    if contents.known:
        yield from _wrong_index(bag, contents)
    if read_ns is None:
        return
    for topic in bag.topics:
        wanted = contents.count(topic.name, read_ns[0], read_ns[1] + 1)
        delivered, unreadable = bag.delivered[topic.name], bag.unreadable[topic.name]
        # More than there are when the index leads to some of them twice.
        if contents.known and delivered + unreadable != wanted:
            yield f'{topic.name}: {wanted} messages are in the files, {delivered} were read'
        elif unreadable and not delivered:
            yield f'{topic.name}: none of its messages could be read'


def _wrong_index(bag: Bag, contents: Contents) -> Iterator[str]:
    """Yield where the index of a bag says something else than its files."""
    counts = bag.index_counts
    for topic in sorted({*counts, *contents.times_ns}):
        held = contents.times_ns.get(topic, np.empty(0)).size
        said = counts.get(topic)
        if said is None:
            yield f'{topic}: {held} messages are in the files, and the index does not name it'
        elif said != held:
            yield f'{topic}: {held} messages are in the files, the index says {said}'
    if bag.index_span_ns != (contents.span_ns() or bag.index_span_ns):
        first_s, last_s = (time_ns / NS_PER_S for time_ns in bag.index_span_ns)
        yield f'the index says messages from {first_s:.3f} to {last_s:.3f} s, which is wrong'


def _read_sqlite(path: Path, contents: Contents) -> None:
    contents.checksums = False
    for ending in ('-wal', '-journal'):
        left = path.with_name(path.name + ending)
        if left.exists() and left.stat().st_size:
            contents.damage.append(
                f'{left.name}: the recorder did not come to its end, and what this file holds is '
                f"not read; 'sqlite3 {path.name} .tables' completes the bag"
            )
    try:
        with closing(sqlite3.connect(f'{path.absolute().as_uri()}?immutable=1', uri=True)) as base:
            contents.damage += [f'{path.name}: {text}' for text in _wrong_rows(base)]
            contents.add(_sqlite_times(base))
    except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        contents.damage.append(f'{path.name}: {error}')


def _wrong_rows(base: sqlite3.Connection) -> Iterator[str]:
    """Yield a sentence for each kind of damage in a database."""
    for (text,) in base.execute('PRAGMA integrity_check(3)'):
        if text != 'ok':
            yield text
    for table, wrong in SQLITE_CHECKS:
        query = f'SELECT count(*), min(rowid) FROM {table} WHERE {wrong}'
        count, first = base.execute(query).fetchone()
        if count:
            yield f'{count} rows of the table {table}, the first is {first}, have {wrong}'


def _sqlite_times(base: sqlite3.Connection) -> dict[str, Times]:
    times_ns: dict[str, Times] = defaultdict(_no_times)
    rows = base.execute(
        'SELECT name, timestamp FROM messages JOIN topics ON topic_id = topics.id '
        "WHERE typeof(name) = 'text' AND typeof(timestamp) = 'integer'"
    )
    for topic, time_ns in rows:
        times_ns[topic].append(time_ns)
    return times_ns


def _read_mcap(path: Path, contents: Contents) -> None:
    if find_spec('mcap') is None:
        raise BagError(f'.mcap files are checked with the package mcap: {install_hint("mcap")}')
    found = _McapScan(path)
    found.run()
    contents.damage += [f'{path.name}: {text}' for text in found.damage]
    contents.checksums &= found.checksums
    contents.add(found.times_ns())


class _McapScan:
    """One pass over an .mcap file."""

    def __init__(self, path: Path) -> None:
        self.damage: list[str] = []
        self.checksums = True
        self._path = path
        self._channels: dict[int, Any] = {}
        self._schemas: dict[int, Any] = {}
        self._times_ns: dict[int, Times] = defaultdict(_no_times)
        self._all_in_chunks = True

    def run(self) -> None:
        """Read the file; damage is collected."""
        from mcap.records import Message
        from mcap.stream_reader import StreamReader

        size = self._path.stat().st_size
        with self._path.open('rb') as file:
            try:
                reader = StreamReader(
                    file, emit_chunks=True, validate_crcs=True, record_size_limit=size
                )
                for record in reader.records:
                    self._all_in_chunks &= not isinstance(record, Message)
                    self._take(record, file.tell())
                if file.read(1):
                    self.damage.append('something follows after its end')
            except Exception as error:  # on damaged bytes whatever the parser stumbles over
                self.damage.append(f'before byte {file.tell()}: {_text(error)}')

    def times_ns(self) -> dict[str, Times]:
        """Return the receive times by topic."""
        times_ns: dict[str, Times] = defaultdict(_no_times)
        for channel, times in self._times_ns.items():
            if channel in self._channels:
                times_ns[self._channels[channel].topic] += times
            else:
                self.damage.append(f'{len(times)} messages are of no channel')
        return times_ns

    def _take(self, record: Any, end: int) -> None:
        from mcap import records

        match record:
            case records.Message():
                # The field has 64 bits without a sign; a time that needs the last one is damage.
                self._times_ns[record.channel_id].append(min(record.log_time, LAST_NS))
            case records.Chunk():
                self._take_chunk(record, end)
            case records.Channel():
                self._describe(self._channels, record, 'channel')
            case records.Schema():
                self._describe(self._schemas, record, 'schema')
            case records.DataEnd():
                self.checksums &= self._all_in_chunks or bool(record.data_section_crc)
            case records.Statistics():
                self._compare(record)
            case records.Footer():
                self._check_summary(record)

    def _take_chunk(self, chunk: Any, end: int) -> None:
        from mcap.stream_reader import get_chunk_data_stream

        self.checksums &= bool(chunk.uncompressed_crc)
        try:
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
            inside, times_ns = _inside_chunk(stream.read(size))
        except Exception as error:  # as above
            self.damage.append(f'the chunk before byte {end}: {_text(error)}')
            return
        for record in inside:
            self._take(record, end)
        for channel, time_ns in times_ns:
            self._times_ns[channel].append(min(time_ns, LAST_NS))

    def _describe(self, known: dict[int, Any], record: Any, kind: str) -> None:
        if known.setdefault(record.id, record) != record:
            self.damage.append(f'the {kind} {record.id} is described in two ways')
            known[record.id] = record

    def _compare(self, statistics: Any) -> None:
        counts = {channel: len(times) for channel, times in self._times_ns.items()}
        # Writers may leave out the counts by channel; nothing is said by them then.
        said = statistics.channel_message_counts or counts
        said = {channel: n for channel, n in said.items() if n}
        if counts != said or sum(counts.values()) != statistics.message_count:
            self.damage.append(
                f'its statistics say {statistics.message_count} messages, '
                f'{sum(counts.values())} are readable'
            )

    def _check_summary(self, footer: Any) -> None:
        if not footer.summary_start or not footer.summary_crc:
            return
        with self._path.open('rb') as file:
            file.seek(footer.summary_start)
            actual = zlib.crc32(file.read()[: -MCAP_MAGIC_BYTES - MCAP_CHECKSUM_BYTES])
        if actual != footer.summary_crc:
            self.damage.append('the checksum of its summary, which has the index, is wrong')


def _inside_chunk(data: bytes) -> tuple[list[Any], list[tuple[int, int]]]:
    """
    Return the channels and schemas of a chunk, and the channel and receive time of each message.

    The package mcap makes an object of each message, which takes ten times as long.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Schema

    described: list[Any] = []
    times_ns: list[tuple[int, int]] = []
    start = 0
    while start < len(data):
        opcode, size = MCAP_RECORD.unpack_from(data, start)
        start += MCAP_RECORD.size
        if size > len(data) - start:
            raise ValueError(f'a record of {size} bytes, of which {len(data) - start} are left')
        if opcode == Opcode.MESSAGE:
            if size < MCAP_MESSAGE_BYTES:
                raise ValueError(f'a message of {size} bytes is shorter than its own times')
            channel, _, time_ns = MCAP_MESSAGE.unpack_from(data, start)
            times_ns.append((channel, time_ns))
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            kind = Channel if opcode == Opcode.CHANNEL else Schema
            described.append(kind.read(ReadDataStream(BytesIO(data[start : start + size]))))
        start += size
    return described, times_ns


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__
