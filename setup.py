# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Install dg_localization: with pip, or as an ament_python package with colcon."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'dg_localization'

EXTRAS = {
    # A machine where ROS 2 Jazzy is sourced has these already.
    'ros': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
    'bags': ['rosbags>=0.11', 'mcap>=1.2'],
    # Large fleets on the workers of a cluster.
    'dask': ['distributed>=2024.5'],
    'plots': ['matplotlib>=3.6'],
    'speed': ['numba>=0.58.1'],
    'progress': ['tqdm>=4'],
    # colcon runs the tests with pytest because it finds it under this name.
    'test': [
        'pytest>=7.4',
        'pytest-timeout',
        'pytest-xdist',
        'hypothesis',
        'mpmath',
        'PyYAML',
    ],
    'bench': ['scipy'],
    # What the benchmarks compare with; `make bench` installs it.
    'compare': ['codac>=2', 'gtsam>=4.2', 'pyscipopt'],
    'lint': ['ruff>=0.6', 'mypy>=1.8'],
    'docs': ['sphinx>=7', 'myst-parser>=2'],
    # `colcon build` and `colcon test` where no ROS is installed; `.ci/run` installs it.
    'colcon': [
        'colcon-bash',
        'colcon-core',
        'colcon-library-path',
        'colcon-package-information',
        'colcon-python-setup-py',
        'colcon-recursive-crawl',
        'colcon-ros',
        'colcon-test-result',
        'ros-jazzy-ament-package',
        'setuptools<80',
    ],
}

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Every placement of a robot fleet that agrees with its ranges and bearings',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    # To be filled in before a release, as in package.xml: who answers, and where.
    maintainer='dg_localization maintainers',
    maintainer_email='maintainers@dg-localization.invalid',
    url='https://dg-localization.invalid',
    project_urls={'Paper': 'https://doi.org/10.3390/s16071096'},
    classifiers=[
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
    ],
    python_requires='>=3.11',
    packages=find_packages(include=[f'{PACKAGE}*', 'msg_adapters*']),
    package_data={PACKAGE: ['py.typed'], 'msg_adapters': ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    install_requires=['setuptools', 'numpy>=1.26'],
    extras_require=EXTRAS,
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'compile_kernels = dg_localization.compile_kernels:main',
            'localizer = dg_localization.ros.executables:localizer',
            'simulate_fleet = dg_localization.ros.executables:simulate_fleet',
            'replay = dg_localization.ros.executables:replay',
            'localize_bag = dg_localization.ros.executables:localize_bag',
            'fit_bounds = dg_localization.ros.executables:fit_bounds',
            'survey_anchors = dg_localization.ros.executables:survey_anchors',
            'fleet_status = dg_localization.ros.executables:fleet_status',
            'self_test = dg_localization.ros.executables:self_test',
        ],
    },
)
