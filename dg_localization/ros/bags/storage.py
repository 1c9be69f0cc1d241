# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The messages in the files of a rosbag2, in the order in which they were written.

A file is read from its beginning to its end, by the package mcap or by SQLite. The index of an
.mcap is not used: one that is damaged hides messages without a word. An .mcap has checksums where
the recorder wrote them, and they are checked. The bytes in a .db3 cannot be checked.
"""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
import sqlite3
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Channel:
    """What a file says of a topic; definition and profiles are empty where it has none."""

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
        What was found to be wrong so far, a sentence each.
    checksums : bool
        Whether all messages so far are protected by one.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: list[Channel] = []
        self.damage: list[str] = []
        self.checksums = path.suffix == '.mcap'

    def records(self) -> Iterator[Record]:
        """Yield the messages, up to the first damage that hides where the next one begins."""
        try:
            yield from self._mcap() if self.path.suffix == '.mcap' else self._sqlite()
        except Exception as error:  # on damaged bytes whatever the parsers stumble over
            self.add_damage(f'{error or type(error).__name__}; what follows is not read')

    def add_damage(self, text: str) -> None:
        """Add a sentence on what is wrong."""
        self.damage.append(f'{self.path.name}: {text}')

    def _mcap(self) -> Iterator[Record]:
        from mcap.records import Channel as McapChannel, Chunk, DataEnd, Message, Schema
        from mcap.stream_reader import StreamReader, breakup_chunk

        size = self.path.stat().st_size
        schemas: dict[int, Any] = {}
        known: dict[int, Channel] = {}
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
                        yield known[one.channel_id], one.log_time, one.data
                    elif isinstance(one, Schema) and not ended:
                        schemas[one.id] = one
                    elif isinstance(one, McapChannel) and not ended:
                        known[one.id] = _channel_of(one, schemas.get(one.schema_id))
                        self.channels.append(known[one.id])
                if isinstance(record, DataEnd):
                    ended = True
                    self.checksums &= all_in_chunks or bool(record.data_section_crc)

    def _sqlite(self) -> Iterator[Record]:
        for ending in ('-wal', '-journal'):
            left = self.path.with_name(self.path.name + ending)
            if left.exists() and left.stat().st_size:
                self.damage.append(
                    f'{left.name}: the recorder did not come to its end, and what this file holds '
                    f"is not read; 'sqlite3 {self.path.name} .tables' completes the bag"
                )
        uri = f'{self.path.absolute().as_uri()}?immutable=1'
        with closing(sqlite3.connect(uri, uri=True)) as base:
            known = dict(self._sqlite_topics(base))
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

    def _sqlite_topics(self, base: sqlite3.Connection) -> Iterator[tuple[int, Channel]]:
        """Yield the topics of a database of any version of rosbag2 by their numbers."""
        definitions = {}
        if list(base.execute('PRAGMA table_info(message_definitions)')):
            query = 'SELECT topic_type, encoding, encoded_message_definition'
            rows = base.execute(f'{query} FROM message_definitions')
            definitions = {name: (encoding, text) for name, encoding, text in rows}
        base.row_factory = sqlite3.Row
        for found in base.execute('SELECT * FROM topics'):
            row = dict(found)
            if not (isinstance(row['name'], str) and isinstance(row['type'], str)):
                self.add_damage('a row of the table topics names no topic or no type')
                continue
            other = '' if row['serialization_format'] == 'cdr' else ' in another format'
            encoding, text = definitions.get(row['type'], ('', ''))
            qos = str(row.get('offered_qos_profiles') or '')
            yield row['id'], Channel(row['name'], row['type'] + other, encoding, text, qos)
        base.row_factory = None


def _channel_of(channel: Any, schema: Any) -> Channel:
    encoding, definition, type_name = '', '', ''
    if schema is not None:
        type_name, encoding = schema.name, schema.encoding
        definition = schema.data.decode(errors='replace')
    if channel.message_encoding != 'cdr':
        type_name = f'{type_name} in {channel.message_encoding}'
    qos = channel.metadata.get('offered_qos_profiles', '')
    return Channel(channel.topic, type_name, encoding, definition, qos)
