# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What installs the package, and what development installs by version and hash."""

from importlib import import_module
from itertools import pairwise
import os
import re
import runpy
import subprocess
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from plain_python import REPOSITORY, run_python
import pytest
import setuptools
import yaml

from dg_localization.optional import install_hint

ROOMS = ('dg_localization', 'msg_adapters')
SOURCES = [path for room in ROOMS for path in (REPOSITORY / room).rglob('*.py')]
FOLDER = REPOSITORY / 'requirements'
MAKEFILE = (REPOSITORY / 'Makefile').read_text(encoding='utf-8')
FILES = sorted(FOLDER.glob('*.txt'))
ENTRY = re.compile(r'^([a-z0-9][a-z0-9._-]*)==(\S+)', re.IGNORECASE | re.MULTILINE)
# The keys of package.xml that are no ROS packages, each an apt package in rosdistro's
# rosdep/python.yaml. With a pip key the package could not be released.
NAMES = 'hypothesis', 'numba', 'numpy', 'pytest', 'pytest-timeout', 'yaml'
ROSDEP_KEYS = {f'python3-{name}' for name in NAMES}


@pytest.fixture(scope='module')
def setup_arguments():
    """Run setup.py without setting up anything, and return the arguments of `setup`."""
    asked = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setuptools, 'setup', lambda **arguments: asked.update(arguments))
        patch.chdir(REPOSITORY)
        runpy.run_path('setup.py')
    return SimpleNamespace(**asked)


@pytest.fixture(scope='module')
def manifest():
    return ElementTree.parse(REPOSITORY / 'package.xml').getroot()


def test_manifest_and_setup_agree(setup_arguments, manifest):
    assert manifest.get('format') == '3'
    assert manifest.findtext('export/build_type') == 'ament_python'
    for tag in ('name', 'version', 'license'):
        assert manifest.findtext(tag) == getattr(setup_arguments, tag)
    assert 'Apache License' in (REPOSITORY / manifest.find('license').get('file')).read_text()


def test_every_key_of_the_manifest_exists(manifest):
    depends = {element.text for element in manifest if element.tag.endswith('depend')}
    ros = {'rclpy', 'builtin_interfaces'}
    others = {key for key in depends - ros if not key.endswith(('_msgs', '_srvs'))}
    assert others <= ROSDEP_KEYS


def test_the_changelog_has_the_form_that_releases_need(manifest):
    lines = (REPOSITORY / 'CHANGELOG.rst').read_text(encoding='utf-8').splitlines()
    title = f'Changelog for package {manifest.findtext("name")}'
    assert lines[:3] == ['^' * len(title), title, '^' * len(title)]
    sections = [one for one, rule in pairwise(lines) if rule and rule == '-' * len(one)]
    assert sections
    assert all(re.fullmatch(r'Forthcoming|[\d.]+ \(\d{4}-\d\d-\d\d\)', name) for name in sections)


def test_every_folder_of_sources_is_installed_with_its_types(setup_arguments):
    folders = {'.'.join(path.parent.relative_to(REPOSITORY).parts) for path in SOURCES}
    assert set(setup_arguments.packages) == folders
    assert setup_arguments.package_data == {room: ['py.typed'] for room in ROOMS}
    assert all((REPOSITORY / room / 'py.typed').is_file() for room in ROOMS)


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
    required = [Requirement(text).name for text in setup_arguments.install_requires]
    assert required == ['setuptools', 'numpy']


def test_a_package_that_a_message_says_to_install_is_one_of_an_extra(setup_arguments):
    extras = [text for extra in setup_arguments.extras_require.values() for text in extra]
    offered = {re.match(r'[\w.-]+', text).group() for text in extras}
    texts = (path.read_text(encoding='utf-8') for path in SOURCES)
    named = {name for text in texts for name in re.findall(r'install_hint\(["\']([\w.-]+)', text)}
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
        steps = [step for job in workflow['jobs'].values() for step in job['steps']]
        actions = [step['uses'] for step in steps if 'uses' in step]
        assert actions
        assert all(re.fullmatch(r'[\w/-]+@[0-9a-f]{40}', action) for action in actions)


@pytest.mark.parametrize(
    ('folder', 'environment', 'reason'),
    [
        ('venv', {'ROS_DISTRO': 'humble'}, 'this package is for jazzy and lyrical'),
        ('venv', {'ROS_DISTRO': '', 'PYTHON': 'no_python'}, 'PYTHON=no_python: not found'),
        # `false` stands for an interpreter that is too old: it fails the check of its version.
        ('venv', {'ROS_DISTRO': '', 'PYTHON': 'false'}, 'this package needs Python 3.11 or newer'),
        ('work', {'ROS_DISTRO': '', 'PYTHON': sys.executable}, 'is no virtual environment'),
    ],
)
def test_set_up_refuses_what_cannot_work(tmp_path, folder, environment, reason):
    thesis = tmp_path / 'work/thesis.txt'
    thesis.parent.mkdir()
    thesis.write_text('years of work')
    command = 'make', '--no-print-directory', 'venv', f'VENV={tmp_path / folder}'
    environment = os.environ | environment
    options = {'cwd': REPOSITORY, 'capture_output': True, 'text': True, 'timeout': 60}
    result = subprocess.run(command, env=environment, **options)
    assert result.returncode != 0 and reason in result.stderr
    # Nothing is made, and nothing is removed.
    assert [*tmp_path.rglob('*')] == [thesis.parent, thesis]


@pytest.mark.parametrize(('stated', 'threads'), [({}, '1'), ({'OPENBLAS_NUM_THREADS': '4'}, '4')])
def test_blas_has_one_thread_unless_the_environment_says_otherwise(monkeypatch, stated, threads):
    monkeypatch.delenv('OPENBLAS_NUM_THREADS', raising=False)
    code = 'import dg_localization, os; print(os.environ["OPENBLAS_NUM_THREADS"])'
    assert run_python(code, **stated).stdout.strip() == threads


def test_two_processes_never_get_the_same_domain():
    """This process has one already."""
    domain = 'from dg_localization.ros import domain'
    claimed = run_python(f'{domain}; print(domain.claim_domain(), domain.claim_domain())').stdout
    assert len({*claimed.split(), os.environ['ROS_DOMAIN_ID']}) == 3


def test_every_source_names_its_license():
    sources = subprocess.run(
        ['git', 'ls-files', '*.py'], cwd=REPOSITORY, capture_output=True, text=True, check=False
    ).stdout.split()
    if not sources:
        pytest.skip('not a clone')
    for source in sources:
        text = (REPOSITORY / source).read_text(encoding='utf-8')
        assert not text or '# SPDX-License-Identifier: Apache-2.0' in text[:1000], source


def pinned(path):
    """Return the versions of each package in a file, by its name."""
    versions = {}
    for package, version in ENTRY.findall(path.read_text(encoding='utf-8')):
        versions.setdefault(canonicalize_name(package), []).append(version)
    return versions


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_every_package_is_pinned_by_version_and_hash(path):
    text = path.read_text(encoding='utf-8')
    entries = re.split(r'^(?=[^\s#])', text, flags=re.MULTILINE)[1:]
    assert entries
    for entry in entries:
        assert ENTRY.match(entry), entry
        assert re.search(r'--hash=sha256:[0-9a-f]{64}\b', entry), entry
    # No address: everything comes from the index of the machine.
    assert not re.search(r'://|^-|@ ', text, re.MULTILINE)


@pytest.mark.parametrize(
    ('file', 'left_out'),
    [
        ('wheels', ()),
        ('jazzy', ('ros', 'numpy')),
        ('lyrical', ('ros', 'numpy')),
        ('colcon', ('numpy',)),
        ('docs', ('numpy',)),
    ],
)
def test_versions_are_those_that_setup_allows(setup_arguments, file, left_out):
    extras = re.search(r'^extras = (.*)$', MAKEFILE, re.MULTILINE).group(1).split()
    others = {'wheels': [*extras, 'ros'], 'colcon': ['colcon'], 'docs': ['docs']}
    extras = others.get(file, extras)
    wanted = [text for extra in extras for text in setup_arguments.extras_require[extra]]
    versions = pinned(FOLDER / f'{file}.txt')
    for text in [*wanted, *setup_arguments.install_requires]:
        requirement = Requirement(text)
        if requirement.name in left_out or requirement.name == 'setuptools' != file:
            continue
        found = versions.get(canonicalize_name(requirement.name), [])
        assert found or requirement.name == 'setuptools', text
        assert all(requirement.specifier.contains(version) for version in found), text
    assert not set(versions) & set(left_out)


def test_numpy_of_the_system_is_what_the_packages_beside_ros_are_chosen_for(setup_arguments):
    (line,) = re.findall(r'^numpy==(.*)$', (FOLDER / 'jazzy.in').read_text(), re.MULTILINE)
    (wanted,) = [text for text in setup_arguments.install_requires if 'numpy' in text]
    assert line.startswith('1.') and Requirement(wanted).specifier.contains(line)


def test_colcon_gets_the_setuptools_it_can_work_with():
    (version,) = pinned(FOLDER / 'colcon.txt')['setuptools']
    assert version in SpecifierSet('<80')


def test_nothing_is_installed_without_its_hash():
    scripts = MAKEFILE + (REPOSITORY / '.ci/run').read_text(encoding='utf-8')
    scripts = scripts.replace('\\\n', ' ')
    installs = re.findall(r'^.*\bpip \S*(?:install|download)\b.*$', scripts, re.MULTILINE)
    assert len(installs) >= 5
    # Besides this package itself: what writes these files, and what `make bench` compares with.
    others = [line for line in installs if '-r ' not in line and '--editable .' not in line]
    assert [line.split()[-1] for line in others] == ['uv', "'.[compare]'"]
    assert '--no-deps --no-build-isolation --require-hashes "$$@"' in MAKEFILE
