# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What development and continuous integration install: by version and hash, as setup.py asks."""

from pathlib import Path
import re

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
import pytest

REPOSITORY = Path(__file__).parents[1]
FOLDER = REPOSITORY / 'requirements'
MAKEFILE = (REPOSITORY / 'Makefile').read_text(encoding='utf-8')
FILES = sorted(FOLDER.glob('*.txt'))
ENTRY = re.compile(r'^([a-z0-9][a-z0-9._-]*)==(\S+)', re.IGNORECASE | re.MULTILINE)


def name(path):
    return path.stem


def pinned(path):
    """Return the versions of each package in a file, by its name."""
    versions = {}
    for package, version in ENTRY.findall(path.read_text(encoding='utf-8')):
        versions.setdefault(canonicalize_name(package), []).append(version)
    return versions


@pytest.mark.parametrize('path', FILES, ids=name)
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
