# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels are kept, dated by their code, and only where nobody else can write."""

import fcntl
import json
import os
from pathlib import Path
import subprocess
import sys
from textwrap import dedent
import time

import pytest

from dg_localization.interval import kernel_cache
from dg_localization.interval.kernel_cache import CacheRefusedError, open_folder

pytest.importorskip('numba', reason='numba is not installed')

REPOSITORY = Path(__file__).parents[2]
SOURCE = '''
from dg_localization.interval.kernels import kernel

FACTOR = 2.0

@kernel
def times(x):
    return FACTOR * x

@kernel(borrows=True)
def total(array):
    """Return the sum."""
    result = 0.0
    for x in array:
        result += times(x)
    return result
'''
RUN = """
import json, sys
import numpy as np
{before}
import tiny
from dg_localization.interval import kernels
answers = [tiny.total(np.ones(3, dtype=kind)) for kind in sys.argv[1:] or ['f8']]
stats = tiny.total.stats
print(json.dumps([answers, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()),
                  kernels.why_not_kept()]))
"""


class Tiny:
    """A module with two kernels, to be run in processes of their own."""

    def __init__(self, folder):
        self.cache = folder / 'cache'
        self.module = folder / 'tiny.py'
        self.module.write_text(SOURCE)
        self.environment = {
            **os.environ,
            'PYTHONPATH': f'{folder}:{REPOSITORY}',
            'NUMBA_CACHE_DIR': str(self.cache),
        }

    def start(self, *kinds, before=''):
        return subprocess.Popen(
            [sys.executable, '-c', RUN.format(before=dedent(before)), *kinds],
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *kinds, before=''):
        """Return the answers, how many kernels were loaded and compiled, and any refusal."""
        process = self.start(*kinds, before=before)
        output, errors = process.communicate(timeout=200.0)
        assert process.returncode == 0, errors
        self.errors = errors
        return json.loads(output)

    def edit(self, old, new):
        assert old in self.module.read_text()
        self.module.write_text(self.module.read_text().replace(old, new))

    def entries(self, pattern):
        return sorted(self.cache.glob(f'dg_localization/*/{pattern}'))


@pytest.fixture
def tiny(tmp_path):
    return Tiny(tmp_path)


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Where caches are looked for by default."""
    for name in ('NUMBA_CACHE_DIR', 'XDG_CACHE_HOME'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('HOME', str(tmp_path))
    return tmp_path


def test_kernels_are_kept(tiny):
    assert tiny.run() == [[6.0], 0, 1, '']
    assert tiny.run() == [[6.0], 1, 0, '']
    folder = tiny.entries('in_use')[0].parent
    assert [path.stat().st_mode & 0o777 for path in (folder, *folder.parents[:2])] == [0o700] * 3


def test_comments_and_docstrings_compile_nothing(tiny):
    tiny.run()
    tiny.edit('"""Return the sum."""', '"""\n    Return the sum of all.\n    """')
    tiny.edit('FACTOR = 2.0', '# Twice as much.\n\nFACTOR = 2.0')
    assert tiny.run() == [[6.0], 1, 0, '']


def test_a_constant_and_a_callee_compile_anew(tiny):
    tiny.run()
    tiny.edit('FACTOR = 2.0', 'FACTOR = 3.0')
    assert tiny.run() == [[9.0], 0, 1, '']
    tiny.edit('return FACTOR * x', 'return FACTOR + x')
    assert tiny.run() == [[12.0], 0, 1, '']


@pytest.mark.parametrize('pattern', ['tiny.total*.nbi', 'tiny.total*.nbc'])
@pytest.mark.parametrize('left', [0, 100])
def test_damaged_entry_is_rebuilt(tiny, pattern, left):
    tiny.run()
    (entry,) = tiny.entries(pattern)
    entry.write_bytes(entry.read_bytes()[:left])
    assert tiny.run() == [[6.0], 0, 1, '']
    assert tiny.run() == [[6.0], 1, 0, '']


def test_entry_of_zeros_is_rebuilt(tiny):
    tiny.run()
    (entry,) = tiny.entries('tiny.total*.nbc')
    entry.write_bytes(bytes(entry.stat().st_size))
    assert tiny.run() == [[6.0], 0, 1, '']
    assert tiny.run() == [[6.0], 1, 0, '']


def test_processes_may_start_at_once(tiny):
    # Numba alone would let two of them give one name to different machine code.
    kinds = ['f8', 'f4', 'i8', 'i4']
    started = [tiny.start(*kinds[n:], *kinds[:n]) for n in range(4)]
    for process in started:
        output, errors = process.communicate(timeout=200.0)
        assert process.returncode == 0, errors
        assert json.loads(output)[0] == [6.0] * 4
    assert tiny.run(*kinds) == [[6.0] * 4, 4, 0, '']


def test_folder_that_others_may_write_to_is_refused(tiny):
    tiny.run()
    folder = tiny.entries('in_use')[0].parent
    for place in (folder, folder.parent):
        place.chmod(0o722)
        answers, loaded, compiled, refusal = tiny.run()
        assert (answers, loaded, compiled) == ([6.0], 0, 1)
        assert f'others may write to {place}' in refusal and f'chmod go-w {place}' in refusal
        assert refusal in tiny.errors
        place.chmod(0o700)
    assert tiny.run() == [[6.0], 1, 0, '']


@pytest.mark.skipif(os.geteuid() != 0, reason='only root can give files away')
def test_folder_of_another_user_is_refused(home):
    folder = open_folder()
    os.chown(folder, 12345, -1)
    with pytest.raises(CacheRefusedError, match=r'belongs to user 12345, not to 0'):
        open_folder()
    os.chown(folder, 0, -1)
    os.chown(home, 12345, -1)
    with pytest.raises(CacheRefusedError, match=rf'{home} belongs to user 12345'):
        open_folder()


def test_sticky_folder_is_as_good_as_a_private_one(home, monkeypatch):
    shared = home / 'shared'
    shared.mkdir()
    shared.chmod(0o1777)
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(shared))
    assert open_folder().is_relative_to(shared)
    shared.chmod(0o777)
    with pytest.raises(CacheRefusedError, match=f'others may write to {shared}'):
        open_folder()


@pytest.mark.parametrize('place', ['/proc/nobody', '/dev/null'])
def test_no_place_for_a_cache_is_no_crash(tiny, place):
    del tiny.environment['NUMBA_CACHE_DIR']
    tiny.environment.pop('XDG_CACHE_HOME', None)
    tiny.environment['HOME'] = place
    answers, loaded, compiled, refusal = tiny.run()
    assert (answers, loaded, compiled) == ([6.0], 0, 1)
    assert 'compiled kernels cannot be kept' in refusal and place in refusal


FULL_DISK = """
import errno, os
from numba.core import caching
def full(self, name, data):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
caching.IndexDataCacheFile._save_data = full
"""


def test_a_full_disk_is_told(tiny):
    """Every process compiled for minutes, and nothing said why."""
    answers, _, compiled, refusal = tiny.run(before=FULL_DISK)
    assert (answers, compiled) == ([6.0], 1)
    assert refusal.startswith('compiled kernels cannot all be kept in ')
    assert str(tiny.cache) in refusal and 'No space left on device' in refusal
    assert tiny.run() == [[6.0], 0, 1, '']


def test_user_without_a_home_is_refused(home, monkeypatch):
    def fail():
        raise RuntimeError('Could not determine home directory.')

    monkeypatch.setattr(Path, 'home', fail)
    with pytest.raises(CacheRefusedError, match='Could not determine home directory'):
        open_folder()


@pytest.mark.parametrize(
    'before',
    [
        'import numba.core.caching as caching; del caching._CacheLocator',
        'import numba.core.cpu as cpu; cpu.CPUTargetOptions = object',
    ],
    ids=['caching', '_nrt'],
)
def test_private_parts_of_numba_may_be_gone(tiny, before):
    assert tiny.run(before=before) == [[6.0], 0, 1, '']
    assert tiny.run(before=before) == [[6.0], 1, 0, '']


def test_a_kernel_without_machine_code_to_keep_is_no_crash(tiny):
    before = """
        from numba.core import codegen

        def nothing(self):
            raise RuntimeError('no compiled object yet')

        codegen.CodeLibrary._get_compiled_object = nothing
    """
    assert tiny.run(before=before) == [[6.0], 0, 1, '']
    assert tiny.run() == [[6.0], 0, 1, '']


def test_old_folders_are_pruned_but_for_those_in_use(home):
    root = home / '.cache' / 'dg_localization'
    now_s = time.time()
    olds = [root / f'{number:016x}' for number in range(1, 13)]
    for age, old in enumerate(olds):
        old.mkdir(parents=True)
        (old / 'in_use').touch()
        os.utime(old / 'in_use', (now_s - 100.0 * age,) * 2)
    others = root / 'not_ours'
    others.mkdir()
    held = os.open(olds[-1] / 'in_use', os.O_RDWR)
    fcntl.flock(held, fcntl.LOCK_SH)
    folder = open_folder()
    os.close(held)
    kept = {folder, others, olds[-1], *olds[: kernel_cache.KEPT_FOLDERS - 1]}
    assert set(root.iterdir()) == kept


def test_digest_is_that_of_the_code(tmp_path):
    source = tmp_path / 'source.py'
    digests = []
    for text in (
        'import one.two\nA = 1\ndef f(x):\n    return A + x\n',
        '"""Doc."""\nimport one.two  # why\n\nA = 1\n"""What A is."""\n'
        'def f(x):\n    """Doc."""\n    return (A\n        + x)\n',
        'import one.two\nA = 2\ndef f(x):\n    return A + x\n',
    ):
        source.write_text(text)
        digest, names = kernel_cache.read_code(source)
        digests.append(digest)
        assert names == {'one.two'}
    assert digests[0] == digests[1] != digests[2]


def test_every_source_of_a_kernel_counts():
    package = REPOSITORY / 'dg_localization'
    sources = {path.relative_to(package).as_posix() for path in kernel_cache._kernel_code()}
    for path in package.rglob('*.py'):
        text = path.read_text()
        if '\n@kernel' in text:
            assert path.relative_to(package).as_posix() in sources
    assert 'interval/kernels.py' in sources
    assert not any(source.startswith('ros/') for source in sources)
