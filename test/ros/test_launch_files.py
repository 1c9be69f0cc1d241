# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The launch files: what they start, and that it starts."""

from importlib.util import find_spec
from pathlib import Path

from launch_stand_ins import MissingArgumentError, install, launched
import pytest

from dg_localization.ros.executables import EXECUTABLES
from dg_localization.ros.simulation.simulate_fleet import PARAMETERS

REPOSITORY = Path(__file__).parents[2]
LAUNCH = REPOSITORY / 'launch'
FILES = sorted(LAUNCH.glob('*.launch.py'))
REQUIRED = {
    'localizer': {'params_file': 'fleet.yaml'},
    'simulation': {},
    'bag': {'params_file': 'fleet.yaml', 'bag': 'recording'},
}


def name_of(path):
    return path.name.partition('.')[0]


@pytest.fixture
def launch(monkeypatch):
    install(monkeypatch)
    return lambda name, **arguments: launched(LAUNCH / f'{name}.launch.py', **arguments)


@pytest.mark.parametrize('name', REQUIRED)
def test_every_file_starts_executables_that_there_are(launch, name):
    assert {name_of(path) for path in FILES} == set(REQUIRED)
    given = REQUIRED[name]
    closed = {process.executable: process for process in launch(name, **given).processes}
    context = launch(name, **given, rviz='true', extra_params_file='learned.yaml')
    processes = {process.executable: process for process in context.processes}
    assert set(closed) <= set(EXECUTABLES) and set(processes) - set(closed) == {'rviz2'}
    # A second file of parameters comes after the first, which stands in for it.
    assert closed['localizer'].files == 2 * [closed['localizer'].files[0]]
    assert processes['localizer'].files[1:] == ['learned.yaml']
    # Only the recording brings its own time, and ends all.
    assert closed['localizer'].parameters['use_sim_time'] == (name == 'bag')
    ending = [executable for executable, process in closed.items() if process.ends_all]
    assert ending == (['replay'] if name == 'bag' else [])
    for missing in given:
        with pytest.raises(MissingArgumentError, match=missing):
            launch(name, **{key: value for key, value in given.items() if key != missing})
    page = '\n'.join(path.read_text(encoding='utf-8') for path in REPOSITORY.glob('docs/*.md'))
    for argument in context.declared.values():
        assert argument.description and f'`{argument.name}`' in page


def test_the_simulation_has_a_namespace_a_frame_and_switches(launch):
    context = launch('simulation', namespace='left', rviz='true', frame='fleet')
    processes = {process.executable: process for process in context.processes}
    assert {process.namespace for process in context.processes} == {'left'}
    rviz = processes['rviz2']
    # Without a slash: in the namespace of RViz.
    assert rviz.remappings == [('/localizer/markers', 'localizer/markers')]
    assert Path(rviz.arguments[1]).exists() and rviz.arguments[-2:] == ['-f', 'fleet']
    assert any('the frame fleet;' in line for line in context.lines)
    assert not launch('simulation').lines
    defaults = {name: spec.default for name, spec in PARAMETERS.items()}
    assert processes['simulate_fleet'].parameters.items() <= defaults.items()


@pytest.mark.skipif(find_spec('launch_ros') is None, reason='launch is not installed')
@pytest.mark.parametrize('path', FILES, ids=name_of)
def test_launch_reads_the_files(path):
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    assert PythonLaunchDescriptionSource(str(path)).try_get_launch_description_without_context()
