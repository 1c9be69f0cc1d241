# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The launch files: what they start, that it starts, and two fleets side by side.

`launch` and `launch_ros` are no wheels. Their stand-ins, as far as our files use them, are as
strict as the originals: arguments and configurations are set one after the other and are seen by
what comes later, also in files that are included; a file is included only with every argument that
has no default there; every substitution is performed.
"""

from dataclasses import make_dataclass
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
import os
from pathlib import Path
import runpy
import signal
import subprocess
import sys
from types import ModuleType, SimpleNamespace

from geometry_msgs.msg import PoseArray
from processes import LATCHED, REPOSITORY, start
import pytest

from dg_localization.ros.executables import EXECUTABLES
from dg_localization.ros.simulation.simulate_fleet import PARAMETERS

LAUNCH = REPOSITORY / 'launch'
FILES = sorted(LAUNCH.glob('*.launch.py'))
REQUIRED = {
    'localizer': {'params_file': 'fleet.yaml'},
    'simulation': {},
    'bag': {'params_file': 'fleet.yaml', 'bag': 'recording'},
}


class MissingArgumentError(Exception):
    """An argument without a default was not given."""


def optional(**defaults):
    return [(name, object, default) for name, default in defaults.items()]


LaunchConfiguration = make_dataclass('LaunchConfiguration', ['name'])
ParameterValue = make_dataclass('ParameterValue', ['value', 'value_type'])
IfCondition = make_dataclass('IfCondition', ['predicate'])
Shutdown = make_dataclass('Shutdown', ['reason'])
PythonLaunchDescriptionSource = make_dataclass('PythonLaunchDescriptionSource', ['path'])
LaunchDescription = make_dataclass('LaunchDescription', ['entities'])
LogInfo = make_dataclass('LogInfo', ['msg', *optional(condition=None)])
DEFAULTS = optional(default_value=None, description='', choices=None)
DeclareLaunchArgument = make_dataclass('DeclareLaunchArgument', ['name', *DEFAULTS])
IncludeLaunchDescription = make_dataclass(
    'IncludeLaunchDescription', ['source', *optional(launch_arguments=())]
)
LISTS = optional(namespace='', arguments=(), parameters=(), remappings=())
OTHERS = optional(output='log', condition=None, on_exit=None)
Node = make_dataclass('Node', ['package', 'executable', *LISTS, *OTHERS])


class Context:
    """The configurations so far, what was declared, and the command line of each executable."""

    def __init__(self):
        self.configurations, self.declared, self.processes, self.lines = {}, {}, {}, []

    def text(self, value):
        """Return a substitution, or a list of them, as text."""
        if isinstance(value, (list, tuple)):
            return ''.join(self.text(part) for part in value)
        if isinstance(value, LaunchConfiguration):
            return self.configurations[value.name]
        assert isinstance(value, str), f'{value!r} is neither text nor a substitution'
        return value

    def visit(self, entity):
        """Do what an action says, where its condition, if it has one, is met."""
        condition = getattr(entity, 'condition', None)
        if condition and self.text(condition.predicate) != 'true':
            return
        match entity:
            case LogInfo():
                self.lines.append(self.text(entity.msg))
            case DeclareLaunchArgument(name, default, _, choices):
                self.declared.setdefault(name, entity)
                if name not in self.configurations:
                    if default is None:
                        raise MissingArgumentError(name)
                    self.configurations[name] = self.text(default)
                assert choices is None or self.configurations[name] in choices
            case IncludeLaunchDescription(source, arguments):
                given = {self.text(name): self.text(value) for name, value in arguments}
                entities = described(self.text(source.path)).entities
                # Those that are set but not handed on do not count.
                for name in required(entities):
                    if name not in given:
                        raise MissingArgumentError(name)
                self.configurations.update(given)
                for inner in entities:
                    self.visit(inner)
            case Node():
                ends_all = isinstance(entity.on_exit, Shutdown)
                process = SimpleNamespace(line=self.line_of(entity), ends_all=ends_all)
                self.processes[entity.executable] = process

    def line_of(self, node):
        """Return the command line of a process, with all substitutions performed."""
        line = [self.text(part) for part in node.arguments] + ['--ros-args']
        if namespace := self.text(node.namespace):
            line += ['-r', f'__ns:=/{namespace}']
        for entry in node.parameters:
            if not isinstance(entry, dict):
                line += ['--params-file', self.text(entry)]
                continue
            for name, one in entry.items():
                value = self.text(one.value)
                assert value in ('true', 'false') and one.value_type is bool
                line += ['-p', f'{name}:={value}']
        for source, target in node.remappings:
            line += ['-r', f'{self.text(source)}:={self.text(target)}']
        return line


def required(entities):
    """Yield the arguments without a default, also those that included files would ask for."""
    for entity in entities:
        if isinstance(entity, DeclareLaunchArgument) and entity.default_value is None:
            yield entity.name
        elif isinstance(entity, IncludeLaunchDescription):
            given = [name for name, _ in entity.launch_arguments]
            inside = required(described(entity.source.path).entities)
            yield from (name for name in inside if name not in given)


ACTIONS = DeclareLaunchArgument, IncludeLaunchDescription, LogInfo, Shutdown
MODULES = {
    'launch': (LaunchDescription,),
    'launch.actions': ACTIONS,
    'launch.conditions': (IfCondition,),
    'launch.launch_description_sources': (PythonLaunchDescriptionSource,),
    'launch.substitutions': (LaunchConfiguration,),
    'launch_ros': (),
    'launch_ros.actions': (Node,),
    'launch_ros.parameter_descriptions': (ParameterValue,),
}


def described(path):
    """Return the description that a launch file generates."""
    return runpy.run_path(str(Path(path)))['generate_launch_description']()


def name_of(path):
    return path.name.partition('.')[0]


@pytest.fixture
def launch(monkeypatch):
    """Include a launch file with arguments, as `ros2 launch` does; return the context then."""
    for name, members in MODULES.items():
        module = ModuleType(name)
        vars(module).update({member.__name__: member for member in members})
        monkeypatch.setitem(sys.modules, name, module)

    def launch(name, **arguments):
        context = Context()
        source = PythonLaunchDescriptionSource(str(LAUNCH / f'{name}.launch.py'))
        context.visit(IncludeLaunchDescription(source, arguments.items()))
        return context

    return launch


def after(flag, line):
    """Return what follows each of a flag in a command line."""
    return [value for before, value in pairwise(line) if before == flag]


@pytest.mark.parametrize('name', REQUIRED)
def test_every_file_starts_executables_that_there_are(launch, name):
    assert {name_of(path) for path in FILES} == set(REQUIRED)
    given = REQUIRED[name]
    closed = launch(name, **given).processes
    context = launch(name, **given, rviz='true', extra_params_file='learned.yaml')
    assert set(closed) <= set(EXECUTABLES)
    assert set(context.processes) - set(closed) == {'rviz2'}
    # A second file of parameters comes after the first, which stands in for it.
    first, second = after('--params-file', closed['localizer'].line)
    assert first == second
    assert after('--params-file', context.processes['localizer'].line) == [first, 'learned.yaml']
    # Only the recording brings its own time, and ends all.
    assert ('use_sim_time:=true' in closed['localizer'].line) == (name == 'bag')
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
    assert all('__ns:=/left' in process.line for process in context.processes.values())
    rviz = context.processes['rviz2'].line
    # Without a slash: in the namespace of RViz.
    assert after('-r', rviz)[1:] == ['/localizer/markers:=localizer/markers']
    assert Path(*after('-d', rviz)).exists() and after('-f', rviz) == ['fleet']
    assert any('the frame fleet;' in line for line in context.lines)
    assert not launch('simulation').lines
    defaults = {f'{name}:={spec.default}'.lower() for name, spec in PARAMETERS.items()}
    switches = after('-p', context.processes['simulate_fleet'].line)
    assert switches and set(switches) <= defaults


@pytest.mark.skipif(find_spec('launch_ros') is None, reason='launch is not installed')
@pytest.mark.parametrize('path', FILES, ids=name_of)
def test_launch_reads_the_files(path):
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    assert PythonLaunchDescriptionSource(str(path)).try_get_launch_description_without_context()


FLEETS = {'left': ('true', 1), 'right': ('false', 16)}
N_ROBOTS = 6
DEADLINE_S = 120.0


@pytest.fixture
def fleets(launch, tmp_path):
    """Start both fleets, each as one process group, as a terminal does; return the processes."""
    started = {fleet: [] for fleet in FLEETS}
    for fleet, (cameras, _) in FLEETS.items():
        log = (tmp_path / f'{fleet}.log').open('a')
        context = launch('simulation', namespace=fleet, cameras=cameras)
        for executable, process in context.processes.items():
            group = started[fleet][0].pid if started[fleet] else 0
            options = {'process_group': group, 'stdout': log, 'stderr': subprocess.STDOUT}
            started[fleet].append(start(executable, *process.line, **options))
    yield started
    for process in (process for fleet in started.values() for process in fleet):
        process.kill()
        process.wait()


def test_each_fleet_hears_itself_alone_and_ends_alone(bench, fleets, tmp_path):
    poses = {}
    for fleet in FLEETS:
        topic, take = f'/{fleet}/localizer/feasible_poses', partial(poses.__setitem__, fleet)
        bench.node.create_subscription(PoseArray, topic, take, LATCHED)

    def until_placements(fleet, number):
        bench.until(
            lambda: fleet in poses and len(poses[fleet].poses) == number * N_ROBOTS,
            f'{number} hypotheses of the fleet {fleet}',
            DEADLINE_S,
        )

    everybodys = {'/diagnostics', '/parameter_events', '/rosout'}
    for fleet, (_, n_hypotheses) in FLEETS.items():
        until_placements(fleet, n_hypotheses)
        node = ('localizer', f'/{fleet}')
        # Whose a topic is arrives later than what is sent on it.
        subscribed, published = (
            bench.until(lambda of=of, node=node: dict(of(*node)), f'the topics of {node}')
            for of in (
                bench.node.get_subscriber_names_and_types_by_node,
                bench.node.get_publisher_names_and_types_by_node,
            )
        )
        assert all(topic.startswith(f'/{fleet}/robot_') for topic in subscribed)
        assert all(topic.startswith(f'/{fleet}/') for topic in set(published) - everybodys)
        name = f'{fleet}/localizer: fleet'
        bench.until(lambda name=name: name in bench.heard.statuses, name)
    # As Ctrl-C does: no traceback, and no old answers.
    os.killpg(fleets['left'][0].pid, signal.SIGINT)
    codes = [process.wait(timeout=20.0) for process in fleets['left']]
    printed = (tmp_path / 'left.log').read_text()
    assert codes == [0, 0] and 'rror' not in printed and 'Traceback' not in printed, printed
    until_placements('left', 0)
    poses.pop('right')
    until_placements('right', 16)


def test_remapped_outputs_have_their_new_names_alone(bench, make_node):
    node = make_node('-r', '~/feasible_poses:=/fleet/poses', '-r', '/diagnostics:=fleet/state')
    bench.until(lambda: node.count_publishers('/fleet/poses') == 1, 'the topic')
    assert node.count_publishers('/localizer/feasible_poses') == 0
    assert node.count_publishers('/fleet/state') == 1
