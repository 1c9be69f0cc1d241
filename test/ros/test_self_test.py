# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""`self_test` over DDS: every figure is printed, and the exit code follows the verdicts."""

import pytest

from dg_localization.ros.executables import self_test
from dg_localization.ros.self_test import Observed

CHECKS = ('numba', 'kernels', 'answers', 'delay', 'messages', 'clock', 'memory')


def test_every_check_is_printed_with_its_figure(capsys, tmp_path, monkeypatch):
    # The clone that something else was installed from may be the working directory.
    (tmp_path / 'dg_localization').mkdir()
    (tmp_path / 'dg_localization/__init__.py').write_text("raise ImportError('not installed')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('dg_localization.ros.self_test.MEASURE_S', 4.0)
    code = self_test([])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == list(CHECKS)
    assert {line.split()[0] for line in lines} <= {'PASS', 'FAIL'}
    assert code == int(any(line.startswith('FAIL') for line in lines))
    # Whatever the load of this machine is, the localizer answers.
    assert 'a second of 5' in next(line for line in lines if 'answers' in line)


def test_messages_count_from_the_first_diagnostics():
    lost_half = Observed(heard=[(1.0, {'a': 10, 'b': 0}), (3.0, {'a': 20, 'b': 10, 'c': 9})])
    assert lost_half.fraction_heard() == pytest.approx(0.5)
    assert Observed().fraction_heard() == 0.0
