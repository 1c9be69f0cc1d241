# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable that compiles the kernels: what it prints, and when it fails."""

from plain_python import run_python
import pytest

numba = pytest.importorskip('numba', reason='numba is not installed')
WITHOUT_NUMBA = "import sys; sys.modules['numba'] = None\n"


def compile_kernels(before='', **environment):
    code = 'from dg_localization.compile_kernels import main\nraise SystemExit(main([]))'
    return run_python(before + code, **environment)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_ready_kernels_are_reported_with_their_folder():
    done = compile_kernels()
    assert done.returncode == 0, done.stderr
    assert 'The kernels are ready after' in done.stdout and 'dg_localization' in done.stdout


def test_without_numba_it_says_how_to_install_it():
    done = compile_kernels(WITHOUT_NUMBA)
    assert done.returncode == 1 and done.stdout == ''
    for text in ('in Python', '100 times slower', 'not installed', 'pip install numba'):
        assert text in done.stderr
    done = compile_kernels(NUMBA_DISABLE_JIT='1')
    assert done.returncode == 1 and 'NUMBA_DISABLE_JIT is set' in done.stderr


def test_kernels_that_cannot_be_kept_are_a_failure(tmp_path):
    tmp_path.chmod(0o777)
    done = compile_kernels(NUMBA_CACHE_DIR=str(tmp_path), NUMBA_DISABLE_JIT='0')
    assert done.returncode == 1 and f'others may write to {tmp_path}' in done.stderr
