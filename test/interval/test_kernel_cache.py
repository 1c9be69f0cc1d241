# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels are kept, dated by their sources, and only where no other user can write."""

from concurrent.futures import ThreadPoolExecutor
from itertools import product
import json

from plain_python import REPOSITORY, run_python
import pytest

from dg_localization.interval import kernel_cache
from dg_localization.interval.kernel_cache import open_folder

pytest.importorskip('numba', reason='numba is not installed')

SOURCE = """
from dg_localization.interval.kernels import kernel

@kernel
def times(x):
    return 2.0 * x

@kernel(borrows=True)
def total(array):
    result = 0.0
    for x in array:
        result += times(x)
    return result
"""
RUN = """
import json, sys
import numpy as np
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
            'PYTHONPATH': f'{folder}:{REPOSITORY}',
            'NUMBA_CACHE_DIR': str(self.cache),
            'NUMBA_DISABLE_JIT': '0',
        }

    def run(self, *kinds):
        """Return the answers, how many kernels were loaded and compiled, and any refusal."""
        done = run_python(RUN, *kinds, **self.environment)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def entries(self, pattern):
        return sorted(self.cache.rglob(pattern))


@pytest.fixture
def tiny(tmp_path):
    return Tiny(tmp_path)


def test_kernels_are_kept_until_their_source_changes(tiny):
    assert tiny.run() == [[6.0], 0, 1, '']
    assert tiny.run() == [[6.0], 1, 0, '']
    assert {path.stat().st_mode & 0o77 for path in (tiny.cache, *tiny.cache.glob('*/*'))} == {0}
    tiny.module.write_text(SOURCE.replace('2.0 *', '2.0 +'))
    assert tiny.run() == [[9.0], 0, 1, '']


def test_damaged_entry_is_rebuilt(tiny):
    tiny.run()
    for pattern, left in product(['tiny.total*.nbi', 'tiny.total*.nbc'], [0, 100]):
        (entry,) = tiny.entries(pattern)
        whole = len(entry.read_bytes())
        entry.write_bytes(entry.read_bytes()[:left] + bytes(left))
        assert tiny.run() == [[6.0], 0, 1, '']
        (entry,) = tiny.entries(pattern)
        assert len(entry.read_bytes()) == whole
    assert tiny.run() == [[6.0], 1, 0, '']


def test_processes_may_start_at_once(tiny):
    # Numba alone would let two of them give one name to different machine code.
    kinds = ['f8', 'f4', 'i8']
    with ThreadPoolExecutor(3) as pool:
        found = pool.map(lambda n: tiny.run(*kinds[n:], *kinds[:n]), range(3))
        assert [answers for answers, *_ in found] == [[6.0] * 3] * 3
    assert tiny.run(*kinds) == [[6.0] * 3, 3, 0, '']


def test_folder_that_others_may_write_to_is_refused(tiny):
    tiny.run()
    (folder,) = tiny.cache.glob('dg_localization/*')
    for place in (folder, folder.parent):
        place.chmod(0o722)
        answers, loaded, compiled, refusal = tiny.run()
        assert (answers, loaded, compiled) == ([6.0], 0, 1)
        assert f'others may write to {place}' in refusal and f'chmod go-w {place}' in refusal
        place.chmod(0o700)
    assert tiny.run() == [[6.0], 1, 0, '']


@pytest.mark.parametrize('place', ['/proc/nobody', '/dev/null'])
def test_no_place_for_a_cache_is_no_crash(tiny, place):
    # As if they were not set.
    tiny.environment |= {'NUMBA_CACHE_DIR': '', 'XDG_CACHE_HOME': '', 'HOME': place}
    answers, loaded, compiled, refusal = tiny.run()
    assert (answers, loaded, compiled) == ([6.0], 0, 1)
    assert 'compiled kernels cannot be kept' in refusal and place in refusal


def test_a_constant_of_another_file_dates_the_folder(tmp_path, monkeypatch):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'cache'))
    package = tmp_path / 'dg_localization'
    package.mkdir()
    files = {
        'a.py': 'from dg_localization.interval.kernels import kernel\n'
        'from dg_localization.b import (\n    LEAST,\n    MOST,\n)\n',
        'b.py': 'from dg_localization import c\nLEAST = 1',
        'c.py': 'MOST = 2',
        'd.py': 'from dg_localization.interval.kernels import COMPILED\n',
    }
    for name, text in files.items():
        (package / name).write_text(text)
    monkeypatch.setattr(kernel_cache, 'PACKAGE', package)
    first = open_folder()
    (package / 'd.py').write_text('OTHER = 3')
    assert open_folder() == first
    (package / 'c.py').write_text('MOST = 3')
    assert open_folder() != first


def test_every_source_of_a_kernel_counts():
    package = REPOSITORY / 'dg_localization'
    holding = {path for path in package.rglob('*.py') if '\n@kernel' in path.read_text()}
    reached = set(kernel_cache.kernel_sources())
    assert holding <= reached and package / 'interval/kernels.py' in reached
    assert not any(path.is_relative_to(package / 'ros') for path in reached)
