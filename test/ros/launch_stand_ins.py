# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Stand-ins for `launch` and `launch_ros`, which are no wheels, as far as our launch files use them.

They are as strict as the originals: arguments and configurations are set one after the other and
are seen by what comes later, also in files that are included; a file is included only with every
argument that has no default there; every substitution is performed.
"""

from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
import runpy
import sys
from types import ModuleType, SimpleNamespace


class MissingArgumentError(Exception):
    """An argument without a default was not given."""


LaunchConfiguration = make_dataclass('LaunchConfiguration', ['name'])
ParameterValue = make_dataclass('ParameterValue', ['value', 'value_type'])
IfCondition = make_dataclass('IfCondition', ['predicate'])
Shutdown = make_dataclass('Shutdown', ['reason'])
PythonLaunchDescriptionSource = make_dataclass('PythonLaunchDescriptionSource', ['path'])
LaunchDescription = make_dataclass('LaunchDescription', ['entities'])


@dataclass
class Context:
    """The configurations so far, what was declared, and the command line of each executable."""

    configurations: dict
    declared: dict = field(default_factory=dict)
    processes: dict = field(default_factory=dict)
    lines: list = field(default_factory=list)

    def holds(self, condition):
        """Return whether a condition, if there is one, is met."""
        return condition is None or self.text(condition.predicate) == 'true'

    def text(self, value):
        """Return a substitution, or a list of them, as text."""
        if isinstance(value, (list, tuple)):
            return ''.join(self.text(part) for part in value)
        if isinstance(value, LaunchConfiguration):
            return self.configurations[value.name]
        assert isinstance(value, str), f'{value!r} is neither text nor a substitution'
        return value


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: object = None
    description: str = ''
    choices: list | None = None

    def visit(self, context):
        context.declared.setdefault(self.name, self)
        if self.name not in context.configurations:
            if self.default_value is None:
                raise MissingArgumentError(self.name)
            context.configurations[self.name] = context.text(self.default_value)
        assert self.choices is None or context.configurations[self.name] in self.choices


@dataclass
class LogInfo:
    msg: object
    condition: IfCondition | None = None

    def visit(self, context):
        if context.holds(self.condition):
            context.lines.append(context.text(self.msg))


@dataclass
class IncludeLaunchDescription:
    source: PythonLaunchDescriptionSource
    launch_arguments: object = ()

    def visit(self, context):
        given = [
            (context.text(name), context.text(value)) for name, value in self.launch_arguments
        ]
        entities = described(context.text(self.source.path)).entities
        # Those that are set but not handed on do not count.
        for name in required(entities):
            if name not in dict(given):
                raise MissingArgumentError(name)
        context.configurations.update(given)
        for entity in entities:
            entity.visit(context)


def required(entities):
    """Yield the arguments without a default, also those that included files would ask for."""
    for entity in entities:
        if isinstance(entity, DeclareLaunchArgument) and entity.default_value is None:
            yield entity.name
        elif isinstance(entity, IncludeLaunchDescription):
            given = [name for name, _ in entity.launch_arguments]
            inside = required(described(entity.source.path).entities)
            yield from (name for name in inside if name not in given)


@dataclass
class Node:
    package: str
    executable: str
    namespace: object = ''
    arguments: list = field(default_factory=list)
    parameters: list = field(default_factory=list)
    remappings: list = field(default_factory=list)
    output: str = 'log'
    condition: IfCondition | None = None
    on_exit: object = None

    def visit(self, context):
        """Add the process to start, with all substitutions performed."""
        if context.holds(self.condition):
            line = [context.text(part) for part in self.arguments] + ['--ros-args']
            if namespace := context.text(self.namespace):
                line += ['-r', f'__ns:=/{namespace}']
            for entry in self.parameters:
                if not isinstance(entry, dict):
                    line += ['--params-file', context.text(entry)]
                    continue
                for name, one in entry.items():
                    value = context.text(one.value)
                    assert value in ('true', 'false') and one.value_type is bool
                    line += ['-p', f'{name}:={value}']
            for source, target in self.remappings:
                line += ['-r', f'{context.text(source)}:={context.text(target)}']
            ends_all = isinstance(self.on_exit, Shutdown)
            context.processes[self.executable] = SimpleNamespace(line=line, ends_all=ends_all)


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


def install(monkeypatch):
    """Put the stand-ins in the place of the originals until the test ends."""
    for name, members in MODULES.items():
        module = ModuleType(name)
        vars(module).update({member.__name__: member for member in members})
        monkeypatch.setitem(sys.modules, name, module)


def described(path):
    """Return the description that a launch file generates."""
    return runpy.run_path(str(Path(path)))['generate_launch_description']()


def launched(path, **arguments):
    """Return the context after `ros2 launch` of a file, which includes it with these arguments."""
    context = Context({})
    source = PythonLaunchDescriptionSource(str(path))
    IncludeLaunchDescription(source, arguments.items()).visit(context)
    return context
