# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The packages: imports point one way, and the core runs without ROS."""

import ast
import graphlib
import re
from xml.etree import ElementTree

from plain_python import REPOSITORY, run_python
import pytest

# For each room of the project those that it may import besides itself; '' is the package itself.
ROOMS_BELOW = {
    '': {'solver'},
    'compile_kernels': {'fleet', 'interval'},
    'optional': set(),
    'interval': {'optional'},
    'solver': {'interval'},
    'poses': {'interval'},
    'fleet': {'', 'interval', 'solver', 'poses'},
    'calibration': {'fleet'},
    'simulation': set(),
    'ros': {'', 'calibration', 'optional', 'solver', 'fleet', 'simulation', 'msg_adapters'},
    'msg_adapters': set(),
}


def package_called(room):
    return room if room == 'msg_adapters' else f'dg_localization.{room}'.rstrip('.')


ALLOWED = {package_called(a): {*map(package_called, others)} for a, others in ROOMS_BELOW.items()}
ROS_FREE = tuple(ALLOWED.keys() - {'dg_localization.ros', 'msg_adapters'})
ROS = re.compile(r'(rclpy|rosbags|ament_index_python|\w+_(msgs|srvs|interfaces))(\.|$)')


def package_of(module):
    """Return the innermost package that holds `module`, or None for one of others."""
    packages = [one for one in ALLOWED if module == one or module.startswith(f'{one}.')]
    return max(packages, key=len, default=None)


def module_name(path):
    parts = path.relative_to(REPOSITORY).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


def imported_modules(path):
    """Return every module that the file imports anywhere, with absolute names."""
    module = module_name(path)
    package = module if path.name == '__init__.py' else module.rpartition('.')[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split('.')
            base = parents[: len(parents) + 1 - node.level] if node.level else []
            origin = '.'.join([*base, *filter(None, [node.module])])
            # `from package import name` may name a module.
            found.add(origin)
            found.update(f'{origin}.{alias.name}' for alias in node.names)
    return found


ROOMS = 'dg_localization', 'msg_adapters'
SOURCES = sorted(path for room in ROOMS for path in (REPOSITORY / room).rglob('*.py'))
MODULES = {module_name(path): path for path in SOURCES}
CORE_SOURCES = [path for path in SOURCES if package_of(module_name(path)) in ROS_FREE]


@pytest.mark.parametrize('path', SOURCES, ids=module_name)
def test_imports_point_one_way_and_the_core_names_no_ros_package(path):
    package = package_of(module_name(path))
    packages = {package_of(module) for module in imported_modules(path)} - {None, package}
    assert packages <= ALLOWED[package]
    assert path not in CORE_SOURCES or not any(map(ROS.match, imported_modules(path)))


def test_no_circle_of_imports():
    # The packages that a module lies in are imported before it, whatever it says.
    graph = {}
    for module, path in MODULES.items():
        others = imported_modules(path) & MODULES.keys()
        graph[module] = {other for other in others if not f'{module}.'.startswith(f'{other}.')}
    graphlib.TopologicalSorter(graph).prepare()


@pytest.mark.parametrize(
    ('imported', 'others'),
    [(ROS_FREE, ROS), *(([package], re.compile('numba|rclpy')) for package in ROOMS)],
    ids=['core', *ROOMS],
)
def test_imports_need_no_ros_and_packages_no_numba(imported, others):
    done = run_python(f'import sys, {", ".join(imported)}; print(*sys.modules, sep="\\n")')
    assert done.returncode == 0, done.stderr
    assert [module for module in done.stdout.split() if others.match(module)] == []


def test_every_ros_package_in_use_is_in_the_manifest():
    manifest = ElementTree.parse(REPOSITORY / 'package.xml')
    declared = {element.text for element in manifest.findall('exec_depend')}
    imported = {name.partition('.')[0] for path in SOURCES for name in imported_modules(path)}
    ros = {name for name in imported if name.endswith(('_msgs', '_srvs', '_interfaces'))}
    # rclpy itself depends on the interfaces of parameters.
    assert ros - {'rcl_interfaces'} <= declared
    assert 'python3-numpy' in declared and 'rclpy' in declared


ROUNDING_NAMES = {'nextafter', 'ulp', 'spacing', 'epsilon', 'UNIT', 'TINIEST', 'ANGLE_ROUNDING'}
ROUNDING_SIZES = (1e-18, 5e-14)
"""A literal between these is about as large as a unit in the last place of a number near 1."""


def rounds_itself(path):
    """Tell whether a file names a step to the next number, or a literal as small as one."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        names = {getattr(node, field, None) for field in ('id', 'attr', 'name')}
        if names & ROUNDING_NAMES:
            return True
        if isinstance(node, ast.Constant) and isinstance(node.value, float):
            if ROUNDING_SIZES[0] <= node.value <= ROUNDING_SIZES[1]:
                return True
    return False


def test_only_one_room_rounds():
    others = [path for path in CORE_SOURCES if 'interval' not in path.parts]
    assert [module_name(path) for path in others if rounds_itself(path)] == []
