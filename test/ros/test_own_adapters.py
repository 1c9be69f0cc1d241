# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Message types of other people, by a module that the parameters name."""

import os
from pathlib import Path
import re
from types import SimpleNamespace

import pytest
from std_msgs.msg import Float32

from dg_localization.ros.interface.parameters.settings import check_values, settings_from
from dg_localization.ros.interface.parameters.spec import WrongParameterError
from msg_adapters import adapter_for

PAGE = Path(__file__).parents[2] / 'docs/sensors.md'
CENTIMETRES = {'/tag_a/to_b': 300.0, '/tag_a/to_c': 400.0, '/tag_b/to_c': 500.0}


def example(language, word):
    """Return the block of code of the page that holds a word."""
    blocks = re.findall(rf'```{language}\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.DOTALL)
    (block,) = [block for block in blocks if word in block]
    return block


def test_example_of_the_readme_localizes(bench, start_localizer, tmp_path, monkeypatch):
    (tmp_path / 'tag_adapter.py').write_text(example('python', 'Float32'))
    parameters = tmp_path / 'my_fleet.yaml'
    parameters.write_text(example('yaml', 'adapter_modules'))
    path = os.environ.get('PYTHONPATH', '')
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(filter(None, [str(tmp_path), path])))
    bench.clear()
    start_localizer('--params-file', str(parameters))

    def send():
        for topic, centimetres in CENTIMETRES.items():
            bench.publisher(Float32, topic).publish(Float32(data=centimetres))

    bench.repeat(send)
    bench.until_placements(2)
    # Sides 3, 4 and 5 m long, b on the x axis of a, c on either side.
    positions_m = bench.last_poses().positions_m.reshape(2, 3, 3)
    assert sorted(positions_m[:, 2, 1]) == pytest.approx([-4.0, 4.0], abs=0.6)


@pytest.mark.usefixtures('adapt')
def test_example_with_ids_names_observer_and_target():
    exec(compile(example('python', 'IdentifiedReading'), PAGE.name, 'exec'), {})
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
