# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The node of the documentation that reads the answers."""

from pathlib import Path
import re
import subprocess
import sys

PAGE = Path(__file__).parents[2] / 'docs/answers.md'


def test_example_prints_the_answers_while_they_are_new(bench, start_localizer, tmp_path):
    (code,) = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.DOTALL)
    printed = tmp_path / 'printed.txt'
    parameters = tmp_path / 'fleet.yaml'
    parameters.write_text(
        '/**: {ros__parameters: {robots: [robot_1, robot_2, robot_3], max_speed: 0.1}}'
    )
    localizer = start_localizer('--params-file', str(parameters))

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
