# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The messages in a file of a rosbag2, in the order in which they were written.

A file is read from its beginning to its end, by the package mcap or by SQLite. The index of an
.mcap is not used: one that is damaged hides messages without a word. An .mcap has checksums where
the recorder wrote them, and they are checked. The bytes in a .db3 cannot be checked.
"""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
import sqlite3
from typing import Any, NamedTuple


class Channel(NamedTuple):
    """What a file says of a topic; definition and profiles are empty where it has none."""

    topic: str
    type_name: str
    encoding: str
    definition: str
    offered_qos: str


class Record(NamedTuple):
    """A channel that begins, where `data` is None, or a message with its receive time in ns."""

    channel: Channel
    time_ns: int = 0
    data: bytes | None = None


def read_file(path: Path, damage: list[str]) -> Iterator[Record]:
    """Yield the records up to the first damage that hides the next; add what is wrong."""
    try:
        yield from _read_mcap(path) if path.suffix == '.mcap' else _read_sqlite(path, damage)
    except Exception as error:  # on damaged bytes whatever the parsers stumble over
        reason = str(error) or type(error).__name__
        damage.append(f'{path.name}: {reason}; what follows is not read')


def _read_mcap(path: Path) -> Iterator[Record]:
    from mcap.records import Channel as McapChannel, DataEnd, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Any] = {}
    known: dict[int, Channel] = {}
    with path.open('rb') as file:
        size = path.stat().st_size
        for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
            if isinstance(record, Message):
                yield Record(known[record.channel_id], record.log_time, record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, McapChannel):
                known[record.id] = _channel_of(record, schemas.get(record.schema_id))
                yield Record(known[record.id])
            elif isinstance(record, DataEnd):
                # What follows repeats it for the index.
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


def _read_sqlite(path: Path, damage: list[str]) -> Iterator[Record]:
    for ending in ('-wal', '-journal'):
        left = path.with_name(path.name + ending)
        if left.exists() and left.stat().st_size:
            damage.append(
                f'{left.name}: the recorder did not come to its end, and what this file holds is '
                f"not read; 'sqlite3 {path.name} .tables' completes the bag"
            )
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
            yield Record(known[row['id']])
        n_wrong = 0
        query = 'SELECT topic_id, timestamp, data FROM messages ORDER BY rowid'
        for topic_id, time_ns, data in base.execute(query):
            # SQLite keeps any type of value in any column.
            if isinstance(time_ns, int) and isinstance(data, bytes) and topic_id in known:
                yield Record(known[topic_id], time_ns, data)
            else:
                n_wrong += 1
    if n_wrong:
        damage.append(
            f'{path.name}: {n_wrong} rows of the table messages are no messages of a topic'
        )
