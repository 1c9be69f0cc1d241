# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable `localize_bag` with several bags: each as alone, and one report on all."""

import json
import os
from pathlib import Path
import signal
import subprocess

import pytest

pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")

from processes import start, wait_for  # noqa: E402
from small_bags import (  # noqa: E402
    TRIANGLE,
    counts,
    write_parameters,
    write_table,
    write_triangles,
)

from dg_localization.ros.executables import localize_bag  # noqa: E402


@pytest.fixture
def bags(tmp_path):
    """Write two bags of a triangle, of 11 and 21 steps."""
    lengths = {'first': 11, 'second': 21}
    return [write_triangles(tmp_path / name, [range(n)]) for name, n in lengths.items()]


@pytest.fixture
def localize_all(tmp_path):
    """Localize bags; return the exit code and the text of the merged report."""
    params = write_parameters(tmp_path)

    def run(*arguments, output='out', report='all.json'):
        paths = ('-o', tmp_path / output, '--report', tmp_path / report, '--params', params)
        code = localize_bag([str(one) for one in (*paths, *arguments)])
        path = tmp_path / report
        return code, path.read_text() if path.exists() else None

    return run


def test_each_bag_is_localized_compared_and_drawn_as_alone(bags, localize_all, tmp_path):
    pytest.importorskip('matplotlib', reason="matplotlib, the extra 'plots', is not installed")
    truth, plot = (
        ('--truth', write_table(tmp_path / 'truth.csv')),
        ('--plot', tmp_path / 'picture.png'),
    )
    # ROS arguments reach every process.
    ros_arguments = ('--ros-args', '-p', 'rate:=4.0')
    code, text = localize_all(*bags, '--jobs', '1', *truth, *plot, *ros_arguments)
    outcomes = json.loads(text)['bags']
    assert code == 0 and [bag['name'] for bag in outcomes] == ['first', 'second']
    for bag, outcome in zip(bags, outcomes, strict=True):
        report = outcome['report']
        assert report['truth']['held'] == report['truth']['compared'] == report['ticks'] > 0
        assert report['rate_hz'] == 4.0
        assert (tmp_path / 'out' / bag.name / 'picture.png').read_bytes().startswith(b'\x89PNG')
    alone = {'output': 'alone', 'report': 'alone.json'}
    code, text = localize_all(bags[0], *truth, *ros_arguments, **alone)
    assert code == 0 and json.loads(text) == outcomes[0]['report']
    assert counts(tmp_path / 'out/first/answers') == counts(tmp_path / 'alone')


def test_ctrl_c_leaves_bags_that_can_be_read(tmp_path):
    """A terminal sends its signal to all processes of the group."""
    bags = [write_triangles(tmp_path / name, [range(400)]) for name in ('first', 'second')]
    params = write_parameters(tmp_path, rate=100.0)
    paths = *bags, '-o', tmp_path / 'out', '--params', params, '--jobs', '2'
    process = start('localize_bag', *paths, stderr=subprocess.DEVNULL, start_new_session=True)
    answers = [tmp_path / 'out' / bag.name / 'answers' for bag in bags]
    wait_for(lambda: all(any(path.glob('*.mcap')) for path in answers))
    # One that is told to stop by the terminal and by the command would stop in the middle.
    threads = Path(f'/proc/{process.pid}/task').glob('*/children')
    started = [int(pid) for thread in threads for pid in thread.read_text().split()]
    assert len(started) == 2
    assert all(os.getpgid(pid) != process.pid for pid in started)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(timeout=60.0) == 130
    for path in answers:
        assert not path.exists() or (path / 'metadata.yaml').exists()


def test_a_bag_that_fails_leaves_the_others_theirs(localize_all, tmp_path):
    impossible = {('a', 'b'): 1.0, ('a', 'c'): 1.0, ('b', 'c'): 9.0}
    bag = write_triangles(tmp_path / 'first', [range(11), impossible])
    (tmp_path / 'broken.mcap').write_bytes(b'no bag')
    code, text = localize_all(bag, tmp_path / 'broken.mcap', report='all.md')
    assert code == 1
    first, broken = text.splitlines()[-2:]
    assert first.startswith('| first ') and '| at its end ' in first and '| no placement' in first
    assert broken.startswith('| broken ') and 'broken.mcap' in broken


def test_two_bags_of_one_name_are_refused(bags, localize_all, tmp_path, capsys):
    code, text = localize_all(bags[0], bags[0])
    assert code == 2 and text is None and not (tmp_path / 'out').exists()
    assert "two bags are called 'first'" in capsys.readouterr().err


def test_one_process_and_four_give_the_same_bytes(localize_all, tmp_path, monkeypatch):
    """The order of sets, which differs between processes, does not show either."""
    stretches = [range(10)], [range(10, 20), {**TRIANGLE, ('b', 'a'): 2.0, ('c', 'b'): 9.5}]
    bags = [write_triangles(tmp_path / name, *stretches) for name in ('first', 'second')]
    found = []
    for jobs, seed in ('1', '1'), ('4', '2'):
        monkeypatch.setenv('PYTHONHASHSEED', seed)
        given = '--jobs', jobs, '--ros-args', '-p', 'max_outliers:=2'
        code, text = localize_all(*bags, *given, output=f'out_{jobs}')
        assert code == 0 and json.loads(text)['bags'][0]['report']['contradictions']
        folder = tmp_path / f'out_{jobs}'
        files = sorted(path for path in folder.rglob('*') if path.is_file())
        found.append({path.relative_to(folder): path.read_bytes() for path in files})
    assert len(found[0]) >= 6 and found[0] == found[1]
