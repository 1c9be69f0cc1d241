"""The rooms of the package: imports point one way, and the core runs without ROS."""

import ast
from pathlib import Path
import subprocess
import sys

import pytest

REPOSITORY = Path(__file__).parents[1]

# For each room the rooms of this project that it may import besides itself.
ALLOWED = {
    'dg_localization': {'dg_localization.solver'},
    'dg_localization.interval': set(),
    'dg_localization.solver': {'dg_localization.interval'},
    'dg_localization.pairs': {'dg_localization.interval'},
    'dg_localization.fleet': {
        'dg_localization',
        'dg_localization.interval',
        'dg_localization.solver',
        'dg_localization.pairs',
    },
    'dg_localization.simulation': set(),
    'dg_localization.ros': {
        'dg_localization',
        'dg_localization.solver',
        'dg_localization.fleet',
        'dg_localization.simulation',
        'msg_adapters',
    },
    'msg_adapters': set(),
}
ROS_FREE = (
    'dg_localization',
    'dg_localization.interval',
    'dg_localization.solver',
    'dg_localization.pairs',
    'dg_localization.fleet',
    'dg_localization.simulation',
)
ROS_PACKAGES = {
    'ament_index_python',
    'builtin_interfaces',
    'diagnostic_msgs',
    'geometry_msgs',
    'lifecycle_msgs',
    'nav_msgs',
    'rcl_interfaces',
    'rclpy',
    'rosbags',
    'rosgraph_msgs',
    'sensor_msgs',
    'std_msgs',
    'std_srvs',
    'visualization_msgs',
}


def room_of(module):
    """Return the innermost room that holds `module`, or None for one of others."""
    rooms = [room for room in ALLOWED if module == room or module.startswith(room + '.')]
    return max(rooms, key=len, default=None)


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


SOURCES = sorted(
    path
    for folder in ('dg_localization', 'msg_adapters')
    for path in (REPOSITORY / folder).rglob('*.py')
)
CORE_SOURCES = [path for path in SOURCES if room_of(module_name(path)) in ROS_FREE]


@pytest.mark.parametrize('path', SOURCES, ids=module_name)
def test_imports_point_one_way(path):
    room = room_of(module_name(path))
    rooms = {room_of(module) for module in imported_modules(path)} - {None, room}
    assert rooms <= ALLOWED[room]


@pytest.mark.parametrize('path', CORE_SOURCES, ids=module_name)
def test_core_names_no_ros_package(path):
    assert not {module.partition('.')[0] for module in imported_modules(path)} & ROS_PACKAGES


@pytest.mark.parametrize('room', [room for room in ROS_FREE if 'pairs' not in room])
def test_core_runs_without_ros(room):
    blocked = dict.fromkeys(ROS_PACKAGES)
    code = f'import sys; sys.modules.update({blocked!r}); import {room}'
    subprocess.run([sys.executable, '-c', code], check=True, cwd=REPOSITORY, timeout=60)


def test_package_imports_without_numba_and_ros():
    code = 'import sys, dg_localization; sys.exit(bool({"numba", "rclpy"} & set(sys.modules)))'
    subprocess.run([sys.executable, '-c', code], check=True, cwd=REPOSITORY, timeout=60)


def test_adapters_import_without_ros():
    code = 'import sys, msg_adapters; sys.exit("rclpy" in sys.modules)'
    subprocess.run([sys.executable, '-c', code], check=True, cwd=REPOSITORY, timeout=60)
