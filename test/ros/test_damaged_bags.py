# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
`localize_bag` on damaged bags: it never breaks, and nothing is lost silently.

The environment variables DAMAGED_BAG_BITS and DAMAGED_BAG_OTHERS say how many flipped bits, and
how many of the other damages, are tried of each storage.
"""

from dataclasses import replace
import json
import os
import random
import shutil

import pytest

pytest.importorskip('rclpy', reason='ROS 2 is not installed')
pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")
pytest.importorskip('mcap', reason="mcap, the extra 'bags', is not installed")

from damaged_bags import CHUNK, CHUNK_INDEX, SCHEMA, damages, mcap_records, storage_of, write_bag  # noqa: E402
from mcap.records import Statistics  # noqa: E402

from dg_localization.ros.bags import localize_bag as module  # noqa: E402
from dg_localization.ros.executables import localize_bag  # noqa: E402

N_BITS = int(os.environ.get('DAMAGED_BAG_BITS', '25'))
N_OTHERS = int(os.environ.get('DAMAGED_BAG_OTHERS', '45'))
STORAGES = ('db3', 'mcap', 'mcap without checksums', 'mcap without chunks')


class Runs:
    """Runs `localize_bag`, each time into a folder of the same name."""

    def __init__(self, folder, capsys):
        self.folder = folder
        self._capsys = capsys
        self._params = folder / 'params.yaml'
        given = {'robots': ['a', 'b', 'c'], 'max_speed': 0.1}
        self._params.write_text(json.dumps({'/**': {'ros__parameters': given}}))

    def run(self, bag):
        """Return the exit code, the answers as bytes, the report, and what was printed."""
        out, report = self.folder / 'out', self.folder / 'report.json'
        shutil.rmtree(out, ignore_errors=True)
        report.unlink(missing_ok=True)
        paths = ('-o', out, '--params', self._params, '--report', report)
        code = localize_bag([str(text) for text in (bag, *paths)])
        printed = self._capsys.readouterr()
        return (
            code,
            (out / 'out.mcap').read_bytes() if out.exists() else None,
            json.loads(report.read_text()) if report.exists() else None,
            printed.out + printed.err,
        )


@pytest.fixture
def runs(tmp_path, capsys, monkeypatch):
    """Read the parameters only once: a node is made for that, which takes longer than the rest."""
    tasks = []
    read_task = module.read_task

    def read_once(params, arguments):
        if not tasks:
            tasks.append(read_task(params, arguments))
        return tasks[0]

    monkeypatch.setattr(module, 'read_task', read_once)
    return Runs(tmp_path, capsys)


def wrong_about(run, answers, damage):
    """Return what a run on a damaged bag did wrong; empty when nothing."""
    code, found, report, printed = run
    if code not in (0, 1):
        return f'exit code {code}'
    if report is None and found is not None:
        return 'answers without a report'
    if code == 1 and report is None and not printed.strip():
        return 'it failed without a word'
    if code == 1 and report is not None and not (report['ending'] or report['damage']):
        return 'it failed, and the report does not say why'
    said = report is not None and bool(report['rejected'] or report['notices'])
    if code == 0 and found != answers and not said:
        if damage.noticeable or report['checksums']:
            return 'answers are lost or changed without a word'
        if found is None:
            return 'no answers and exit code 0'
    return ''


@pytest.mark.parametrize('storage', STORAGES)
def test_a_damaged_bag_never_loses_anything_silently(runs, storage):
    whole = runs.folder / 'whole'
    write_bag(whole, storage)
    code, answers, report, _ = runs.run(whole)
    assert code == 0 and report['ticks'] == 4 and report['damage'] == [] and answers
    assert report['checksums'] is (storage == 'mcap')
    bag, failures, n_cases = runs.folder / 'bag', [], 0
    found = list(damages(whole, storage, N_BITS))
    bits = [damage for damage in found if damage.name.startswith('bit ')]
    others = [damage for damage in found if not damage.name.startswith('bit ')]
    random.Random(storage).shuffle(others)
    for damage in (*bits, *others[:N_OTHERS]):
        shutil.rmtree(bag, ignore_errors=True)
        shutil.copytree(whole, bag)
        damage.change(bag)
        n_cases += 1
        try:
            wrong = wrong_about(runs.run(bag), answers, damage)
        except Exception as error:  # what a user would see as a traceback
            wrong = f'{type(error).__name__}: {error}'
        if wrong:
            failures.append(f'{damage.name}: {wrong}')
    assert not failures, f'{len(failures)} of {n_cases}:\n' + '\n'.join(failures)


@pytest.mark.parametrize(
    ('opcode', 'offset', 'reason'),
    [
        (CHUNK, 100, 'what follows is not read'),
        # A time that nothing is done with.
        (CHUNK_INDEX, 9, 'the checksum of its summary'),
        # A definition that is there twice.
        (SCHEMA, 100, 'the checksum of its summary'),
    ],
)
def test_a_wrong_checksum_is_named(runs, opcode, offset, reason):
    bag = runs.folder / 'bag'
    write_bag(bag, 'mcap')
    data = bytearray(storage_of(bag).read_bytes())
    # The last record of a kind; that of a schema is in the summary.
    begin = {opcode: begin for begin, opcode in mcap_records(data)}[opcode]
    data[begin + offset] ^= 1
    storage_of(bag).write_bytes(data)
    code, _, report, printed = runs.run(bag)
    assert code == 1 and report is not None and reason in printed


def test_a_chunk_that_is_damaged_keeps_the_answers_before_it(runs):
    bag = runs.folder / 'bag'
    write_bag(bag, 'mcap')
    path = storage_of(bag)
    data = bytearray(path.read_bytes())
    last_chunk = {opcode: begin for begin, opcode in mcap_records(data)}[CHUNK]
    data[last_chunk + 100] ^= 1
    path.write_bytes(data)
    code, answers, report, _ = runs.run(bag)
    assert code == 1 and answers and 0 < report['ticks'] < 4
    assert any('what follows is not read' in text for text in report['damage'])


def test_metadata_that_name_another_topic_are_damage(runs):
    bag = runs.folder / 'bag'
    write_bag(bag, 'db3')
    metadata = bag / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('name: /b/range/c', 'name: /b/range/x'))
    code, _, report, _ = runs.run(bag)
    assert code == 1
    assert any(text.startswith('/b/range/c: 9 messages are in') for text in report['damage'])


def test_statistics_without_counts_by_channel_are_no_damage(runs, monkeypatch):
    write = Statistics.write
    monkeypatch.setattr(
        Statistics, 'write', lambda self, out: write(replace(self, channel_message_counts={}), out)
    )
    write_bag(runs.folder / 'bag', 'mcap')
    code, answers, report, _ = runs.run(runs.folder / 'bag')
    assert code == 0 and report['damage'] == [] and answers
