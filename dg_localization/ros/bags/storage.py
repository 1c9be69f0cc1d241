# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The messages in the files of a rosbag2, in the order in which they were written.

A file is read from its beginning to its end, by the package mcap or by SQLite. The index of an
.mcap is not used: one that is damaged hides messages without a word. An .mcap has checksums where
the recorder wrote them, and they are checked. SQLite has none: the structure of a .db3 is checked,
the bytes of a message cannot be.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
import sqlite3
from typing import Any, TypeAlias
import zlib

# After the field of its checksum an .mcap has its magic; the checksum has 4 bytes.
MCAP_MAGIC_BYTES = 8
MCAP_CHECKSUM_BYTES = 4


@dataclass(frozen=True)
class Channel:
    """
    What a file says of a topic.

    Attributes
    ----------
    topic, type_name : str
    encoding, definition : str
        The definition of its type, and in which language; empty where the file has none.
    offered_qos : str
        The profiles that its publishers offered, in YAML.

    """

    topic: str
    type_name: str
    encoding: str = ''
    definition: str = ''
    offered_qos: str = ''


Record: TypeAlias = tuple[Channel, int, bytes]
"""A message: its channel, its receive time in ns, and its bytes."""


class StorageFile:
    """
    One file of a bag.

    Attributes
    ----------
    channels : list of Channel
        Those that were met so far, with messages or without.
    damage : list of str
        What was found wrong, a sentence each.
    checksums : bool
        Whether every message is protected by one, so that a flipped bit is noticed.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: list[Channel] = []
        self.damage: list[str] = []
        self.checksums = True

    def records(self) -> Iterator[Record]:
        """Yield the messages, up to the first damage that hides where the next one begins."""
        try:
            yield from self._records()
        except Exception as error:  # on damaged bytes whatever the parsers stumble over
            text = str(error) or type(error).__name__
            self.add_damage(f'{text}; what follows is not read')

    def check(self) -> None:
        """Look for damage that reading the messages does not show."""

    def add_damage(self, text: str) -> None:
        """Add a sentence on what is wrong."""
        self.damage.append(f'{self.path.name}: {text}')

    def _records(self) -> Iterator[Record]:
        raise NotImplementedError


class McapFile(StorageFile):
    """A file of the format MCAP."""

    def _records(self) -> Iterator[Record]:
        from mcap.records import (
            Channel as McapChannel,
            Chunk,
            DataEnd,
            Footer,
            Message,
            Schema,
            Statistics,
        )
        from mcap.stream_reader import StreamReader, breakup_chunk

        size = self.path.stat().st_size
        schemas: dict[int, Any] = {}
        known: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        ended, all_in_chunks = False, True
        with self.path.open('rb') as file:
            reader = StreamReader(
                file, emit_chunks=True, validate_crcs=True, record_size_limit=size
            )
            for record in reader.records:
                if isinstance(record, Chunk):
                    self.checksums &= bool(record.uncompressed_crc)
                    inside = breakup_chunk(record, validate_crc=True)
                else:
                    all_in_chunks &= not isinstance(record, Message)
                    inside = [record]
                for one in inside:
                    # What follows the data repeats it for the index.
                    if isinstance(one, Message):
                        counts[one.channel_id] += 1
                        yield known[one.channel_id], one.log_time, one.data
                    elif isinstance(one, Schema) and not ended:
                        schemas[one.id] = one
                    elif isinstance(one, McapChannel) and not ended:
                        known[one.id] = _channel_of(one, schemas.get(one.schema_id))
                        self.channels.append(known[one.id])
                if isinstance(record, DataEnd):
                    ended = True
                    self.checksums &= all_in_chunks or bool(record.data_section_crc)
                elif isinstance(record, Statistics):
                    self._compare(record, counts)
                elif isinstance(record, Footer):
                    self._check_summary(record)
            if file.read(1):
                self.add_damage('something follows after its end')

    def _compare(self, statistics: Any, counts: Counter[int]) -> None:
        """Compare the numbers of messages with those that the file states."""
        # Writers may leave out the counts by channel.
        said = +Counter(statistics.channel_message_counts) or counts
        if counts != said or counts.total() != statistics.message_count:
            self.add_damage(
                f'its statistics say {statistics.message_count} messages, '
                f'{counts.total()} are readable'
            )

    def _check_summary(self, footer: Any) -> None:
        if not footer.summary_start or not footer.summary_crc:
            return
        with self.path.open('rb') as file:
            file.seek(footer.summary_start)
            actual = zlib.crc32(file.read()[: -MCAP_MAGIC_BYTES - MCAP_CHECKSUM_BYTES])
        if actual != footer.summary_crc:
            self.add_damage('the checksum of its summary, which has the index, is wrong')


def _channel_of(channel: Any, schema: Any) -> Channel:
    encoding, definition, type_name = '', '', ''
    if schema is not None:
        type_name, encoding = schema.name, schema.encoding
        definition = schema.data.decode(errors='replace')
    if channel.message_encoding != 'cdr':
        type_name = f'{type_name} in {channel.message_encoding}'
    qos = channel.metadata.get('offered_qos_profiles', '')
    return Channel(channel.topic, type_name, encoding, definition, qos)


class SqliteFile(StorageFile):
    """A database of SQLite, with the tables of any version of rosbag2."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.checksums = False

    def check(self) -> None:
        """Look for what a recorder left, and for a wrong structure."""
        for ending in ('-wal', '-journal'):
            left = self.path.with_name(self.path.name + ending)
            if left.exists() and left.stat().st_size:
                self.damage.append(
                    f'{left.name}: the recorder did not come to its end, and what this file holds '
                    f"is not read; 'sqlite3 {self.path.name} .tables' completes the bag"
                )
        try:
            with closing(self._connect()) as base:
                for (text,) in base.execute('PRAGMA integrity_check(3)'):
                    if text != 'ok':
                        self.add_damage(text)
        except sqlite3.Error as error:
            self.add_damage(str(error))

    def _connect(self) -> sqlite3.Connection:
        return sqlite3.connect(f'{self.path.absolute().as_uri()}?immutable=1', uri=True)

    def _records(self) -> Iterator[Record]:
        with closing(self._connect()) as base:
            known = dict(self._topics(base))
            self.channels += known.values()
            wrong = 0
            rows = base.execute('SELECT topic_id, timestamp, data FROM messages ORDER BY rowid')
            for topic_id, time_ns, data in rows:
                # SQLite keeps any type of value in any column.
                is_whole = isinstance(time_ns, int) and isinstance(data, bytes)
                if is_whole and topic_id in known:
                    yield known[topic_id], time_ns, data
                else:
                    wrong += 1
            if wrong:
                self.add_damage(f'{wrong} rows of the table messages are no messages of a topic')

    def _topics(self, base: sqlite3.Connection) -> Iterator[tuple[int, Channel]]:
        definitions = {}
        if list(base.execute('PRAGMA table_info(message_definitions)')):
            definitions = {
                name: (encoding, text)
                for name, encoding, text in base.execute(
                    'SELECT topic_type, encoding, encoded_message_definition '
                    'FROM message_definitions'
                )
            }
        cursor = base.execute('SELECT * FROM topics')
        columns = [column[0] for column in cursor.description]
        for values in cursor:
            row = dict(zip(columns, values, strict=True))
            if not (isinstance(row['name'], str) and isinstance(row['type'], str)):
                self.add_damage('a row of the table topics names no topic or no type')
                continue
            other = '' if row['serialization_format'] == 'cdr' else ' in another format'
            encoding, text = definitions.get(row['type'], ('', ''))
            qos = str(row.get('offered_qos_profiles') or '')
            yield row['id'], Channel(row['name'], row['type'] + other, encoding, text, qos)


STORAGES = {'.mcap': McapFile, '.db3': SqliteFile}
"""What reads a file, by its ending."""
