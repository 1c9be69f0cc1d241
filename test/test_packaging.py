# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What installs the package: its metadata agree with each other and with the sources."""

import ast
from importlib import import_module
import os
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest
import yaml

from dg_localization.optional import install_hint

REPOSITORY = Path(__file__).parents[1]
ROOMS = ('dg_localization', 'msg_adapters')
# The keys of package.xml that are no ROS packages, each an apt package in rosdistro's
# rosdep/python.yaml. With a pip key the package could not be released.
ROSDEP_KEYS = {
    'python3-hypothesis',
    'python3-numba',
    'python3-numpy',
    'python3-pytest',
    'python3-pytest-timeout',
    'python3-yaml',
}


@pytest.fixture(scope='module')
def manifest():
    return ElementTree.parse(REPOSITORY / 'package.xml').getroot()


@pytest.mark.parametrize('room', ROOMS)
def test_types_are_installed(setup_arguments, room):
    assert setup_arguments.package_data[room] == ['py.typed']
    assert (REPOSITORY / room / 'py.typed').is_file()


def test_manifest_and_setup_agree(setup_arguments, manifest):
    assert manifest.get('format') == '3'
    assert manifest.findtext('export/build_type') == 'ament_python'
    for tag in ('name', 'version', 'license'):
        assert manifest.findtext(tag) == getattr(setup_arguments, tag)
    assert 'Apache License' in (REPOSITORY / manifest.find('license').get('file')).read_text()


def test_every_ros_package_in_use_is_in_the_manifest(manifest):
    declared = {element.text for element in manifest.findall('exec_depend')}
    imported = set()
    for path in (path for room in ROOMS for path in (REPOSITORY / room).rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(node.module.partition('.')[0])
            elif isinstance(node, ast.Import):
                imported.update(alias.name.partition('.')[0] for alias in node.names)
    ros = {name for name in imported if name.endswith(('_msgs', '_srvs', '_interfaces'))}
    # rclpy itself depends on the interfaces of parameters.
    assert ros - {'rcl_interfaces'} <= declared
    assert 'python3-numpy' in declared and 'rclpy' in declared


def test_every_key_of_the_manifest_exists(manifest):
    depends = {element.text for element in manifest if element.tag.endswith('depend')}
    ros = {'rclpy', 'builtin_interfaces'}
    others = {key for key in depends - ros if not key.endswith(('_msgs', '_srvs'))}
    assert others <= ROSDEP_KEYS


def test_the_changelog_has_the_form_that_releases_need(manifest):
    lines = (REPOSITORY / 'CHANGELOG.rst').read_text(encoding='utf-8').splitlines()
    title = f'Changelog for package {manifest.findtext("name")}'
    assert lines[:3] == ['^' * len(title), title, '^' * len(title)]
    sections = [
        line
        for line, rule in zip(lines, lines[1:], strict=False)
        if rule and rule == '-' * len(line)
    ]
    assert sections
    assert all(re.fullmatch(r'Forthcoming|[\d.]+ \(\d{4}-\d\d-\d\d\)', name) for name in sections)


def test_every_folder_of_sources_is_installed(setup_arguments):
    folders = {
        '.'.join(path.parent.relative_to(REPOSITORY).parts)
        for room in ROOMS
        for path in (REPOSITORY / room).rglob('*.py')
    }
    assert set(setup_arguments.packages) == folders


def test_share_holds_the_marker_the_manifest_and_every_configuration(setup_arguments):
    data = {folder: set(files) for folder, files in setup_arguments.data_files}
    assert data['share/ament_index/resource_index/packages'] == {'resource/dg_localization'}
    assert data['share/dg_localization'] == {'package.xml'}
    for folder in ('config', 'launch'):
        files = {f'{folder}/{path.name}' for path in (REPOSITORY / folder).iterdir()}
        assert data[f'share/dg_localization/{folder}'] == {
            file for file in files if not file.endswith('__pycache__')
        }
    assert 'config/paper_fleet.yaml' in data['share/dg_localization/config']


def test_every_executable_has_a_function(setup_arguments):
    pytest.importorskip('rclpy', reason='ROS 2 is not installed')
    for script in setup_arguments.entry_points['console_scripts']:
        module, _, function = script.partition(' = ')[2].partition(':')
        assert callable(getattr(import_module(module), function))


def test_only_numpy_is_required(setup_arguments):
    # setuptools is there for colcon, which asks for it.
    assert [text.rstrip('>=.0123456789') for text in setup_arguments.install_requires] == [
        'setuptools',
        'numpy',
    ]


def test_a_package_that_a_message_says_to_install_is_one_of_an_extra(setup_arguments):
    extras = [text for extra in setup_arguments.extras_require.values() for text in extra]
    offered = {re.match(r'[\w.-]+', text).group() for text in extras}
    named = {
        name
        for room in ROOMS
        for path in (REPOSITORY / room).rglob('*.py')
        for name in re.findall(r'install_hint\(["\']([\w.-]+)', path.read_text(encoding='utf-8'))
    }
    assert named and named <= offered


@pytest.mark.parametrize(
    ('numpy', 'package', 'wanted'),
    [
        ('2.2.4', 'tqdm', 'pip install tqdm'),
        # ROS was compiled against this numpy.
        ('1.26.4', 'numba', "pip install numba 'numpy<2'"),
    ],
)
def test_the_hint_for_a_missing_package_works_beside_system_packages(
    monkeypatch, numpy, package, wanted
):
    monkeypatch.setattr(sys, 'prefix', sys.base_prefix)
    monkeypatch.setattr('dg_localization.optional.version', lambda _: numpy)
    hint = install_hint(package)
    assert 'venv --system-site-packages' in hint and hint.endswith(wanted)


def test_actions_are_pinned_and_may_only_read():
    for path in (REPOSITORY / '.github/workflows').glob('*.yml'):
        workflow = yaml.safe_load(path.read_text(encoding='utf-8'))
        assert workflow['permissions'] == {'contents': 'read'}
        actions = [
            step['uses']
            for job in workflow['jobs'].values()
            for step in job['steps']
            if 'uses' in step
        ]
        assert actions
        assert all(re.fullmatch(r'[\w/-]+@[0-9a-f]{40}', action) for action in actions)


def run_set_up(tmp_path, **environment):
    return subprocess.run(
        ['make', '--no-print-directory', 'venv', f'VENV={tmp_path / "venv"}'],
        cwd=REPOSITORY,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.mark.parametrize(
    ('environment', 'reason'),
    [
        ({'ROS_DISTRO': 'humble'}, 'this package is for jazzy and lyrical'),
        ({'ROS_DISTRO': '', 'PYTHON': 'no_such_python'}, 'PYTHON=no_such_python: not found'),
        # `false` stands for an interpreter that is too old: it fails the check of its version.
        ({'ROS_DISTRO': '', 'PYTHON': 'false'}, 'this package needs Python 3.11 or newer'),
    ],
)
def test_set_up_refuses_what_cannot_work(tmp_path, environment, reason):
    result = run_set_up(tmp_path, **environment)
    assert result.returncode != 0
    assert reason in result.stderr
    assert not (tmp_path / 'venv').exists()


def test_set_up_does_not_remove_a_folder_that_is_no_environment(tmp_path):
    folder = tmp_path / 'venv'
    folder.mkdir()
    (folder / 'thesis.txt').write_text('years of work')
    result = run_set_up(tmp_path, ROS_DISTRO='', PYTHON=sys.executable)
    assert result.returncode != 0
    assert 'exists and is no virtual environment' in result.stderr
    assert (folder / 'thesis.txt').exists()


@pytest.mark.parametrize(('stated', 'threads'), [({}, '1'), ({'OPENBLAS_NUM_THREADS': '4'}, '4')])
def test_blas_has_one_thread_unless_the_environment_says_otherwise(stated, threads):
    code = 'import dg_localization, os; print(os.environ["OPENBLAS_NUM_THREADS"])'
    environment = {k: v for k, v in os.environ.items() if k != 'OPENBLAS_NUM_THREADS'} | stated
    command = [sys.executable, '-c', code]
    found = subprocess.run(
        command, cwd=REPOSITORY, env=environment, capture_output=True, text=True
    )
    assert found.stdout.strip() == threads, found.stderr


def test_two_processes_never_get_the_same_domain():
    code = (
        'from dg_localization.ros.domain import claim_domain;'
        'print(claim_domain(), flush=True); input()'
    )
    processes = [
        subprocess.Popen(
            [sys.executable, '-c', code],
            cwd=REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    domains = {process.stdout.readline().strip() for process in processes}
    for process in processes:
        process.communicate('\n', timeout=20)
    assert len(domains) == 3
    assert os.environ['ROS_DOMAIN_ID'] not in domains


def test_every_source_names_its_license():
    sources = subprocess.run(
        ['git', 'ls-files', '*.py'], cwd=REPOSITORY, capture_output=True, text=True, check=False
    ).stdout.split()
    if not sources:
        pytest.skip('not a clone')
    for source in sources:
        text = (REPOSITORY / source).read_text(encoding='utf-8')
        assert not text or '# SPDX-License-Identifier: Apache-2.0' in text[:1000], source
