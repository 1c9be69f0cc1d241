# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The examples of the documentation: own adapters, a table of ranges, a reader of the answers."""

import json
import os
from pathlib import Path
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from small_bags import TRIANGLE
from std_msgs.msg import Float32

from dg_localization.ros.executables import localize_bag
from dg_localization.ros.interface.parameters.settings import check_values, settings_from
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from msg_adapters import adapter_for

DOCS = Path(__file__).parents[2] / 'docs'
CENTIMETRES = {'/tag_a/to_b': 300.0, '/tag_a/to_c': 400.0, '/tag_b/to_c': 500.0}


def example(page, language, word=''):
    """Return the block of code of a page that holds a word."""
    text = (DOCS / page).read_text(encoding='utf-8')
    blocks = re.findall(rf'```{language}\n(.*?)```', text, re.DOTALL)
    (block,) = [block for block in blocks if word in block]
    return block


def test_example_of_the_readme_localizes(bench, start_localizer, tmp_path, monkeypatch):
    (tmp_path / 'tag_adapter.py').write_text(example('sensors.md', 'python', 'Float32'))
    parameters = tmp_path / 'my_fleet.yaml'
    parameters.write_text(example('sensors.md', 'yaml', 'adapter_modules'))
    path = os.environ.get('PYTHONPATH', '')
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(filter(None, [str(tmp_path), path])))
    bench.clear()
    start_localizer('--params-file', str(parameters))

    def send():
        for topic, centimetres in CENTIMETRES.items():
            bench.publisher(Float32, topic).publish(Float32(data=centimetres))

    bench.sending = [send]
    bench.until_placements(2)
    # Sides 3, 4 and 5 m long, b on the x axis of a, c on either side.
    positions_m = bench.last_poses().positions_m.reshape(2, 3, 3)
    assert sorted(positions_m[:, 2, 1]) == pytest.approx([-4.0, 4.0], abs=0.6)


@pytest.mark.usefixtures('adapt')
def test_example_with_ids_names_observer_and_target():
    code = example('sensors.md', 'python', 'IdentifiedReading')
    exec(compile(code, 'sensors.md', 'exec'), {})
    header = SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=500_000_000))
    message = SimpleNamespace(header=header, from_id=10, to_id=20, distance_mm=3250)
    reading = adapter_for('my_uwb_msgs/msg/Distance').from_message(message)
    assert (reading.stamp_s, reading.observer_id, reading.target_ids) == (5.5, '10', ('20',))
    assert reading.ranges_m.tolist() == [3.25]


@pytest.mark.parametrize(
    'text, wanted',
    [
        (None, "'no_such_adapter' cannot be imported .ModuleNotFoundError: .* PYTHONPATH"),
        ('1 / 0', 'ZeroDivisionError: division by zero'),
        ("raise SystemExit('done')", 'SystemExit: done'),
        ('import no_such_driver', "No module named 'no_such_driver'"),
    ],
)
def test_module_that_cannot_be_imported_is_refused(tmp_path, monkeypatch, text, wanted):
    monkeypatch.syspath_prepend(tmp_path)
    name = 'no_such_adapter'
    if text is not None:
        name = f'adapter_{len(text)}'
        (tmp_path / f'{name}.py').write_text(text)
    with pytest.raises(WrongParameterError, match=f"'adapter_modules': .*{wanted}"):
        settings_from(check_values({'robots': ['a'], 'adapter_modules': [name]}))


def test_the_table_of_ranges_in_the_docs_is_localized(tmp_path, monkeypatch):
    code = example('bags.md', 'python')
    rows = [f'{10.0 + 0.1 * k},{o},{t},{d}' for k in range(20) for (o, t), d in TRIANGLE.items()]
    monkeypatch.chdir(tmp_path)
    Path('ranges.csv').write_text('\n'.join(['stamp,observer,target,range', *rows]))
    Path('my_bag.yaml').write_text("/**: {ros__parameters: {robots: ['a', 'b', 'c']}}")
    exec(compile(code, 'bags.md', 'exec'), {})
    paths = 'my_bag', '-o', 'answers', '--params', 'my_bag.yaml', '--report', 'report.json'
    assert localize_bag(list(paths)) == 0
    report = json.loads(Path('report.json').read_text())
    assert report['ticks_by_hypotheses'] == {'2': report['ticks']}


def test_example_prints_the_answers_while_they_are_new(bench, start_localizer, tmp_path):
    code, printed = example('answers.md', 'python'), tmp_path / 'printed.txt'
    robots = "robots:=['robot_1', 'robot_2', 'robot_3']"
    localizer = start_localizer('-p', robots, '-p', 'max_speed:=0.1')
    with printed.open('w') as file:
        reader = subprocess.Popen([sys.executable, '-c', code], stdout=file)
    try:
        bench.play_triangle()
        bench.until(lambda: '2 hypotheses in fleet' in printed.read_text(), 'both hypotheses')
        localizer.process.kill()
        shown = len(printed.read_text())
        bench.until(lambda: '\n0 hypotheses' in printed.read_text()[shown:], 'no old answer')
    finally:
        reader.kill()
        reader.wait()
    text = printed.read_text()
    assert '  robot_1: 0.00, 0.00\n' in text
    assert {*re.findall(r'robot_3: \S+, (-?)[34]\.', text)} == {'', '-'}
