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
    closed = launch(name, **REQUIRED[name]).processes
    processes = launch(name, **REQUIRED[name], rviz='true').processes
    assert len(closed) == len(processes) - 1
    own = [process for process in processes if process.package == 'dg_localization']
    assert {process.executable for process in own} <= set(EXECUTABLES)
    assert [p.executable for p in processes if p not in own] == ['rviz2']
    (localizer,) = [process for process in own if process.executable == 'localizer']
    assert localizer.files == 2 * [localizer.files[0]]


@pytest.mark.parametrize(
    ('name', 'missing'),
    [(name, missing) for name in REQUIRED for missing in REQUIRED[name]],
)
def test_what_has_no_default_must_be_given(launch, name, missing):
    given = {key: value for key, value in REQUIRED[name].items() if key != missing}
    with pytest.raises(MissingArgumentError, match=missing):
        launch(name, **given)


@pytest.mark.parametrize('name', REQUIRED)
def test_every_argument_is_described_and_in_the_documentation(launch, name):
    page = '\n'.join(path.read_text(encoding='utf-8') for path in REPOSITORY.glob('docs/*.md'))
    for argument in launch(name, **REQUIRED[name]).declared.values():
        assert argument.description
        assert f'`{argument.name}`' in page


def test_only_the_recording_brings_its_own_time_and_ends_all(launch):
    for name in REQUIRED:
        processes = {p.executable: p for p in launch(name, **REQUIRED[name]).processes}
        assert processes['localizer'].parameters['use_sim_time'] == (name == 'bag')
        assert [p.executable for p in processes.values() if p.ends_all] == (
            ['replay'] if name == 'bag' else []
        )


@pytest.mark.parametrize('name', REQUIRED)
def test_a_second_file_of_parameters_comes_after_the_first(launch, name):
    processes = launch(name, **REQUIRED[name], extra_params_file='learned.yaml').processes
    (localizer,) = [process for process in processes if process.executable == 'localizer']
    assert localizer.files[1:] == ['learned.yaml']


def test_rviz_says_which_frame_it_shows(launch):
    context = launch('simulation', rviz='true', frame='fleet')
    (rviz,) = [process for process in context.processes if process.executable == 'rviz2']
    assert rviz.arguments[-2:] == ['-f', 'fleet']
    assert any('the frame fleet;' in line for line in context.lines)
    assert not launch('simulation').lines


def test_a_namespace_holds_the_nodes_and_what_rviz_shows(launch):
    processes = launch('simulation', namespace='left', rviz='true').processes
    assert {process.namespace for process in processes} == {'left'}
    (rviz,) = [process for process in processes if process.executable == 'rviz2']
    # Without a slash: in the namespace of RViz.
    assert rviz.remappings == [('/localizer/markers', 'localizer/markers')]
    assert Path(rviz.arguments[1]).exists()


def test_every_switch_of_the_simulation_is_a_parameter_of_its_executable(launch):
    (simulation,) = [
        process
        for process in launch('simulation').processes
        if process.executable == 'simulate_fleet'
    ]
    defaults = {name: spec.default for name, spec in PARAMETERS.items()}
    assert simulation.parameters.items() <= defaults.items()


@pytest.mark.skipif(find_spec('launch_ros') is None, reason='launch is not installed')
@pytest.mark.parametrize('path', FILES, ids=name_of)
def test_launch_reads_the_files(path):
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    assert PythonLaunchDescriptionSource(str(path)).try_get_launch_description_without_context()
